"""The map of one set of limits, the planner on it, and painted obstacles."""

import threading
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from nnpp_edge.runtime import Plan, Planner
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.runtime.terrain.traversability import traversability_cost
from nnpp_edge.view.asked import Asked
from nnpp_edge.view.site import Site

IMPASSABLE = 1.0
"""Traversability cost of an obstacle."""
_TRIED = 256
"""Cells along a side that are tried as first ends."""
_LOOKED_AT = 1000
"""Of these for each end, where a vehicle's poses must be checked."""
_ONE_RECORDS = threading.Lock()
"""Recording warnings is of the whole process."""


class Landscape:
    """The ground by the limits, vehicle and step cost that are asked for. Serves one thread at a time.

    Obstacles are costs told to a map of heights. NnppEdgeError if the map is too large for the memory that is left,
    or what is asked makes no sense.
    """

    def __init__(self, site: Site, asked: Asked) -> None:
        self.ground = asked.ground(site)
        self.mobility = asked.chosen(site).mobility
        with _ONE_RECORDS, warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            self.cost = self._costs_of(site.dem.elevation, warn=True)
            """(H, W) traversability costs, inf where impassable or painted."""
        self.warnings = [str(warning.message) for warning in told]
        self._heights = site.dem.elevation
        self._planner = Planner(self.ground, omega=asked.weight, corner_cutting=asked.corner_cutting, model="edge")
        for part in asked.obstacles:
            self.lay(part, asked.obstacles)

    def plan(self, asked: Asked, method: str, *, keep_regions: bool = False) -> Plan:
        """Plan between the ends that are asked for, with what lies along the path."""
        plan = self._planner.plan(
            asked.start, asked.goal, method=method, refine=asked.freed, keep_regions=keep_regions
        )
        along = Along.of(plan.line, self._heights, self.ground.sides_m, self.mobility, plan.along)
        return replace(plan, along=along)

    def stands(self, cell: Cell) -> bool:
        """Whether a path may begin or end in a cell of the map."""
        return self._planner.state.grid.is_passable(cell)

    def lay(self, part: Rectangle, obstacles: Sequence[Rectangle]) -> None:
        """Bring planner and costs up to date in a rectangle, on which these obstacles lie now."""
        row, col, rows, cols = part
        told = told_costs(part, obstacles)
        self._planner.update(row, col, told)
        top, left = max(row - 1, 0), max(col - 1, 0)  # a cell's cost depends on its neighbours' heights
        bare = self._costs_of(self._heights[top : row + rows + 1, left : col + cols + 1].copy())
        bare = bare[row - top : row - top + rows, col - left : col - left + cols]
        self.cost[row : row + rows, col : col + cols] = np.where(told < IMPASSABLE, bare, np.float32(np.inf))

    def _costs_of(self, heights: Float2D, *, warn: bool = False) -> Float2D:
        size, width = self.ground.sides_m
        return traversability_cost(heights, size, self.ground.traversability, cell_width_m=width, warn=warn)


def told_costs(part: Rectangle, obstacles: Sequence[Rectangle]) -> Float2D:
    """The costs that obstacles tell of a rectangle; 0 where none lies."""
    row, col, rows, cols = part
    told = np.zeros((rows, cols), np.float32)
    for top, left, high, wide in obstacles:
        down, right = max(top + high - row, 0), max(left + wide - col, 0)
        told[max(top - row, 0) : down, max(left - col, 0) : right] = IMPASSABLE
    return told


def likely_ends(cost: Float2D, stands: Callable[[Cell], bool] = lambda cell: True) -> tuple[Cell, Cell] | None:
    """A start and a goal to begin with: the passable cells nearest to a tenth and to nine tenths of both sides.

    Of the nearest thousand the first on which the robot `stands`, else the very nearest. None where no cell is
    passable, of those that are tried.
    """
    rows, cols = cost.shape
    apart = max(rows // _TRIED, 1), max(cols // _TRIED, 1)
    passable = np.argwhere(cost[:: apart[0], :: apart[1]] < IMPASSABLE) * apart
    if not len(passable):
        return None
    ends = []
    for share in (0.1, 0.9):
        apart_by = np.abs(passable - (share * (rows - 1), share * (cols - 1))).max(1)
        nearest = [(row, col) for row, col in passable[apart_by.argsort(kind="stable")[:_LOOKED_AT]].tolist()]
        ends.append(next(filter(stands, nearest), nearest[0]))
    return ends[0], ends[1]
