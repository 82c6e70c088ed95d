"""The map of a disc: a point's, on which cells are shut too where the disc would touch an
obstacle.
"""

import math
from dataclasses import replace

import cv2
import numpy as np

from nnpp_edge.runtime.arrays import Bool, Float2D
from nnpp_edge.runtime.cells import Rectangle, slices, widened
from nnpp_edge.runtime.kernels.records import Room
from nnpp_edge.runtime.map.along import Along, Line
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.heights import HeightState
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.robots.slope.cost import slope_cost_of


class DiscState(MapState):
    """The map of a disc, over that of a point.

    Cells are shut too from which the disc would touch an obstacle on its way to the cells beside
    them. What lies off the map is an obstacle. All costs are computed at once.
    """

    _made_anew = (*MapState._made_anew, "grid", "room")

    def __init__(self, ground: Ground, point: MapState) -> None:
        assert ground.vehicle is not None and ground.vehicle.radius_m is not None
        self._point = point
        self._radius_m = ground.vehicle.radius_m
        self.has_heights = point.has_heights
        self._slope_cost = None
        if point.has_heights:
            self._slope_cost = slope_cost_of(ground.step_cost, ground.mobility)
            point.shut_alone = ground.by_slope
        dy, dx = self._sides = ground.sides_m
        # a disc half a step away is within this of the cell, as far as it is not within it of the
        # next
        reach = math.hypot(self._radius_m, 0.5 * math.hypot(dy, dx))
        rows = math.ceil(reach / dy + 0.5)
        cols = math.ceil(reach / dx + 0.5)
        self._reach = rows, cols
        down = np.maximum(np.abs(np.arange(-rows, rows + 1)) - 0.5, 0.0) * dy
        along = np.maximum(np.abs(np.arange(-cols, cols + 1)) - 0.5, 0.0) * dx
        self._touched = (np.hypot(down[:, None], along) < reach).astype(np.uint8)
        super().__init__(ground)
        self._make_grid()

    def begin_anew(self) -> None:
        """As `MapState.begin_anew`."""
        self._point.begin_anew()
        self._make_grid()
        super().begin_anew()

    def _make_grid(self) -> None:
        point = self._point.grid
        self.grid = Grid(*point.shape, point.model, point.corner_cutting)
        self.grid.update(self._shut((0, 0, *point.shape)), weights=True)
        self.room = tuple(Room(point.weights, *point.shape, self._radius_m, *self._sides))
        if self._slope_cost is not None and isinstance(self._point, HeightState):
            from nnpp_edge.runtime.robots.slope.directed import SlopeRobot

            heights = self._point.heights
            self.grid.drive_by(SlopeRobot(heights, self._sides, self._slope_cost, self.grid))

    def _shut(self, part: Rectangle) -> Float2D:
        """(h, w) weights of a part of the map, inf where the disc would touch an obstacle."""
        weights = self._point.grid.map()
        row, col, rows, cols = part
        down, along = self._reach
        top, left, high, wide = seen = widened(part, self._reach, self.shape)
        obstacles = np.ones((rows + 2 * down, cols + 2 * along), np.uint8)
        inside = slices((top - row + down, left - col + along, high, wide))
        obstacles[inside] = ~(weights[slices(seen)] < np.inf)
        border = cv2.BORDER_CONSTANT
        touched = cv2.dilate(obstacles, self._touched, borderType=border, borderValue=1)
        here = touched[down : down + rows, along : along + cols]
        return np.where(here, np.float32(np.inf), weights[slices(part)])

    def update(self, row: int, col: int, patch: Float2D, seen: Bool | None = None) -> Change:
        """As `MapState.update`, of a point's costs."""
        change = self._point.update(row, col, patch, seen)
        return self._followed(change, (row, col, 0, 0), heights=False)

    def update_elevation(
        self, row: int, col: int, patch: Float2D, seen: Bool | None = None
    ) -> Change:
        """As `MapState.update_elevation`."""
        change = self._point.update_elevation(row, col, patch, seen)
        return self._followed(change, (row, col, *np.shape(patch)), heights=True)

    def _followed(self, change: Change, part: Rectangle, *, heights: bool) -> Change:
        """Bring up to date what the disc can stand on around a change of the point's map."""
        if change.cells:
            around = widened(change.part, self._reach, self.shape)
            keeps = self.log.keeps_old_weights
            weights = self._shut(around)
            change = self.grid.update(weights, around[:2], keep_old_weights=keeps, weights=True)
        return self._noted(change, part, heights=heights)

    def cost(self) -> Float2D:
        """As `MapState.cost`: a point's costs."""
        return self._point.cost()

    def elevation(self) -> Float2D | None:
        """As `MapState.elevation`."""
        return self._point.elevation()

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> Bool:
        """As `MapState.unknown`."""
        return self._point.unknown(rows, cols)

    def along(self, line: Line, at: Line | None = None) -> Along | None:
        """As `MapState.along`."""
        along = self._point.along(line, at)
        slope_cost = self._slope_cost
        if along is None or slope_cost is None or not slope_cost.function:
            return along
        return replace(along, walker=slope_cost)
