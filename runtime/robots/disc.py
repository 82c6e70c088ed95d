"""Where a disc may stand: cells from which it touches no obstacle on its way to those beside them.

What lies off the map is an obstacle.
"""

import math
from typing import TYPE_CHECKING

import cv2
import numpy as np

from nnpp_edge.runtime.arrays import Bool
from nnpp_edge.runtime.cells import Cell, Rectangle, Sides, slices, widened
from nnpp_edge.runtime.kernels.records import Packed, Room
from nnpp_edge.runtime.robots.robot import Robot, Stance
from nnpp_edge.runtime.terrain.vehicle import Vehicle

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid
    from nnpp_edge.runtime.map.state import MapState


class DiscStance(Stance):
    """On a point's map, whose obstacles are wider by a radius."""

    def __init__(self, radius_m: float, sides_m: Sides) -> None:
        self._radius_m = radius_m
        dy, dx = self._sides = sides_m
        # a disc half a step away is within this of the cell, as far as it is not within it of the
        # next
        reach = math.hypot(radius_m, 0.5 * math.hypot(dy, dx))
        rows = math.ceil(reach / dy - 0.5)
        cols = math.ceil(reach / dx - 0.5)
        self.reach = rows, cols
        down = np.maximum(np.abs(np.arange(-rows, rows + 1)) - 0.5, 0.0) * dy
        along = np.maximum(np.abs(np.arange(-cols, cols + 1)) - 0.5, 0.0) * dx
        self._touched = (np.hypot(down[:, None], along) < reach).astype(np.uint8)

    def shut(self, point: "Grid", part: Rectangle) -> Bool:
        weights = point.map()
        row, col, rows, cols = part
        down, along = self.reach
        top, left, high, wide = seen = widened(part, self.reach, point.shape)
        obstacles = np.ones((rows + 2 * down, cols + 2 * along), np.uint8)
        inside = slices((top - row + down, left - col + along, high, wide))
        obstacles[inside] = ~(weights[slices(seen)] < np.inf)
        touched = cv2.dilate(obstacles, self._touched)
        here: Bool = touched[down : down + rows, along : along + cols] > 0
        return here

    def room(self, point: "Grid") -> Packed:
        return tuple(Room(point.weights, *point.shape, self._radius_m, *self._sides))

    def why_blocked(self, cell: Cell) -> str:
        return "an obstacle or the map's edge lies within the vehicle's radius"


def disc_on(state: "MapState", vehicle: Vehicle, sides_m: Sides) -> Robot:
    """The robot of a disc."""
    return Robot(DiscStance(vehicle.reach_m, sides_m))
