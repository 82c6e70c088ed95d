"""The map of one set of limits, the planners on it, and painted obstacles."""

import warnings
from collections.abc import Callable
from statistics import median

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime import Plan, Planner
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, slices, widened
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.options import PlanOptions
from nnpp_edge.runtime.planners.plan import Method
from nnpp_edge.runtime.robots.body.poses import Poses
from nnpp_edge.runtime.terrain.traversability import traversability_cost
from nnpp_edge.view.asked import Asked, Obstacles, Site

_TRIED = 256
"""Cells along a side that are tried as first ends."""
_LOOKED_AT = 1000
"""Of these for each end, where a vehicle's poses must be checked."""
_REPEATS = 3
_LONG_MS = 100.0
"""A plan is repeated so often for its median time, unless it takes longer than that."""


class Landscape:
    """The ground by the limits, vehicle and step cost that are asked for. Serves one thread at a
    time.

    Obstacles are costs told to a map of heights. NnppEdgeError if the map is too large for the
    memory that is left, or what is asked makes no sense.
    """

    def __init__(self, site: Site, asked: Asked) -> None:
        self.ground = asked.ground(site)
        self._site = site
        dem = site.dem
        size = dem.cell_size_m
        width = dem.cell_width_m
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            self.cost = traversability_cost(dem.elevation, size, asked.limits, cell_width_m=width)
            """(H, W) traversability costs, without what is painted."""
        self.warnings = [str(warning.message) for warning in told]
        self.planner = Planner(
            self.ground,
            omega=asked.omega,
            corner_cutting=asked.corner_cutting,
            model=site.model,
        )
        self._laid: Obstacles = ()

    @property
    def poses(self) -> Poses | None:
        """Poses of the vehicle; None for a point or a disc."""
        return self.planner.state.grid.robot.moves.poses

    def lay(self, obstacles: Obstacles) -> None:
        """Plan among these obstacles from now on; InvalidQueryError where one leaves the map."""
        shape = self.cost.shape
        for part in obstacles:
            if min(part[2:]) < 1 or widened(part, (0, 0), shape) != part:
                raise InvalidQueryError(
                    f"an obstacle must lie on the map of {shape} cells, got {part}"
                )
        told = painted(shape, obstacles).astype(np.float32)
        for part in set(self._laid) ^ set(obstacles):
            self.planner.update(*part[:2], told[slices(part)])
        self._laid = obstacles

    def plan(self, asked: Asked, method: Method, *, keep_regions: bool = False) -> Plan:
        """Plan between the ends that are asked for, by way of the places between."""
        options: PlanOptions = {"method": method, "refine": asked.freed}
        options |= {"keep_regions": keep_regions, **asked.headings(self._site)}
        if asked.via:
            return self.planner.plan_via(asked.start, asked.goal, asked.via, **options).plan
        return self.planner.plan(asked.start, asked.goal, **options)

    def compare(self, asked: Asked, method: Method) -> tuple[Plan, float]:
        """A method's plan with its region, and its median time, ms."""
        plan = self.plan(asked, method, keep_regions=True)
        times_ms = [plan.timings_ms.get("total", 0.0)]
        if 0.0 < times_ms[0] < _LONG_MS:
            plans = [self.plan(asked, method, keep_regions=True) for _ in range(_REPEATS)]
            plan = plans[-1]
            times_ms = [each.timings_ms["total"] for each in plans]
        return plan, median(times_ms)


def painted(shape: tuple[int, ...], obstacles: Obstacles) -> NDArray[np.bool_]:
    """Cells (H, W) on which obstacles lie."""
    found = np.zeros(shape, np.bool_)
    for part in obstacles:
        found[slices(part)] = True
    return found


def likely_ends(
    cost: Float2D, stands: Callable[[Cell], bool] = lambda cell: True
) -> tuple[Cell, Cell] | None:
    """A start and a goal to begin with: the passable cells nearest to a tenth and to nine tenths of
    both sides.

    Of the nearest thousand the first on which the robot `stands`, else the very nearest. None where
    no cell is passable, of those that are tried.
    """
    apart = np.maximum(np.array(cost.shape) // _TRIED, 1)
    passable = np.argwhere(cost[:: apart[0], :: apart[1]] < 1.0) * apart
    if not len(passable):
        return None

    def end(share: float) -> Cell:
        far = np.abs(passable - share * (np.array(cost.shape) - 1)).max(1)
        nearest = passable[far.argsort(kind="stable")[:_LOOKED_AT]]
        cells = [(row, col) for row, col in nearest.tolist()]
        return next(filter(stands, cells), cells[0])

    return end(0.1), end(0.9)
