"""A vehicle of which no more is known than a radius: cells that it cannot stand on without touching an obstacle."""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Rectangle, slices, widened


class Disc:
    """The cells around each cell that a disc touches, on its way to the cells beside it too.

    A cell is an obstacle where its weight is inf, and so is what lies off the map.
    """

    def __init__(self, radius_m: float, sides_m: tuple[float, float]) -> None:
        self.radius_m, self.sides_m, (dy, dx) = radius_m, sides_m, sides_m
        reach = math.hypot(radius_m, 0.5 * math.hypot(dy, dx))
        """A disc half a step away is within that of the cell, as far as it is not within it of the next."""
        rows, cols = math.ceil(reach / dy + 0.5), math.ceil(reach / dx + 0.5)
        down = np.maximum(np.abs(np.arange(-rows, rows + 1)) - 0.5, 0.0) * dy
        along = np.maximum(np.abs(np.arange(-cols, cols + 1)) - 0.5, 0.0) * dx
        self._touched: NDArray[np.uint8] = (np.hypot(down[:, None], along) < reach).astype(np.uint8)
        self._reach = rows, cols

    def around(self, part: Rectangle, shape: tuple[int, int]) -> Rectangle:
        """The rectangle of cells that a change in a part may matter to."""
        return widened(part, self._reach, shape)

    def shut(self, weights: Float2D, part: Rectangle) -> Float2D:
        """(h, w) weights of a part of a map, inf where the disc would touch an obstacle."""
        import cv2  # takes a tenth of a second to load

        (row, col, rows, cols), (down, along) = part, self._reach
        top, left, high, wide = seen = self.around(part, (weights.shape[0], weights.shape[1]))
        obstacles = np.ones((rows + 2 * down, cols + 2 * along), np.uint8)
        obstacles[slices((top - row + down, left - col + along, high, wide))] = ~(weights[slices(seen)] < np.inf)
        touched = cv2.dilate(obstacles, self._touched, borderType=cv2.BORDER_CONSTANT, borderValue=1)
        return np.where(touched[down : down + rows, along : along + cols], np.float32(np.inf), weights[slices(part)])
