"""Planning towards one goal on a map that changes, from a start that moves.

NNPP, section 5.5, Tables 3 and 4: a path is planned, the robot follows it, the map changes, and the rest is planned
anew. Every method answers on the newest map; they differ in what they keep from one answer to the next.
"""

import math
import time
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle, apart, gather
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA, StepModel
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.choice import NEAR
from nnpp_edge.runtime.planners.incremental import DStarPlanner, Mending
from nnpp_edge.runtime.planners.plan import Method, Plan, Source, measure
from nnpp_edge.runtime.planners.query import Query, as_cell, problem_with
from nnpp_edge.runtime.planners.standing_path import Standing, StandingPath
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.dstar_lite import DStarLite
from nnpp_edge.runtime.search.workspace import Workspace

_MOST_CHANGES = 64
"""Rectangles that are kept apart; one more and they are taken for the one that holds them all."""
_MEND_FROM = 192
"""Cells to the goal from which on `auto` mends; a shorter corridor is as soon made anew."""
_NEAR_START = 0.25
"""`auto` mends its search where all changes lie nearer to the start than this share of the way to the goal."""
_FEW_CHANGES = 1.0 / 1024.0
"""Share of the map's cells that may have changed for that."""
_DRIFT = 1.02
"""Mended paths are taken until they may cost so many times what paths of a new corridor would."""


class DynamicMethod(StrEnum):
    """How to plan anew."""

    AUTO = "auto"
    ASTAR = "astar"
    """Exact A* over the whole map, afresh each time."""
    DSTAR = "dstar"
    """D* Lite over the whole map: exact, and mended rather than searched anew."""
    CORRIDOR = "corridor"
    """Coarse to fine, afresh each time."""
    CORRIDOR_DSTAR = "corridor-dstar"
    """The corridor of the present start, and inside it D* Lite, or A* where that is expected to be less work."""
    NNPP = "nnpp"
    """The network's region of the present start, and A* inside it."""
    NNPP_DSTAR = "nnpp-dstar"
    """The network's region of the present start, and inside it the same."""


_BASE = {
    DynamicMethod.AUTO: Method.AUTO,
    DynamicMethod.ASTAR: Method.ASTAR,
    DynamicMethod.DSTAR: Method.ASTAR,
    DynamicMethod.CORRIDOR: Method.CORRIDOR,
    DynamicMethod.CORRIDOR_DSTAR: Method.CORRIDOR,
    DynamicMethod.NNPP: Method.NNPP,
    DynamicMethod.NNPP_DSTAR: Method.NNPP,
}
_WHOLE_MAP = frozenset((DynamicMethod.ASTAR, DynamicMethod.DSTAR))
_INCREMENTAL = frozenset((DynamicMethod.CORRIDOR_DSTAR, DynamicMethod.NNPP_DSTAR))
_LEARNED = frozenset((DynamicMethod.NNPP, DynamicMethod.NNPP_DSTAR))


