"""Where a disc may stand: cells from which it touches no obstacle on its way to those beside them.

What lies off the map is an obstacle.
"""

import math
from typing import TYPE_CHECKING

import cv2
import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Rectangle, slices, widened
from nnpp_edge.runtime.kernels.records import Packed, Room

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid


class Widening:
    """The obstacles of a point's map, wider by a radius."""

    def __init__(self, radius_m: float, sides_m: tuple[float, float]) -> None:
        self._radius_m = radius_m
        dy, dx = self._sides = sides_m
        # a disc half a step away is within this of the cell, as far as it is not within it of the
        # next
        reach = math.hypot(radius_m, 0.5 * math.hypot(dy, dx))
        rows = math.ceil(reach / dy + 0.5)
        cols = math.ceil(reach / dx + 0.5)
        self.reach = rows, cols
        """Rows and columns around a cell that decide whether it may stand there."""
        down = np.maximum(np.abs(np.arange(-rows, rows + 1)) - 0.5, 0.0) * dy
        along = np.maximum(np.abs(np.arange(-cols, cols + 1)) - 0.5, 0.0) * dx
        self._touched = (np.hypot(down[:, None], along) < reach).astype(np.uint8)

    def weights(self, point: "Grid", part: Rectangle) -> Float2D:
        """(h, w) weights of a part of a point's map, inf where it would touch an obstacle."""
        weights = point.map()
        row, col, rows, cols = part
        down, along = self.reach
        top, left, high, wide = seen = widened(part, self.reach, point.shape)
        obstacles = np.ones((rows + 2 * down, cols + 2 * along), np.uint8)
        inside = slices((top - row + down, left - col + along, high, wide))
        obstacles[inside] = ~(weights[slices(seen)] < np.inf)
        border = cv2.BORDER_CONSTANT
        touched = cv2.dilate(obstacles, self._touched, borderType=border, borderValue=1)
        here = touched[down : down + rows, along : along + cols]
        return np.where(here, np.float32(np.inf), weights[slices(part)])

    def room(self, point: "Grid") -> Packed:
        """What lines must keep away from."""
        return tuple(Room(point.weights, *point.shape, self._radius_m, *self._sides))
