"""The map of one set of limits, the planner on it, and painted obstacles."""

import threading
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from nnpp_edge.runtime import Plan, Planner, traversability_cost
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.runtime.map.ground import Ground as PlannerGround
from nnpp_edge.runtime.planners.on_map import PlannerOptions
from nnpp_edge.view.asked import Asked
from nnpp_edge.view.ground import Ground

IMPASSABLE = 1.0
"""Traversability cost of an obstacle."""
_TRIED = 256
"""Cells along a side that are tried as first ends."""
_LOOKED_AT = 1000
"""Of these for each end, where a vehicle's poses must be checked."""
_ONE_RECORDS = threading.Lock()
"""Recording warnings is of the whole process."""


class Landscape:
    """A map by the limits, vehicle and step cost that are asked for. Serves one thread at a time.

    It plans on what `nnpp-edge plan` plans on: for a point and the paper's step costs on costs, else on elevations.

    Attributes
    ----------
    cost : (H, W) float32
        Traversability costs, inf where impassable or painted.
    by_costs : bool
        Whether costs are planned on.
    warnings : list of str
        What there is to say of the costs.

    Raises
    ------
    NnppEdgeError
        The map is too large for the memory that is left, or what is asked makes no sense.
    """

    def __init__(self, ground: Ground, asked: Asked) -> None:
        self._ground, self._limits = ground, asked.limits
        self.vehicle, self.mobility = asked.vehicle(ground), asked.chosen(ground).mobility
        self.by_costs = self.vehicle is None and asked.slope_cost == "paper"
        with _ONE_RECORDS, warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            self.cost = self._costs_of(ground.dem.elevation, warn=True)
        self.warnings = [str(warning.message) for warning in told]
        self._planner = self._make_planner(asked)
        for part in asked.obstacles:
            self.lay(part, asked.obstacles)

    def _make_planner(self, asked: Asked) -> Planner:
        given: PlannerOptions = {"omega": asked.weight, "corner_cutting": asked.corner_cutting, "model": "edge"}
        if self.by_costs:
            return Planner(self.cost, **given)
        dem = self._ground.dem
        ground = PlannerGround.of_elevation(
            dem.elevation,
            dem.cell_size_m,
            self._limits,
            cell_width_m=dem.cell_width_m,
            vehicle=self.vehicle,
            step_cost=asked.slope_cost,
            mobility=self.mobility,
        )
        return Planner(ground, **given)

    def plan(self, asked: Asked, method: str, *, keep_regions: bool = False) -> Plan:
        """Plan between the ends that are asked for, with what lies along the path."""
        plan = self._planner.plan(
            asked.start, asked.goal, method=method, refine=asked.freed, keep_regions=keep_regions
        )
        ground = self._ground
        return replace(
            plan, along=Along.of(plan.line, ground.dem.elevation, ground.sides_m, self.mobility, plan.along)
        )

    def stands(self, cell: Cell) -> bool:
        """Whether a path may begin or end in a cell of the map."""
        return self._planner.state.grid.is_passable(cell)

    def lay(self, part: Rectangle, obstacles: Sequence[Rectangle]) -> None:
        """Bring planner and costs up to date in a rectangle, on which these obstacles lie now."""
        row, col, rows, cols = part
        patch = self.patch(part, obstacles)
        if self.by_costs:
            self._planner.update(row, col, patch)
            shown = np.where(patch < IMPASSABLE, patch, np.float32(np.inf))
        else:
            self._planner.update_elevation(row, col, patch)
            shown = np.where(np.isfinite(patch), self._bare_costs(part), np.float32(np.inf))
        self.cost[row : row + rows, col : col + cols] = shown

    def patch(self, part: Rectangle, obstacles: Sequence[Rectangle]) -> Float2D:
        """What is planned on in a rectangle, costs or elevations, with these obstacles.

        An obstacle is ground of cost 1; on a map of elevations it is unknown ground, which no shipped vehicle enters.
        """
        row, col, rows, cols = part
        if self.by_costs:
            patch, value = self._bare_costs(part), IMPASSABLE
        else:
            patch, value = self._ground.dem.elevation[row : row + rows, col : col + cols].copy(), np.nan
        for top, left, high, wide in obstacles:
            down, right = max(top + high - row, 0), max(left + wide - col, 0)
            patch[max(top - row, 0) : down, max(left - col, 0) : right] = value
        return patch

    def costs_with(self, obstacles: Sequence[Rectangle], instead_of: Sequence[Rectangle]) -> Float2D | None:
        """A copy of the costs that are planned on, with other obstacles; None where elevations are."""
        if not self.by_costs:
            return None
        cost = self.cost.copy()
        for row, col, rows, cols in instead_of:
            cost[row : row + rows, col : col + cols] = self.patch((row, col, rows, cols), obstacles)
        return cost

    def _bare_costs(self, part: Rectangle) -> Float2D:
        """Of a rectangle without obstacles."""
        row, col, rows, cols = part
        top, left = max(row - 1, 0), max(col - 1, 0)
        found = self._costs_of(self._ground.dem.elevation[top : row + rows + 1, left : col + cols + 1].copy())
        return found[row - top : row - top + rows, col - left : col - left + cols].copy()

    def _costs_of(self, elevation: Float2D, *, warn: bool = False) -> Float2D:
        height, width = self._ground.sides_m
        return traversability_cost(elevation, height, self._limits, cell_width_m=width, warn=warn)


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
