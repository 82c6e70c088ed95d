"""How a tick of the onboard loop comes to its path: a ladder of ways, of which the first that gives
an answer counts.

1. The standing path, if it is valid and cannot have become worse than the loop's tolerance. 2. The
method asked for, unless by its last times it would be late. 3. The corridor planner. 4. The
standing path, if it is valid at all. 5. The standing path, joined to where the robot is and to the
goal that has moved. 6. A part of the standing path, up to the place from which a search goes on.
7. An outcome that says what failed.

Corridors, and thus ``auto``, are searched for in slices: a search that has not ended after its
slice goes on once the answer is out, and in the next tick. So no tick is late by them, however
large the map.

Every path is checked cell by cell before it is published, on a map that has all patches that came
before the check.
"""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import Origin, PathMessage
from nnpp_edge.runtime.loop.workers import CountError
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod, Plan
from nnpp_edge.runtime.planners.standing_path import Standing

_LOG = logging.getLogger(__name__)
_LEAST_PLANNING_S = 0.002
"""A search gets at least this much time: else a loop that is always late would never plan."""
_SHARE_WITH_PATH = 0.5
"""Of a slice, where there is a path to follow: the search goes on once the answer is out."""
_FORGET = 0.9
"""Factor of a method's expected time each time that the method is skipped as too slow: so it is
tried again.
"""


class Failure(NamedTuple):
    """Why a rung of the ladder gave no answer."""

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


