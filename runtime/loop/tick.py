"""A tick of the onboard loop: its question, as far as it is known, what has failed, its answer."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import Origin, PathMessage
from nnpp_edge.runtime.planners.plan import Plan


class Failure(NamedTuple):
    """Why a rung of the navigator's ladder gave no answer."""

    kind: str
    """As in `Counters.degraded`."""
    reason: str


@dataclass
class Tick:
    """A tick's question, and what has failed so far."""

    clock: Callable[[], float]
    """Monotonic seconds."""
    deadline: float
    """Reading of the clock."""
    number: int
    map_version: int = 0
    start: Cell | None = None
    start_moved: bool = False
    goal: Cell | None = None
    """As in `PathMessage`, as far as they are known."""
    failures: list[Failure] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._started = self.clock()

    def fail(self, kind: str, reason: str) -> None:
        """Note that a rung has failed."""
        self.failures.append(Failure(kind, reason))

    @property
    def left_s(self) -> float:
        """To the deadline; below 0 once it has passed."""
        return self.deadline - self.clock()

    def no_path(self, outcome: Status, reason: str, *, degraded: bool = False) -> PathMessage:
        """The answer without a path."""
        return PathMessage(
            self.number,
            outcome,
            Origin.NONE,
            start=self.start,
            goal=self.goal,
            start_moved=self.start_moved,
            degraded=degraded,
            reason=reason,
            map_version=self.map_version,
            planning_ms=1e3 * (self.clock() - self._started),
        )

    def path(
        self, plan: Plan, origin: Origin, reason: str, map_version: int, known: int | None
    ) -> PathMessage:
        """The answer by a plan that has a path."""
        row, col = plan.path[-1].tolist()
        return replace(
            self.no_path(Status.NO_PATH, reason, degraded=bool(self.failures)),
            outcome=Status.OK,
            goal=(row, col),
            goal_moved=(row, col) != self.goal,
            origin=origin,
            path=plan.path,
            map_version=map_version,
            method=plan.planner,
            choice=plan.choice,
            states=() if plan.states is None else tuple(plan.states.tolist()),
            headings=() if plan.states is None else tuple(plan.headings_deg.tolist()),
            arcs=plan.arcs,
            known=known,
            waypoints=plan.waypoints,
            line_cost=plan.line_cost,
            cost=plan.cost,
            lower_bound=plan.lower_bound,
        )
