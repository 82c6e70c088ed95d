"""A robot in the simulation: what stands where, by costs or by heights. Its ground is the runtime's
`Ground`.
"""

import math
from dataclasses import replace

import cv2
import numpy as np

from nnpp_edge.profiling.suites import whole_cost
from nnpp_edge.runtime import Ground, MapPatch
from nnpp_edge.runtime.arrays import Cells, Float2D
from nnpp_edge.runtime.cells import Cell, Sides
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.obstacles import OBSTACLE

_ROUNDING = 1e-4
"""Share of a limit by which a pose may exceed it: its heights are rounded otherwise than in the
loop.
"""
_SPIKE = 100.0
"""Height of an obstacle over all ground, in sides of a cell, on ground that is known coarsely."""
_LIMITS = ("clearance_m", "max_tilt_deg", "max_pitch_deg", "max_roll_deg", "max_step_m")


class SimulatedRobot:
    """A robot on costs, or on heights where it has a body or its steps cost by the slope.

    `values` is always a map (H, W) float32 of the kind that its ground holds. The scene moves
    values about and puts obstacles on them; what they mean, its robot says, of the map as it is
    given, apart from what a loop keeps of it: for a robot as large as a cell by each cell's cost,
    else by a grid that is made anew. `known` is the ground as it is known coarsely, in place of a
    survey.
    """

    def __init__(self, ground: Ground, known: Ground | None = None) -> None:
        self._known = known
        self._ground = ground
        self.vehicle = ground.vehicle
        self.sides_m = ground.sides_m
        self._by_costs = ground.elevation is None
        self._eased = ground
        self.reach = reach_of(ground.vehicle, self.sides_m)
        self.body = body = ground.body
        """Whose legs may lead to the cell after the next."""
        if body is not None:
            limits = {name: getattr(body, name) for name in _LIMITS if getattr(body, name)}
            eased = {name: limit * (1.0 + _ROUNDING) for name, limit in limits.items()}
            self._eased = replace(ground, vehicle=replace(body, **eased))

    def obstacle(self, values: Float2D) -> float:
        """The value of an obstacle's cells: the paper's cost, or unknown ground.

        To a body it is higher above every cell than the body is long: no pose reaches from the
        ground onto it.
        """
        if self._by_costs:
            return OBSTACLE
        highest = float(np.nanmax(values))
        if body := self.body:
            return highest + body.length_m + body.clearance_m + body.step_m
        return math.nan if self._known is None else highest + _SPIKE * max(self.sides_m)

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """Whether it may be in a cell of the map, in one heading at least."""
        if self.vehicle is None:
            return bool(self.costs(values)[cell] < OBSTACLE)
        return self._grid(values).is_passable(cell)

    def steps(self, values: Float2D, path: Cells) -> int:
        """Number of steps that it may take of a path (N, 2) on the map, from its first cell on."""
        if self.vehicle is None:
            rows, cols = path[1:].T
            free = self.costs(values)[rows, cols] < OBSTACLE
            return int(free.cumprod().sum())
        blocked = self._grid(values).walk(path, 0, np.empty(len(path)))
        return len(path) - 1 if blocked < 0 else max(blocked - 1, 0)

    def costs(self, values: Float2D) -> Float2D:
        """(H, W) traversability cost of each cell, to a body in its best heading; impassable from 1
        up.
        """
        if self._by_costs:
            return values
        ground = self._with(values)
        if self.vehicle is not None:
            return whole_cost(ground)
        costs = ground.costs()
        if self._known is None:
            return costs
        known = np.isfinite(values).astype(np.uint8)
        inner = cv2.erode(known, np.ones((3, 3), np.uint8))
        return np.where(inner, costs, np.float32(0.0))

    def ground(self, values: Float2D) -> Ground:
        """Itself on the map, for planners and the onboard loop."""
        return self._known or self._with(values)

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """The message that tells the loop of values."""
        if self._by_costs:
            return MapPatch(row, col, cost=values)
        return MapPatch(row, col, elevation=values)

    def _with(self, values: Float2D, *, eased: bool = False) -> Ground:
        """The ground with other values of the kind that it holds."""
        ground = self._eased if eased else self._ground
        kind = "cost" if self._by_costs else "elevation"
        return replace(ground, **{kind: values})  # type: ignore[arg-type]  # either is a map

    def _grid(self, values: Float2D) -> Grid:
        if self._known is None:
            return map_state(self._with(values, eased=True)).grid
        state = map_state(replace(self._known, vehicle=self._eased.vehicle))
        state.update_elevation(0, 0, values, np.isfinite(values))
        return state.grid


def reach_of(vehicle: Vehicle | None, sides_m: Sides) -> int:
    """Cells from a robot's own to the farthest that lies under it."""
    if vehicle is None:
        return 0
    return math.ceil(vehicle.reach_m / min(sides_m)) + 1