class DynamicPlanner:
    """Plans towards a goal, again and again, while the map changes and the start moves. Serves one thread at a time.

    Parameters
    ----------
    cost, step_cost, omega, corner_cutting, model
        As for `Planner`.
    goal : (row, col)
        A cell of the map.
    method : str
        One of `DynamicMethod`. ``auto`` picks at each step what is soonest done, and says why: exact A* for a goal
        nearby, unless the way there is long; D* Lite in the corridor that stands, if little has changed and that
        lies near the start; else a new corridor.
    also : sequence of str
        Other methods that `replan` may be asked for. What none of them needs is not kept.

    Raises
    ------
    InvalidMapError, InvalidQueryError
        As for `Planner`; or there is no such method; or the goal is outside the map.
    """

    def __init__(
        self,
        cost: Float2D,
        goal: Cell,
        method: str = DynamicMethod.AUTO,
        *,
        also: Sequence[str] = (),
        step_cost: str = "paper",
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        model: str | Path | NetworkModel = "edge",
    ) -> None:
        self.method = _method(method)
        self.methods = frozenset((self.method, *map(_method, also)))
        self.corner_cutting = corner_cutting
        self._planner: DStarPlanner | None = None
        self._dstar: DStarLite | None = None
        """Of the whole map."""
        if self.methods <= _WHOLE_MAP:
            self.grid = Grid.of(cost, StepModel.of(step_cost, omega))
            self._workspace = Workspace(len(self.grid.weights))
        else:
            self._planner = DStarPlanner(
                cost, step_cost=step_cost, omega=omega, corner_cutting=corner_cutting, model=model
            )
            self.grid, self._workspace = self._planner.grid, self._planner.pyramid.levels[0].workspace
        self.path = StandingPath(self.grid, corner_cutting=corner_cutting)
        """The path of the last answer that had one, and what has changed since."""
        self._changes: list[Rectangle] = []
        self._changed = 0
        self._start: Cell | None = None
        self._drift = 1.0
        """What mended paths may cost, in times of what a new corridor's would."""
        self.set_goal(goal)

    @property
    def goal(self) -> Cell:
        """The cell that paths lead to."""
        return self._goal

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self.grid.rows, self.grid.cols

    def set_goal(self, goal: Cell) -> None:
        """Another goal; the standing path is forgotten. InvalidQueryError if it is outside the map."""
        cell = as_cell(goal, "goal")
        if not (0 <= cell[0] < self.grid.rows and 0 <= cell[1] < self.grid.cols):
            raise InvalidQueryError(f"goal must lie inside the map of {self.shape}, got {cell}")
        self._goal = cell
        self.path.forget()
        if self._dstar is not None:
            self._dstar.set_goal(cell)

    def update(self, row: int, col: int, patch: Float2D) -> int:
        """As `Planner.update`: the number of cells that are other ones now."""
        if self._planner is not None:
            change = self._planner.take(row, col, patch, keep=True)
        else:
            change = self.grid.update(patch, (row, col), keep=True)
        if not change.cells:
            return 0
        self.path.changed(change.part, change.was)
        if self._dstar is not None:
            self._dstar.cells_changed(*change.part)
        self._changed += change.cells
        gather(self._changes, change.part, _MOST_CHANGES)
        return change.cells

    def move(self, start: Cell) -> None:
        """The robot is in this cell now; InvalidQueryError if it is not a cell."""
        self._start = as_cell(start, "start")

    def standing(self) -> Standing:
        """How the last path stands on the map as it is now, for the robot where it is now."""
        return self.path.check(self._where())

    def use_model(self, model: str | Path | NetworkModel) -> None:
        """As `Planner.use_model`; without effect where no method but ``astar`` and ``dstar`` is kept."""
        if self._planner is not None:
            self._planner.use_model(model)

    def prepare(self) -> None:
        """Do now what the first answer would else do: set D* Lite up, load the network and show it the map.

        The system is made to back all of the planner's arrays with memory, so that no later answer waits for that.
        """
        touch(self._workspace, self.path)
        if DynamicMethod.DSTAR in self.methods and self._dstar is None:
            self._dstar = DStarLite(self.grid, self._goal, corner_cutting=self.corner_cutting)
        if self._dstar is not None:
            self._dstar.touch()
        if self._planner is None:
            return
        self._planner.pyramid.touch()
        if self.methods & (_INCREMENTAL | {DynamicMethod.AUTO}):
            self._planner.expect(self._goal)
        if self.methods & _LEARNED:
            self._planner.load_network()

    def replan(
        self,
        *,
        method: str | None = None,
        time_limit_s: float = math.inf,
        cancelled: Callable[[], bool] | None = None,
    ) -> Plan:
        """A path from where the robot is to the goal, on the map as it is now.

        Parameters
        ----------
        method : str
            Instead of the planner's own; one of those that it was made for.
        time_limit_s : float
            After this the status is TIMEOUT. A network's answer is waited for.
        cancelled : callable
            Asked now and then; True ends the planning as a time limit does.

        Returns
        -------
        Plan
            Its path, where the status is OK, leads over passable cells of the newest map. Regions that fail are
            widened, then the whole map is searched: NO_PATH means that there is none.

        Raises
        ------
        InvalidQueryError
            There is no such method, or the start is not known (`move`).
        ModelError
            The network is needed and cannot be loaded.
        """
        began = time.perf_counter()
        wanted = self.method if method is None else _method(method)
        if wanted not in self.methods:
            raise InvalidQueryError(
                f"method must be one that the planner was made for ({', '.join(sorted(self.methods))}), got {wanted}"
            )
        deadline = time.monotonic() + time_limit_s
        if wanted is DynamicMethod.AUTO:
            plan = self._auto(deadline, cancelled)
        else:
            plan = self._plan(wanted, "", deadline, cancelled)
        plan.timings_ms["total"] = 1e3 * (time.perf_counter() - began)
        if plan.ok:
            self.path.set(plan)
            self._changes.clear()
            self._changed = 0
        return plan

    def _auto(self, deadline: float, cancelled: Callable[[], bool] | None) -> Plan:
        """By what is soonest done from here."""
        start, goal = self._where(), self._goal
        if apart((*start, 1, 1), goal) < NEAR and problem_with(self.grid, start, goal) is None:
            assert self._planner is not None
            reason = f"the goal is less than {NEAR} cells away"
            query = self._query(start, DynamicMethod.ASTAR, reason, deadline, cancelled)
            if (plan := self._planner.search_briefly(query, Method.ASTAR)) is not None:
                return plan
        if self.path.plan is None or not self._worth_mending(start):
            return self._plan(DynamicMethod.CORRIDOR, "much may be another", deadline, cancelled)
        assert self._planner is not None
        reason = "little has changed, near the start"
        if problem_with(self.grid, start, goal) is None and self._planner.mends(goal):
            query = self._query(start, DynamicMethod.CORRIDOR_DSTAR, reason, deadline, cancelled)
            drift, plan = self._drift, self._planner.mend(query)
            floor = self.path.check(start).floor
            if plan.ok and floor > 0.0 and (drift := drift * max(plan.cost / floor, 1.0)) <= _DRIFT:
                self._drift = drift
                return plan
            reason = "the corridor that stands has become too dear"
        return self._plan(DynamicMethod.CORRIDOR_DSTAR, reason, deadline, cancelled, Mending.ALWAYS)

    def _worth_mending(self, start: Cell) -> bool:
        """Whether the goal is far, and little has changed since the last answer, near the start."""
        distance = apart((*start, 1, 1), self._goal)
        if distance < _MEND_FROM or self._changed > _FEW_CHANGES * self.grid.cells:
            return False
        reach = _NEAR_START * distance
        return all(apart(part, start) + max(part[2:]) <= reach for part in self._changes)

    def _plan(
        self, method: DynamicMethod, reason: str, deadline: float, cancelled: Callable[[], bool] | None,
        mending: Mending = Mending.WHERE_LESS_WORK,
    ) -> Plan:  # fmt: skip
        start = self._where()
        if (problem := problem_with(self.grid, start, self._goal)) is not None:
            return Plan(problem, _BASE[method], by=method, reason=reason)
        query = self._query(start, method, reason, deadline, cancelled)
        if method in _WHOLE_MAP:
            return self._whole_map(method, query)
        assert self._planner is not None
        self._planner.mending, self._drift = mending if method in _INCREMENTAL else Mending.NEVER, 1.0
        return self._planner.answer(query, _BASE[method])

    def _whole_map(self, method: DynamicMethod, query: Query) -> Plan:
        if method is DynamicMethod.ASTAR:
            found = astar(
                self.grid, query.start, query.goal, self._workspace, corner_cutting=self.corner_cutting,
                deadline=query.deadline, cancelled=query.cancelled,
            )  # fmt: skip
            status, path, expansions = found.status, found.path, found.expansions
        else:
            if self._dstar is None:
                self._dstar = DStarLite(self.grid, query.goal, corner_cutting=self.corner_cutting)
            again = self._dstar.plan(query.start, deadline=query.deadline, cancelled=query.cancelled)
            status, path, expansions = again.status, again.path, again.expansions
        query.lap("search")
        cost = length = traverse_cost = math.inf
        if len(path):
            cost, length, traverse_cost = measure(self.grid, path)
        bound = cost if status is Status.OK else 0.0
        return Plan(
            status, Method.ASTAR, Source.MAP, path, cost, length, traverse_cost, bound, expansions,
            by=query.by, reason=query.reason, timings_ms=query.timings,
        )  # fmt: skip

    def _where(self) -> Cell:
        if self._start is None:
            raise InvalidQueryError("wanted a start (move) before the first plan, got none")
        return self._start

    def _query(
        self, start: Cell, by: DynamicMethod, reason: str, deadline: float, cancelled: Callable[[], bool] | None
    ) -> Query:
        return Query(start, self._goal, self.corner_cutting, deadline, cancelled, math.inf, by, reason)


def _method(name: str) -> DynamicMethod:
    try:
        return DynamicMethod(name)
    except ValueError:
        raise InvalidQueryError(f"method must be one of {', '.join(DynamicMethod)}, got {name!r}") from None
