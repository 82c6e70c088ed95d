"""The planner: a map, a network and scratch memory, answering one query after another."""

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.kernels.expansion import LANES, octile
from nnpp_edge.runtime.map.grid import Change, Grid
from nnpp_edge.runtime.map.pyramid import FACTOR, Pyramid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA, StepCost, StepModel
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.choice import NEAR, MapChoice, choice_for
from nnpp_edge.runtime.planners.plan import Method, Plan, Source, measure
from nnpp_edge.runtime.planners.query import Query, as_cell, problem_with
from nnpp_edge.runtime.region.learned import LearnedRegions
from nnpp_edge.runtime.search.astar import Search
from nnpp_edge.runtime.search.landmarks import Landmarks

_REFINE_FROM = 192
"""Cells on a map's longer side from which a learned region is searched coarsely first."""


class _Corridor(NamedTuple):
    """How much around a coarse path is searched on the next finer level."""

    radius: int
    """The quarters of cells within so many of the path's."""
    band: float
    """So are the cells on paths that cost at most so much more than the best, as a share,"""
    nearby: float = 0.12
    """and this much more for short paths, divided by the coarse cells between start and goal."""
    coarse_radius: int = 2
    """What is added to `radius` between two coarse levels: room costs little there."""
    coarse_band: float = 0.04
    """And to `band`."""


_CORRIDORS = _Corridor(1, 0.0015), _Corridor(8, 0.02)
"""At first, and widened."""
_IN_LEARNED_REGION = _Corridor(1, 0.0005, nearby=0.08, coarse_band=0.02)
"""The same inside a learned region, which is searched for speed."""
_BRIEFLY = 1024
"""Expansions that a brief search may take, and twice the square of the distance more."""
_CELLS_APART = 16
"""The coarsest level that is searched is the last on which start and goal are so many cells apart."""


