"""Where the cells of a map lie: from cells to map coordinates and back."""

import math
from dataclasses import dataclass
from pathlib import Path

from nnpp_edge.runtime.cells import Cell, Shape
from nnpp_edge.runtime.errors import InvalidQueryError, TerrainError

Point = tuple[float, float]
"""(x, y) in the coordinates of a map."""
Sides = tuple[float, float]
"""(size, width) of a cell in metres: along a column and along a row."""

_FARTHEST = 2.0**53
"""Cells from the map's corner: whole numbers up to here are floats."""
LEAST_SIDE_M = 1e-6
MOST_SIDE_M = 1e9
"""Of a cell: beyond, slopes leave float32."""


@dataclass(frozen=True)
class Georeference:
    """Where the cells lie on the map.

    `crs` is the coordinate system as WKT, None where the file names none. `transform` is rasterio's
    (a, b, c, d, e, f): the corner of cell (row, col) lies at x = a col + b row + c, y = d col + e
    row + f.
    """

    crs: str | None
    transform: tuple[float, float, float, float, float, float]

    @property
    def drawn_sides(self) -> Sides:
        """A cell's (size, width) in the units of `crs`."""
        a, b, _, d, e, _ = self.transform
        return math.hypot(b, e), math.hypot(a, d)

    def map_coordinates(self, row: float, col: float) -> Point:
        """Map coordinates (x, y) of the centre of cell (row, col), in the units of `crs`."""
        a, b, c, d, e, f = self.transform
        row = row + 0.5
        col = col + 0.5
        return a * col + b * row + c, d * col + e * row + f

    def cell_of(self, x: float, y: float) -> Cell:
        """Cell (row, col) that holds the map point (x, y); it may lie outside the map.

        Raises InvalidQueryError where x or y is not finite, or so far away that its cell has no
        number.
        """
        a, b, c, d, e, f = self.transform
        determinant = a * e - b * d
        col = (e * (x - c) - b * (y - f)) / determinant
        row = (a * (y - f) - d * (x - c)) / determinant
        if not max(abs(row), abs(col)) < _FARTHEST:
            raise InvalidQueryError(
                f"map coordinates must be finite and near the map, got ({x:g}, {y:g})"
            )
        return math.floor(row), math.floor(col)


class Place:
    """Where a map lies, and how large its cells are: what maps in memory and maps read by windows
    share.
    """

    cell_size_m: float
    """Side of a cell along a column of the map (north-south); `cell_width_m` along a row
    (east-west).
    """
    cell_width_m: float
    georeference: Georeference | None
    """Where the cells lie, in the coordinates of the file."""
    source: Path
    """The file, for messages."""

    @property
    def shape(self) -> Shape:
        """Rows and columns."""
        raise NotImplementedError

    def check_place(self) -> None:
        """TerrainError for cells without a size, or that lie nowhere."""
        check_sides(self.source, self.cell_size_m, self.cell_width_m)
        corners = [self.map_coordinates(*at) for at in ((0, 0), self.shape)]
        if not all(map(math.isfinite, corners[0] + corners[1])):
            raise TerrainError(
                f"{self.source}: wanted corners with finite coordinates, got {corners}"
            )

    def map_coordinates(self, row: float, col: float) -> Point:
        """As `Georeference.map_coordinates`."""
        return self.located.map_coordinates(row, col)

    def cell_of(self, x: float, y: float) -> Cell:
        """As `Georeference.cell_of`."""
        return self.located.cell_of(x, y)

    @property
    def north_deg(self) -> float | None:
        """Where y grows, degrees clockwise from up the rows; None without a georeference."""
        if self.georeference is None:
            return None
        a, b, _, d, e, _ = self.georeference.transform
        turned = a * e - b * d
        return math.degrees(math.atan2(-b / turned, -a / turned))

    @property
    def located(self) -> Georeference:
        """The file's georeference; without one, metres from the middle of cell (0, 0), y
        downwards.
        """
        if self.georeference is not None:
            return self.georeference
        size = self.cell_size_m
        width = self.cell_width_m
        return Georeference(None, (width, 0.0, -0.5 * width, 0.0, size, -0.5 * size))


def cell_sides(source: Path, cell: Sides | None, wanted: float | None) -> Sides:
    """A cell's (size, width): the file's, or of the size that was asked for; TerrainError
    without.
    """
    if cell is not None:
        check_sides(source, *cell)
    if wanted is not None:
        return wanted, wanted * cell[1] / cell[0] if cell else wanted
    if cell is None:
        raise TerrainError(f"{source}: no cell size in the file; give it with --cell-size METRES")
    return float(cell[0]), float(cell[1])


def check_sides(source: Path, *sides: float) -> None:
    """TerrainError for cells without a size, or of one that no map has."""
    for side in sides:
        if not LEAST_SIDE_M <= side <= MOST_SIDE_M:
            wanted = f"wanted cells with sides of {LEAST_SIDE_M:g} to {MOST_SIDE_M:g} m"
            raise TerrainError(f"{source}: {wanted}, got {side:g} m")
