"""The planner: a map, a network and scratch memory, answering one query after another."""

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.costmap import Float2D, Rectangle, as_map
from nnpp_edge.runtime.encoding import Cell, Frame, map_planes
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, Status
from nnpp_edge.runtime.grid import GREY_LEVELS, PAPER_OMEGA, Grid, StepCost, StepModel
from nnpp_edge.runtime.inference import NetworkModel
from nnpp_edge.runtime.planning.astar import Region, Search, astar
from nnpp_edge.runtime.planning.plan import Method, Plan, Source, measure
from nnpp_edge.runtime.planning.pyramid import FACTOR, Pyramid
from nnpp_edge.runtime.region import RegionFinder

_NEAR = 48
"""Cells; nearer goals `auto` leaves to plain A*, which is then faster than a network's answer."""
_REFINE_FROM = 192
"""Cells on a map's longer side from which a learned region is searched coarsely first."""
_CORRIDOR_RADII = (1, 4)
"""Dilation of the coarse path, in coarse cells: at first, and widened."""
_COARSE_MARGIN = 2
"""Coarse cells by which a corridor between two coarse levels is wider: room costs little there."""
_WIDENED_FACTOR = 0.25
"""What the threshold is multiplied by to widen a learned region."""


@dataclass
class _Query:
    """One query as it goes through the stages."""

    start: Cell
    goal: Cell
    corner_cutting: bool
    deadline: float
    cancelled: Callable[[], bool] | None
    epsilon: float
    expansions: int = 0
    timings: dict[str, float] = field(default_factory=dict)
    _mark: float = field(default_factory=time.perf_counter)

    def suffices(self, plan: Plan) -> bool:
        """Whether a plan need not be improved: it is out of time, or close enough to the bound asked for."""
        return plan.status is not Status.OK or plan.cost <= (1.0 + self.epsilon) * plan.lower_bound

    def lap(self, stage: str) -> None:
        """Book the time since the last call."""
        now = time.perf_counter()
        self.timings[stage] = self.timings.get(stage, 0.0) + 1e3 * (now - self._mark)
        self._mark = now


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

    Raises
    ------
    InvalidMapError
        The map is not two-dimensional, is empty, or holds a cost out of range.
    """

    def __init__(
        self,
        cost: Float2D,
        *,
        step_cost: str = "paper",
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        model: str | Path | NetworkModel = "edge",
    ) -> None:
        self.grid = Grid.of(cost, StepModel.of(step_cost, omega))
        self.pyramid = Pyramid(self.grid, corner_cutting)
        self.corner_cutting = corner_cutting
        self._model = model
        self._learned: _LearnedRegions | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self.grid.rows, self.grid.cols

    def update(self, row: int, col: int, patch: Float2D) -> None:
        """Put new costs into the map, with the pyramid and the network's view kept up to date.

        Parameters
        ----------
        row, col : int
            Where the patch's first cell goes.
        patch : (h, w) float
            New costs; must lie inside the map.
        """
        patch = as_map(patch, "patch")
        row, col = int(row), int(col)
        part = (row, col, *patch.shape)
        if row < 0 or col < 0 or row + patch.shape[0] > self.grid.rows or col + patch.shape[1] > self.grid.cols:
            raise InvalidMapError(f"a patch must lie inside the map of {self.shape}, got {part}")
        self.grid.update(patch, part, (row, col))
        self.pyramid.update(part)
        if self._learned is not None:
            self._learned.update(part)

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
            region. ``auto``: whichever is soonest done by the figures in docs/decisions.md; the plan says which
            and why.
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
        start, goal = _as_cell(start, "start"), _as_cell(goal, "goal")
        chosen, reason = self._choose(method, start, goal)
        if problem := self._problem(start, goal):
            return Plan(problem, chosen, reason=reason)
        query = _Query(start, goal, self.corner_cutting, time.monotonic() + time_limit_s, cancelled, epsilon)
        if chosen is Method.NNPP:
            plan = self._plan_nnpp(query)
        elif chosen is Method.CORRIDOR:
            plan = self._plan_corridor(query)
        else:
            plan = self._plan_map(query, Method.ASTAR, Source.MAP)
        query.timings["total"] = 1e3 * (time.perf_counter() - began)
        return replace(plan, reason=reason)

    def _choose(self, method: str, start: Cell, goal: Cell) -> tuple[Method, str]:
        if method not in list(Method):
            raise InvalidQueryError(f"method must be one of {', '.join(Method)}, got {method!r}")
        if method != Method.AUTO:
            return Method(method), ""
        if max(abs(start[0] - goal[0]), abs(start[1] - goal[1])) < _NEAR:
            return Method.ASTAR, f"the goal is less than {_NEAR} cells away"
        return Method.CORRIDOR, "soonest done by the shipped figures"

    def _problem(self, start: Cell, goal: Cell) -> Status | None:
        for cell, outside, blocked in (
            (start, Status.START_OUTSIDE_MAP, Status.START_BLOCKED),
            (goal, Status.GOAL_OUTSIDE_MAP, Status.GOAL_BLOCKED),
        ):
            if not (0 <= cell[0] < self.grid.rows and 0 <= cell[1] < self.grid.cols):
                return outside
            if not self.grid.is_passable(*cell):
                return blocked
        return None

    def _search(self, query: _Query, level: int, region: Region | None) -> Search:
        """Search one level of the pyramid between the cells that hold start and goal."""
        factor = FACTOR**level
        at = self.pyramid.levels[level]
        found = astar(
            at.grid,
            (query.start[0] // factor, query.start[1] // factor),
            (query.goal[0] // factor, query.goal[1] // factor),
            at.workspace,
            region=region,
            links=at.links,
            corner_cutting=query.corner_cutting or level > 0,
            deadline=query.deadline,
            cancelled=query.cancelled,
        )
        query.expansions += found.expansions
        query.lap("coarse" if level else "search")
        return found

    def _descend(
        self, query: _Query, top: int, region: Region | None, radius: int
    ) -> tuple[Search | None, Region | None]:
        """From level `top` down, each level inside a corridor around the path on the one above.

        The search at full resolution and its region; None where a coarse level found no way.
        """
        for level in range(top, 0, -1):
            found = self._search(query, level, region)
            if found.status is Status.NO_PATH:
                return None, None
            if found.status is Status.TIMEOUT:  # a coarse path leads nowhere on the map
                return Search(Status.TIMEOUT, np.empty((0, 2), np.int32), 0, math.inf), None
            levels = self.pyramid.levels
            spread = radius if level == 1 else radius + _COARSE_MARGIN
            region = levels[level].around(found.path, spread, levels[level - 1])
            query.lap("coarse")
        return self._search(query, 0, region), region

    def _plan_map(self, query: _Query, method: Method, source: Source) -> Plan:
        return self._answer(query, method, source, self._search(query, 0, None), None)

    def _plan_corridor(self, query: _Query) -> Plan:
        for radius, source in zip(_CORRIDOR_RADII, (Source.REGION, Source.WIDENED), strict=True):
            found, region = self._descend(query, len(self.pyramid.levels) - 1, None, radius)
            if found is not None and found.status is not Status.NO_PATH:
                plan = self._answer(query, Method.CORRIDOR, source, found, region)
                if query.suffices(plan):
                    return plan
        return self._plan_map(query, Method.CORRIDOR, Source.FALLBACK)

    def _plan_nnpp(self, query: _Query) -> Plan:
        if self._learned is None:
            self._learned = _LearnedRegions(self.grid, self._model)
        learned = self._learned
        td = learned.infer(query)
        network_region = learned.region(td, query)
        refine = max(self.shape) >= _REFINE_FROM
        top = len(self.pyramid.levels) - 1 if refine else 0
        plan = None
        for threshold, dilation, source in (
            (td * learned.factor, 0, Source.REGION),
            (td * learned.factor * _WIDENED_FACTOR, 1, Source.WIDENED),
            (0.0, 0, Source.WIDENED),
        ):
            region = None
            if threshold:
                wanted = learned.region(threshold, query, dilation)
                region = learned.at_level(wanted, self.pyramid.levels[top].grid, top)
            elif not refine:
                break  # the whole map at full resolution is the fallback's
            found, searched = self._descend(query, top, region, 1)
            if found is not None and found.status is not Status.NO_PATH:
                plan = self._answer(query, Method.NNPP, source, found, searched)
                if query.suffices(plan):
                    break
                plan = None
        plan = plan or self._plan_map(query, Method.NNPP, Source.FALLBACK)
        return replace(plan, threshold=td, network_region=network_region)

    def _answer(self, query: _Query, method: Method, source: Source, found: Search, region: Region | None) -> Plan:
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
            region, timings_ms=query.timings,
        )  # fmt: skip


class _LearnedRegions:
    """The network's side of a planner: its view of the map, and regions from its answers."""

    def __init__(self, grid: Grid, model: str | Path | NetworkModel) -> None:
        self.model = model if isinstance(model, NetworkModel) else NetworkModel(model)
        size, blocks = self.model.metadata.input_size, self.model.metadata.blocks
        scale, trained = grid.model.scale, GREY_LEVELS * self.model.metadata.omega
        if grid.model.kind is StepCost.PAPER and not 0.5 * trained <= scale <= 2.0 * trained:
            warnings.warn(
                f"the network {self.model.metadata.name} was trained for omega = {self.model.metadata.omega:g}, "
                f"the planner uses {scale / GREY_LEVELS:g}: its regions may miss the optimum by more than stated",
                stacklevel=4,
            )
        self.grid = grid
        self.frame = Frame(grid.rows, grid.cols, size)
        self.lookup = self.frame.lookup(blocks)
        self.factor = self.model.metadata.region_factor
        self.planes: NDArray[np.float32] = np.empty((2, size, size), np.float32)
        # two finders, so that the region at td itself stays while wider ones are searched
        self.finder, self.at_td = RegionFinder(blocks), RegionFinder(blocks)
        self._level_lookups: dict[int, tuple[NDArray[np.int32], NDArray[np.int32]]] = {0: self.lookup}
        self.update(None)

    def update(self, changed: Rectangle | None) -> None:
        """Bring the network's view up to date with the grid, where it changed or all over."""
        map_planes(
            self.grid.weights,
            self.grid.stride,
            self.frame,
            *self.grid.as_traversability(),
            self.planes,
            changed,
        )
        self.stale = True

    def infer(self, query: _Query) -> float:
        """Ask the network; the adaptive threshold, in [0, 1]."""
        if self.stale or self.model.owner is not self:
            self.model.set_map(self.planes)
            self.model.owner = self
            self.stale = False
        self.model.set_query(self.frame.place(query.start), self.frame.place(query.goal))
        query.lap("encode")
        probability = self.model.run()
        query.lap("inference")
        self.finder.read(probability)
        td = self.finder.threshold(self._block(query.start), self._block(query.goal))
        self.at_td.levels[:] = self.finder.levels
        query.lap("threshold")
        return td / 256.0

    def _block(self, cell: Cell) -> Cell:
        return int(self.lookup[0][cell[0]]), int(self.lookup[1][cell[1]])

    def region(self, threshold: float, query: _Query, radius: int | None = None) -> Region:
        """The region at a threshold in [0, 1]; without a radius, the one kept for the figures."""
        finder = self.at_td if radius is None else self.finder
        level = max(int(threshold * 256.0), 1)
        stamp = finder.mark(level, self._block(query.start), self._block(query.goal), radius or 0)
        query.lap("threshold")
        return Region(finder.bitmap, *self.lookup, stamp)

    def at_level(self, region: Region, grid: Grid, level: int) -> Region:
        """The same region as a coarser level of the pyramid reads it."""
        if level not in self._level_lookups:
            factor = FACTOR**level
            rows = np.minimum(np.arange(grid.rows) * factor + factor // 2, self.grid.rows - 1)
            cols = np.minimum(np.arange(grid.cols) * factor + factor // 2, self.grid.cols - 1)
            self._level_lookups[level] = (self.lookup[0][rows], self.lookup[1][cols])
        return Region(region.bitmap, *self._level_lookups[level], region.stamp)


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


def _as_cell(cell: Cell, name: str) -> Cell:
    try:
        row, col = cell
        if int(row) == row and int(col) == col:
            return int(row), int(col)
    except (TypeError, ValueError):
        pass
    raise InvalidQueryError(f"{name} must be two whole numbers (row, col), got {cell!r}")