class Planner:
    """Plans on one map, many times. Serves one thread at a time; several planners may run in parallel.

    Parameters
    ----------
    cost : (H, W) float
        With ``step_cost="paper"`` the traversability cost T in [0, 1], impassable where T >= 1 or NaN. With
        ``"length"`` a weight greater than 0, impassable where inf or NaN.
    step_cost : str
        ``"paper"``: a step costs L + 255·omega·(T_i + T_j) (Eq. 2-4). ``"length"``: L × the mean weight.
    omega : float
        Weight of T per grey level; the paper's 0.011.
    corner_cutting : bool
        Whether a diagonal step may pass beside an impassable cell.
    model : str, Path or NetworkModel
        The network for ``nnpp``: a shipped model's name, a file, or one already loaded. It is loaded when
        first needed. A NetworkModel may be shared by planners that do not plan at the same time.
    ask_from : int
        Cells between start and goal from which on ``nnpp`` asks the network. Nearer goals A* has mostly found before
        it has answered, and is tried first.

    Raises
    ------
    InvalidMapError
        The map is not two-dimensional, is empty, or holds a cost out of range.

    Notes
    -----
    A subclass may search regions in another way: it overrides `_search`, and has `_answer` make the plan.
    """

    overlooked = 0.0
    """Change of the map that the network need not see (`LearnedRegions`)."""

    def __init__(
        self,
        cost: Float2D,
        *,
        step_cost: str = "paper",
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        model: str | Path | NetworkModel = "edge",
        ask_from: int = NEAR,
    ) -> None:
        self.grid = Grid.of(cost, StepModel.of(step_cost, omega))
        self.pyramid = Pyramid(self.grid, corner_cutting)
        self.corner_cutting = corner_cutting
        self.landmarks: Landmarks | None = None
        """What `prepare` computed, for exact A*; None before, and after a cell has become cheaper."""
        self._model, self._ask_from = model, ask_from
        self._learned: LearnedRegions | None = None
        self._auto: MapChoice | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self.grid.rows, self.grid.cols

    def use_model(self, model: str | Path | NetworkModel) -> None:
        """Ask this network from now on. A name or a file is loaded and tried now; on an error the old one stays.

        Raises
        ------
        ModelError
            The model cannot be loaded.
        """
        if not isinstance(model, NetworkModel):
            model = NetworkModel(model)
            model.run()
        self._model, self._learned, self._auto = model, None, None

    def load_network(self) -> None:
        """Do now what the first query of ``nnpp`` would: load the network and show it the map.

        Raises
        ------
        ModelError
            The model cannot be loaded.
        """
        self._regions().look(self.pyramid.levels[self._top], self._top)

    def update(self, row: int, col: int, patch: Float2D) -> int:
        """Put new costs into the map, with the pyramid and the network's view kept up to date.

        Parameters
        ----------
        row, col : int
            Where the patch's first cell goes.
        patch : (h, w) float
            New costs; must lie inside the map.

        Returns
        -------
        int
            Number of cells that are other ones now.

        Raises
        ------
        InvalidMapError
            The patch does not lie inside the map, or holds a cost out of range. The map is as it was.
        """
        return self.take(row, col, patch).cells

    def take(self, row: int, col: int, patch: Float2D, *, keep: bool = False) -> Change:
        """As `update`; what has changed, and with `keep` what stood there. For subclasses to override."""
        grid = self.grid
        before = grid.least, grid.greatest
        change = grid.update(patch, (row, col), keep=keep)
        if not change.cells:
            return change
        if change.cheaper:
            self.landmarks = None
        part, cells = change.part, change.cells
        if grid.model.kind is StepCost.LENGTH and before != (grid.least, grid.greatest):
            part, cells = (0, 0, grid.rows, grid.cols), grid.cells  # coarse cells and the network's view go by these
        self.pyramid.update(part)
        if self._learned is not None:
            self._learned.update(part, cells)
        return change

    def prepare(self, *, landmarks: int = 0, goals: Sequence[Cell] = ()) -> None:
        """Compute costs once for this map, so that ``astar`` expands a fraction of the cells, for the same optimum.

        Worth it for many queries on a map that stays, or whose cells only become dearer: a patch that makes a
        cell cheaper undoes it. Each landmark and goal takes one search of the whole map, several times an A*'s
        work, and 4 bytes a cell.

        Parameters
        ----------
        landmarks : int
            Cells spread over the map, for queries between any two places; 8 serve well.
        goals : sequence of (row, col)
            Passable cells, for queries to (or from) them: the search then goes straight along the path.

        Raises
        ------
        InvalidQueryError
            More than 8 in all, or a goal that is outside the map or impassable.
        """
        if not 0 <= landmarks + len(goals) <= LANES:
            raise InvalidQueryError(f"landmarks and goals must be at most {LANES}, got {landmarks + len(goals)}")
        self.landmarks = Landmarks(self.grid, self.pyramid.levels[0].workspace, corner_cutting=self.corner_cutting)
        for goal in goals:
            cell = as_cell(goal, "goal")
            if problem := problem_with(self.grid, cell, cell):
                raise InvalidQueryError(f"goal {cell}: {problem.removeprefix('START_').lower().replace('_', ' ')}")
            self.landmarks.add(cell)
        self.landmarks.spread(landmarks + len(goals))

    def nearest(
        self, start: Cell, goals: Sequence[Cell], *, count: int = 1, **options: Any
    ) -> list[tuple[int, Plan]]:
        """Paths to the goals that cost least to reach, cheapest first.

        Parameters
        ----------
        start : (row, col)
            A cell.
        goals : sequence of (row, col)
            At least one.
        count : int
            How many are wanted.
        **options
            As for `plan`. Only exact methods are certain to know the order of goals that are nearly as near.

        Returns
        -------
        list of (int, Plan)
            Numbers of the goals and the plans that lead there; last those that cannot be reached, if fewer than
            `count` can. Goals that cannot be among the nearest, by the octile distance, are not planned to.

        Raises
        ------
        InvalidQueryError
            There is no goal, or as `plan`.
        """
        if not len(goals):
            raise InvalidQueryError("wanted at least one goal, got none")
        cells, begin = [as_cell(goal, "goal") for goal in goals], as_cell(start, "start")
        straight, diagonal = self.grid.prices
        bounds = [octile.py_func(*begin, *cell, straight, diagonal) for cell in cells]
        plans: dict[int, Plan] = {}
        for at in sorted(range(len(cells)), key=bounds.__getitem__):
            known = sorted(plan.cost for plan in plans.values())
            if len(known) >= count and known[count - 1] <= bounds[at]:
                break
            plans[at] = self.plan(begin, cells[at], **options)
        return sorted(plans.items(), key=lambda item: (not item[1].ok, item[1].cost))[:count]

    def plan(
        self,
        start: Cell,
        goal: Cell,
        *,
        method: str = Method.AUTO,
        epsilon: float = math.inf,
        time_limit_s: float = math.inf,
        cancelled: Callable[[], bool] | None = None,
    ) -> Plan:
        """A path from start to goal.

        Parameters
        ----------
        start, goal : (row, col)
            Cells.
        method : str
            ``astar``: exact, over the whole map. ``corridor``: coarse to fine. ``nnpp``: inside the network's
            region; goals nearer than `ask_from` by A*, where the way is not long. ``auto``: one of
            them, by what `nnpp-edge profile --save-choice` measured on this machine, else by the figures in
            docs/decisions.md; the plan says which and why.
        epsilon : float
            Keep widening until the path is certain to cost at most (1 + epsilon) times the optimum; 0 gives
            the optimum itself. By default the first path found is taken.
        time_limit_s : float
            After this the status is TIMEOUT, with the path as far as it had come.
        cancelled : callable
            Asked now and then; True ends the planning as a time limit does.

        Returns
        -------
        Plan
            Where a region fails it is widened, then the whole map is searched: NO_PATH means that there is
            none.

        Raises
        ------
        InvalidQueryError
            Start or goal are not two integers, or there is no such method.
        ModelError
            ``nnpp`` was asked for and the model cannot be loaded.
        """
        began = time.perf_counter()
        if not epsilon >= 0.0:
            raise InvalidQueryError(f"epsilon must be a number of at least 0, got {epsilon}")
        start, goal = as_cell(start, "start"), as_cell(goal, "goal")
        chosen, reason = self._choose(method, start, goal)
        if problem := problem_with(self.grid, start, goal):
            return Plan(problem, chosen, by=chosen, reason=reason)
        deadline = time.monotonic() + time_limit_s
        query = Query(start, goal, self.corner_cutting, deadline, cancelled, epsilon, chosen, reason)
        plan = None
        if method == Method.AUTO and chosen is Method.ASTAR:
            plan = self.search_briefly(query, chosen)
            if plan is None:
                chosen = query.by = Method.CORRIDOR
                query.reason += ", but the way is long"
        plan = plan or self.answer(query, chosen)
        query.timings["total"] = 1e3 * (time.perf_counter() - began)
        return plan

    def answer(self, query: Query, method: Method) -> Plan:
        """`plan`, by a method that is not ``auto``, for a query between two passable cells."""
        if method is Method.NNPP:
            return self._plan_nnpp(query)
        if method is Method.CORRIDOR:
            return self._plan_corridor(query)
        return self._plan_map(query, Method.ASTAR, Source.MAP)

    def search_briefly(self, query: Query, method: Method) -> Plan | None:
        """Exact A* over the whole map; None where the way to the goal turns out too long for its distance."""
        found = self._search(query, 0, None, limit=_BRIEFLY + 2 * query.apart**2)
        return None if found.status is Status.TIMEOUT else self._answer(query, method, Source.MAP, found, None)

    def _choose(self, method: str, start: Cell, goal: Cell) -> tuple[Method, str]:
        try:
            asked = Method(method)
        except ValueError:
            raise InvalidQueryError(f"method must be one of {', '.join(Method)}, got {method!r}") from None
        if asked is not Method.AUTO:
            return asked, ""
        if self._auto is None:
            self._auto = choice_for(self.shape, self._model)
        return self._auto.pick(max(abs(start[0] - goal[0]), abs(start[1] - goal[1])))

    def _search(
        self, query: Query, level: int, region: Region | None, band: float = 0.0, limit: int | None = None
    ) -> Search:
        """Search one level of the pyramid between the cells that hold start and goal; coarse ones from the goal.

        For subclasses to override. Level 0 is the map itself; without a region all of it is searched. `band` is how
        far beyond the optimum, as a share of it, a coarse search goes on; after `limit` expansions a search gives
        up. What was expanded and the time it took are booked in the query.
        """
        factor = FACTOR**level
        start, goal = ((row // factor, col // factor) for row, col in (query.start, query.goal))
        if level:
            start, goal = goal, start
        found = self.pyramid.levels[level].search(
            start,
            goal,
            region,
            landmarks=self.landmarks if level == 0 else None,
            corner_cutting=query.corner_cutting or level > 0,
            beyond=band,
            limit=limit,
            deadline=query.deadline,
            cancelled=query.cancelled,
        )
        query.expansions += found.expansions
        query.lap("coarse" if level else "search")
        return found

    def _descend(
        self, query: Query, top: int, region: Region | None, corridor: _Corridor
    ) -> tuple[Search | None, Region | None]:
        """From level `top` down, each level inside a corridor around the path on the one above.

        The search at full resolution and its region; None where a coarse level found no way.
        """
        nearby = FACTOR * corridor.nearby / max(query.apart, FACTOR)
        for level in range(top, 0, -1):
            spread, slack = corridor.radius, corridor.band + nearby
            if level > 1:
                spread, slack = spread + corridor.coarse_radius, slack + corridor.coarse_band
            at, finer = self.pyramid.levels[level], self.pyramid.levels[level - 1]
            found = self._search(query, level, region, slack)
            if found.status is Status.NO_PATH:
                return None, None
            if found.status is Status.TIMEOUT:  # a coarse path leads nowhere on the map
                return Search(Status.TIMEOUT, np.empty((0, 2), np.int32), 0, math.inf), None
            start = (query.start[0] // FACTOR**level, query.start[1] // FACTOR**level)
            region = at.around(found, start, spread, slack, finer)
            at.invest()
            query.lap("coarse")
        return self._search(query, 0, region), region

    def _coarsest(self, query: Query) -> int:
        """The level to begin at: where start and goal are close, a finer one than the last."""
        level = len(self.pyramid.levels) - 1
        while level > 1 and query.apart < _CELLS_APART * FACTOR**level:
            level -= 1
        return level

    def _plan_map(self, query: Query, method: Method, source: Source) -> Plan:
        return self._answer(query, method, source, self._search(query, 0, None), None)

    def _plan_corridor(self, query: Query) -> Plan:
        for corridor, source in zip(_CORRIDORS, (Source.REGION, Source.WIDENED), strict=True):
            found, region = self._descend(query, self._coarsest(query), None, corridor)
            if found is not None and found.status is not Status.NO_PATH:
                plan = self._answer(query, Method.CORRIDOR, source, found, region)
                if query.suffices(plan):
                    return plan
        return self._plan_map(query, Method.CORRIDOR, Source.FALLBACK)

    def _plan_nnpp(self, query: Query) -> Plan:
        if query.apart < self._ask_from and (plan := self.search_briefly(query, Method.NNPP)) is not None:
            return plan
        learned, top = self._regions(), self._top
        for region, source in learned.regions(query, self.pyramid.levels[top], top):
            found, searched = self._descend(query, top, region, _IN_LEARNED_REGION)
            if found is not None and found.status is not Status.NO_PATH:
                plan = self._answer(query, Method.NNPP, source, found, searched)
                if query.suffices(plan):
                    return plan
        return self._plan_map(query, Method.NNPP, Source.FALLBACK)

    @property
    def _top(self) -> int:
        """Number of the level that a learned region is searched on first."""
        return len(self.pyramid.levels) - 1 if max(self.shape) >= _REFINE_FROM else 0

    def _regions(self) -> LearnedRegions:
        if self._learned is None:
            self._learned = LearnedRegions(self.grid, self._model, self.overlooked)
        return self._learned

    def _answer(self, query: Query, method: Method, source: Source, found: Search, region: Region | None) -> Plan:
        """The plan that a search of the map or a region of it comes to. For subclasses to call."""
        cost = length = traverse_cost = math.inf
        if len(found.path):
            cost, length, traverse_cost = measure(self.grid, found.path)
        bound = 0.0
        if found.status is Status.OK:
            # g is kept in float32: a refused cell's f may be too high by its rounding
            bound = min(cost, found.refused_f * (1.0 - 1e-6))
        query.lap("path")
        return Plan(
            found.status, method, source, found.path, cost, length, traverse_cost, bound, query.expansions,
            region, query.network_region, query.threshold, query.by, query.reason or query.account, query.timings,
        )  # fmt: skip


def plan_path(
    cost: Float2D,
    start: Cell,
    goal: Cell,
    method: str = Method.AUTO,
    step_cost: str = "paper",
    corner_cutting: bool = True,
    omega: float = PAPER_OMEGA,
    *,
    model: str | Path | NetworkModel = "edge",
    epsilon: float = math.inf,
    time_limit_s: float = math.inf,
) -> Plan:
    """Plan once; the arguments are those of `Planner` and `Planner.plan`."""
    planner = Planner(cost, step_cost=step_cost, omega=omega, corner_cutting=corner_cutting, model=model)
    return planner.plan(start, goal, method=method, epsilon=epsilon, time_limit_s=time_limit_s)
