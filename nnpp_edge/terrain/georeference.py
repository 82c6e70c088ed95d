"""Where the cells of a map lie: from cells to map coordinates and back."""

import math
from dataclasses import dataclass

from nnpp_edge.runtime.errors import InvalidQueryError

_FARTHEST = 2.0**53
"""Cells from the map's corner: whole numbers up to here are floats."""


@dataclass(frozen=True)
class Georeference:
    """Where the cells lie on the map.

    `crs` is the coordinate system as WKT, None where the file names none. `transform` is rasterio's
    (a, b, c, d, e, f): the corner of cell (row, col) lies at x = a col + b row + c, y = d col + e row + f.
    """

    crs: str | None
    transform: tuple[float, float, float, float, float, float]

    def map_coordinates(self, row: float, col: float) -> tuple[float, float]:
        """Map coordinates (x, y) of the centre of cell (row, col), in the units of `crs`."""
        a, b, c, d, e, f = self.transform
        row, col = row + 0.5, col + 0.5
        return a * col + b * row + c, d * col + e * row + f

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """Cell (row, col) that holds the map point (x, y); it may lie outside the map.

        Raises InvalidQueryError where x or y is not finite, or so far away that its cell has no number.
        """
        a, b, c, d, e, f = self.transform
        determinant = a * e - b * d
        col = (e * (x - c) - b * (y - f)) / determinant
        row = (a * (y - f) - d * (x - c)) / determinant
        if not max(abs(row), abs(col)) < _FARTHEST:
            raise InvalidQueryError(f"map coordinates must be finite and near the map, got ({x:g}, {y:g})")
        return math.floor(row), math.floor(col)