class Ladder:
    """Answers a tick whose start and goal are known and passable. Serves one thread at a time.

    Every path is checked after `update_map` has put all patches that wait into the planner's map,
    and said how many the map has. The standing path is kept while it can cost at most `tolerance`,
    a share, more than a new plan. A search in slices works `slice_s` seconds in each tick that has
    a deadline. `count_error` is called with ``full`` or ``corridor`` when planning raised. With
    `approach` paths lead as near to the goal as there is a way.
    """

    def __init__(
        self,
        planner: DynamicPlanner,
        update_map: Callable[[], int],
        tolerance: float,
        slice_s: float,
        count_error: CountError,
        *,
        approach: bool,
    ) -> None:
        self._planner = planner
        self._state = planner.state
        self._approach = approach
        self._update_map = update_map
        self._tolerance = tolerance
        self._count_error = count_error
        self._slice_s = slice_s
        self._expected_s = 0.0
        """Time that the method asked for is expected to take, if it does not work in slices."""

    def answer(self, tick: Tick) -> PathMessage:
        """The answer of the first rung that gives one; `tick` holds afterwards what failed on the
        way.
        """
        planner = self._planner
        standing = planner.standing()
        is_good = standing.valid and standing.added <= self._tolerance * abs(standing.cost)
        if is_good and not planner.search_due:
            kept = self._kept(tick, standing, "it still holds")
            if kept is not None:
                return kept
        return (
            self._planned_in_full(tick)
            or self._planned_by_corridor(tick, standing)
            or self._kept(tick, standing, tick.failures[0].reason)
            or self._led(tick, planner.joined, "a short way leads along the path planned before")
            or self._led(tick, planner.clear_part, "the standing path is clear as far as this")
            or self._all_failed(tick)
        )

    # --- the rungs: an answer, or None, with what failed noted in the tick

    def _planned_in_full(self, tick: Tick) -> PathMessage | None:
        planner = self._planner
        if not planner.method.entry.in_slices:
            if planner.searching:
                tick.fail("timeout", "the search of a corridor goes on")
                return None
            if self._expected_s > max(tick.left_s, _LEAST_PLANNING_S):
                self._expected_s *= _FORGET
                tick.fail("late", "by its last times the full method would be late")
                return None
        return self._planned(tick, Origin.FULL)

    def _planned_by_corridor(self, tick: Tick, standing: Standing) -> PathMessage | None:
        in_slices = self._planner.method.entry.in_slices
        if in_slices and tick.failures[-1].kind == "timeout":
            return None  # it has just had its slice
        if standing.valid and tick.left_s <= 0.0:
            return None  # the standing path takes no time
        return self._planned(tick, Origin.CORRIDOR, DynamicMethod.CORRIDOR)

    def _kept(self, tick: Tick, standing: Standing, reason: str) -> PathMessage | None:
        """The standing path, if it is valid."""
        plan = self._planner.standing_plan
        if plan is None or not standing.valid:
            return None
        rest = plan.rest(standing.index)
        rest = replace(rest, cost=standing.cost, lower_bound=standing.lower_bound)
        return self._path(tick, rest, Origin.STANDING, reason)

    def _led(self, tick: Tick, path: Callable[[], Plan | None], why: str) -> PathMessage | None:
        """What else is left of the standing path while a search goes on."""
        failure = tick.failures[-1]
        plan = path() if failure.kind == "timeout" else None
        reason = f"{failure.reason}; {why}"
        return None if plan is None else self._path(tick, plan, Origin.STANDING, reason)

    def _all_failed(self, tick: Tick) -> PathMessage:
        late = any(failure.kind in ("late", "timeout") for failure in tick.failures)
        outcome = Status.TIMEOUT if late else Status.UNKNOWN
        return tick.no_path(outcome, tick.failures[-1].reason, degraded=True)

    # --- their parts

    def _planned(
        self, tick: Tick, origin: Origin, method: DynamicMethod | None = None
    ) -> PathMessage | None:
        """The answer by a new plan, by default by the method asked for."""
        began = tick.clock()
        in_slices = (method or self._planner.method).entry.in_slices
        left_s = tick.left_s
        if in_slices and left_s < math.inf:
            # what there is to follow is the answer until the search has ended
            share = _SHARE_WITH_PATH if self._planner.has_path else 1.0
            left_s = min(left_s, share * self._slice_s)
        try:
            plan = self._planner.replan(
                method=method,
                time_limit_s=max(left_s, _LEAST_PLANNING_S),
                goes_on=in_slices,
                approach=self._approach,
            )
        except Exception as error:
            _LOG.warning("planning of %s raised", origin, exc_info=True)
            self._count_error(str(origin))
            tick.fail("raised", one_line(error))
            return None
        if method is None:
            took_s = tick.clock() - began
            mean = 0.8 * self._expected_s + 0.2 * took_s
            self._expected_s = max(took_s, mean if plan.ok else self._expected_s)
        if plan.status is Status.TIMEOUT:
            tick.fail("timeout", plan.reason if in_slices else "the search ran out of time")
            return None
        if not plan.ok:
            return tick.no_path(plan.status, plan.reason)
        reason = tick.failures[-1].reason if tick.failures else plan.reason
        message = self._path(tick, plan, origin, reason)
        if message is None:
            tick.fail("map_changed", "the map changed while planning")
        return message

    def _path(self, tick: Tick, plan: Plan, origin: Origin, reason: str) -> PathMessage | None:
        """The plan's path as a message; None if it does not hold on the newest map."""
        if origin is Origin.STANDING:
            plan = self._planner.refined(plan)
            if not plan.ok:
                return None
        path = plan.path
        version = self._update_map()
        is_newer = version != tick.map_version
        blocked = -1
        if is_newer or origin is not Origin.STANDING:  # that has just been checked
            blocked = self._planner.first_blocked(plan.walked)
        if blocked >= 0 or tuple(path[0].tolist()) != tick.start:
            words = "a path from %s is not published: it begins elsewhere, or is blocked at cell %d"
            _LOG.info(words, origin, blocked)
            return None
        if is_newer:  # way points are not checked on it
            plan = replace(plan, waypoints=None, line_cost=math.inf)
            standing = self._planner.standing()
            if standing.valid:
                plan = replace(plan, cost=standing.cost, lower_bound=standing.lower_bound)
        row, col = path[-1].tolist()
        return replace(
            tick.no_path(Status.NO_PATH, reason, degraded=bool(tick.failures)),
            outcome=Status.OK,
            goal=(row, col),
            goal_moved=(row, col) != tick.goal,
            origin=origin,
            path=path,
            map_version=version,
            method=plan.planner,
            choice=plan.choice,
            states=() if plan.states is None else tuple(plan.states.tolist()),
            headings=() if plan.states is None else tuple(plan.headings_deg.tolist()),
            arcs=plan.arcs,
            known=None if self._state.unseen is None else self._state.known_along(path),
            waypoints=plan.waypoints,
            line_cost=plan.line_cost,
            cost=plan.cost,
            lower_bound=plan.lower_bound,
        )


def one_line(error: BaseException) -> str:
    """An error's type and message in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
