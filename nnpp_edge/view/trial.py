"""One tab's trial: a map by its limits, a planner on it, and the newest plan."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from statistics import median

import msgspec
import numpy as np

from nnpp_edge.runtime import Plan, Planner, Traversability, traversability_cost
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.runtime.planners.query import PlannerOptions
from nnpp_edge.view.asked import METHODS, Asked, changed
from nnpp_edge.view.ground import Ground
from nnpp_edge.view.mending import Mended, Mending

IMPASSABLE = 1.0
"""Traversability cost of an obstacle."""
_REPEATS = 3
_LONG_MS = 100.0
"""A plan that takes longer is not repeated for its median time."""
_TRIED = 256
"""Cells along a side that are tried as first ends."""
MOST_OBSTACLES = 200


@dataclass(frozen=True)
class Compared:
    """A method's plan, kept with its region, the median time, and exact A*'s cost on the same map."""

    plan: Plan
    time_ms: float
    optimum: float

    @property
    def gap(self) -> float | None:
        """Share above the optimum; None without both paths."""
        if not (self.plan.ok and np.isfinite(self.optimum)):
            return None
        return (self.plan.cost - self.optimum) / abs(self.optimum) if self.optimum else 0.0


class Trial:
    """What one tab asks of the ground, and the answers. Serves one thread at a time.

    Parameters
    ----------
    ground : Ground
        Shared with other tabs, and never changed.
    asked : Asked
        The first question.

    Raises
    ------
    NnppEdgeError
        The map is too large for the memory that is left, or the question makes no sense. Later ones raise it too, and
        leave everything as it was.
    """

    def __init__(self, ground: Ground, asked: Asked) -> None:
        self.ground = ground
        self._ask(asked)

    def _ask(self, asked: Asked) -> None:
        """Another map and planner, and all that belongs to them."""
        self._vehicle, limits = asked.vehicle(self.ground), asked.limits
        dem = self.ground.dem
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            cost = traversability_cost(dem.elevation, dem.cell_size_m, limits, cell_width_m=dem.cell_width_m)
        planner = self._planner_of(asked, cost)
        self.asked, self.cost, self.planner = asked, cost, planner
        self.warnings = [str(warning.message) for warning in told]
        self._mending: Mending | None = None
        self._mended: tuple[Rectangle, ...] = ()
        self._optimum: tuple[Cell, Cell, float] | None = None
        for part in asked.obstacles:
            self._lay(part)
        self.replan()

    def _planner_of(self, asked: Asked, cost: Float2D) -> Planner:
        given: PlannerOptions = {"omega": asked.weight, "corner_cutting": asked.corner_cutting, "model": "edge"}
        self.by_costs = self._vehicle is None and asked.slope_cost == "paper"
        if self.by_costs:
            return Planner(cost, **given)
        dem, mobility = self.ground.dem, asked.chosen(self.ground).mobility
        return Planner.of_elevation(
            dem.elevation,
            dem.cell_size_m,
            asked.limits,
            cell_width_m=dem.cell_width_m,
            vehicle=self._vehicle,
            step_cost=asked.slope_cost,
            mobility=mobility,
            warn=False,
            **given,
        )

    def change(self, values: dict[str, object]) -> bool:
        """Ask with other values of `Asked`, by their names; whether that is another map."""
        asked = changed(self.asked, values)
        self._check(asked)
        if another := not asked.same_map(self.asked) or asked.obstacles != self.asked.obstacles:
            self._ask(asked)
            return another
        self.asked = asked
        self.replan()
        return another

    def replan(self) -> Plan:
        """Plan anew between the ends by the method that is asked for."""
        self.plan = self._plan_by(self.asked.method)
        return self.plan

    def _plan_by(self, method: str, *, keep_regions: bool = False) -> Plan:
        asked, refine = self.asked, self.asked.freed
        plan = self.planner.plan(asked.start, asked.goal, method=method, refine=refine, keep_regions=keep_regions)
        mobility = asked.chosen(self.ground).mobility
        return replace(plan, along=Along.of(plan.line, self.ground.dem.elevation, self.ground.sides_m, mobility))

    def compare(self, method: str) -> Compared:
        """Plan by one of the methods beside the others, and with its region."""
        if method not in METHODS:
            raise InvalidQueryError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
        plans = [self._plan_by(method, keep_regions=True)]
        if plans[0].timings_ms.get("total", _LONG_MS) < _LONG_MS:
            plans += [self._plan_by(method, keep_regions=True) for _ in range(_REPEATS)]
        times = [plan.timings_ms.get("total", 0.0) for plan in plans[1:] or plans]
        return Compared(plans[-1], median(times), self._optimal_cost())

    def _optimal_cost(self) -> float:
        """Of exact A* between the ends; kept until they or the map change."""
        ends = self.asked.start, self.asked.goal
        if self._optimum is None or self._optimum[:2] != ends:
            self._optimum = (*ends, self._plan_by("astar").cost)
        return self._optimum[2]

    def paint(self, part: Rectangle) -> None:
        """Make the cells of a rectangle, clipped to the map, impassable, and plan anew."""
        clipped = self._clipped(part)
        if len(self.asked.obstacles) >= MOST_OBSTACLES:
            raise InvalidQueryError(f"wanted at most {MOST_OBSTACLES} obstacles: undo some")
        self._put((*self.asked.obstacles, clipped), clipped)

    def mend(self) -> Mended:
        """What it takes to mend the path for the obstacles that came or went since the last time, else for the last."""
        obstacles = self.asked.obstacles
        mending = self._mending
        if mending is None or mending.goal != self.asked.goal:
            mending = Mending(self.ground, self.asked, self._costs_below(obstacles[-1:]), self._vehicle)
            if not self.by_costs:
                mending.lay([(part, self._patch(part, obstacles[:-1])) for part in obstacles[:-1]])
            self._mended = obstacles[:-1]
        changed = [part for part in (*self._mended, *obstacles) if (part in self._mended) != (part in obstacles)]
        mended = mending.mend(self.asked.start, [(part, self._patch(part, obstacles)) for part in changed])
        self._mending, self._mended = mending, obstacles
        return mended

    def _costs_below(self, parts: Iterable[Rectangle]) -> Float2D | None:
        """The costs that are planned on without the last obstacles; None where elevations are."""
        if not self.by_costs:
            return None
        cost = self.cost.copy()
        for row, col, rows, cols in parts:
            patch = self._patch((row, col, rows, cols), self.asked.obstacles[:-1])
            cost[row : row + rows, col : col + cols] = patch
        return cost

    def undo(self) -> bool:
        """Take the last obstacle away; whether there was one."""
        if not self.asked.obstacles:
            return False
        *rest, part = self.asked.obstacles
        self._put(tuple(rest), part)
        return True

    def clear(self) -> None:
        """Take all obstacles away."""
        while self.undo():
            pass

    def _put(self, obstacles: tuple[Rectangle, ...], part: Rectangle) -> None:
        self.asked = msgspec.structs.replace(self.asked, obstacles=obstacles)
        self._optimum = None
        self._lay(part)
        self.replan()

    def _lay(self, part: Rectangle) -> None:
        """Bring the planner and the shown costs up to date in a rectangle."""
        row, col, rows, cols = part
        patch = self._patch(part, self.asked.obstacles)
        if self.by_costs:
            self.planner.update(row, col, patch)
            self.cost[row : row + rows, col : col + cols] = np.where(patch < IMPASSABLE, patch, np.inf)
            return
        self.planner.update_elevation(row, col, patch)
        bare = self._bare_costs(part)
        self.cost[row : row + rows, col : col + cols] = np.where(np.isfinite(patch), bare, np.inf)

    def _patch(self, part: Rectangle, obstacles: Iterable[Rectangle]) -> Float2D:
        """Costs of a rectangle, or its heights where those are planned on, with these obstacles in it.

        An obstacle is ground of cost 1; on a map of elevations it is unknown ground, which no vehicle enters.
        """
        row, col, rows, cols = part
        if self.by_costs:
            patch, value = self._bare_costs(part), IMPASSABLE
        else:
            patch, value = self.ground.dem.elevation[row : row + rows, col : col + cols].copy(), np.nan
        for top, left, high, wide in obstacles:
            patch[max(top - row, 0) : max(top + high - row, 0), max(left - col, 0) : max(left + wide - col, 0)] = value
        return patch

    def _bare_costs(self, part: Rectangle) -> Float2D:
        """Of a rectangle without obstacles."""
        (row, col, rows, cols), dem = part, self.ground.dem
        top, left = max(row - 1, 0), max(col - 1, 0)
        heights = dem.elevation[top : row + rows + 1, left : col + cols + 1].copy()
        found = traversability_cost(
            heights, dem.cell_size_m, self.asked.limits, cell_width_m=dem.cell_width_m, warn=False
        )
        return found[row - top : row - top + rows, col - left : col - left + cols].copy()

    def _clipped(self, part: Rectangle) -> Rectangle:
        (row, col, rows, cols), (height, width) = part, self.ground.dem.shape
        row0, col0, row1, col1 = max(row, 0), max(col, 0), min(row + rows, height), min(col + cols, width)
        if rows < 1 or cols < 1 or row0 >= row1 or col0 >= col1:
            raise InvalidQueryError(f"an obstacle must cover cells of the map of {(height, width)}, got {part}")
        return row0, col0, row1 - row0, col1 - col0

    def _check(self, asked: Asked) -> None:
        """Refuse obstacles that do not lie on the map."""
        for part in asked.obstacles:
            if self._clipped(part) != part:
                raise InvalidQueryError(f"an obstacle must lie inside the map of {self.ground.dem.shape}, got {part}")


def likely_ends(ground: Ground, limits: Traversability) -> tuple[Cell, Cell]:
    """A start and a goal to begin with: the passable cells nearest to a tenth and to nine tenths of both sides."""
    dem, (rows, cols) = ground.dem, ground.dem.shape
    cost = traversability_cost(dem.elevation, dem.cell_size_m, limits, cell_width_m=dem.cell_width_m, warn=False)
    apart = max(rows // _TRIED, 1), max(cols // _TRIED, 1)
    passable = np.argwhere(cost[:: apart[0], :: apart[1]] < IMPASSABLE) * apart
    if not len(passable):
        raise InvalidMapError(f"{dem.source}: wanted a map to plan on, got {rows} × {cols} cells, all impassable")
    ends = []
    for share in (0.1, 0.9):
        nearest = np.abs(passable - (share * (rows - 1), share * (cols - 1))).max(1).argmin()
        row, col = passable[nearest].tolist()
        ends.append((row, col))
    return ends[0], ends[1]
