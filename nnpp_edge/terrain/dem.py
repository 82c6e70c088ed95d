"""Digital elevation models: read from the files that space agencies and surveyors publish.

Rasters (`gdal_files.FORMATS`) go through rasterio; NumPy arrays need none.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np

from nnpp_edge.runtime.arrays import Float2D, Float32s, unmasked
from nnpp_edge.runtime.cells import Rectangle, Shape, slices
from nnpp_edge.runtime.errors import InvalidQueryError, TerrainError
from nnpp_edge.runtime.reading import problem_with_file, refused_as
from nnpp_edge.terrain.array_files import check_grid, known_heights, metres, read_arrays
from nnpp_edge.terrain.coordinates import cell_on_ground
from nnpp_edge.terrain.georeference import Georeference, Place, Sides, check_sides
from nnpp_edge.terrain.rasters import Raster, opened_raster, read_raster

ARRAY_ENDINGS = (".npy", ".npz")


@dataclass(frozen=True, eq=False)
class Dem(Place):
    """An elevation map: (H, W) float32 metres, NaN where unknown, and the size of its cells
    (`Place`).

    Masked cells become unknown. TerrainError where no cell is known, or a number makes no sense.
    """

    elevation: Float32s
    cell_size_m: float
    cell_width_m: float
    georeference: Georeference | None
    source: Path

    def __post_init__(self) -> None:
        object.__setattr__(self, "elevation", unmasked(self.elevation))
        check_grid(self.source, self.elevation)
        if self.elevation.dtype != np.float32:
            raise TerrainError(
                f"{self.source}: elevation must be float32, got {self.elevation.dtype}"
            )
        if not np.isfinite(self.elevation).any():
            raise TerrainError(
                f"{self.source}: wanted an elevation map, got no cell with a known height"
            )
        self.check_place()

    @property
    def shape(self) -> Shape:
        rows, cols = self.elevation.shape
        return rows, cols

    def random_square(self, rng: np.random.Generator, side: int) -> Float2D:
        """The heights of a square of so many cells to a side, at a random place: a view."""
        row, col = (int(rng.integers(0, cells - side + 1)) for cells in self.shape)
        return self.elevation[row : row + side, col : col + side]

    def read(self, part: Rectangle) -> Float2D:
        """(rows, cols) heights of a rectangle."""
        return self.elevation[slices(part)].copy()

    def rescaled(self, cell_size_m: float) -> "Dem":
        """This terrain grown or shrunk to cells of `cell_size_m`: heights follow, so slopes stay.

        It lies nowhere: its coordinates are metres from its first cell.
        """
        factor = cell_size_m / self.cell_size_m
        width = self.cell_width_m * factor
        return replace(
            self,
            elevation=metres(self.elevation, factor),
            cell_size_m=float(cell_size_m),
            cell_width_m=width,
            georeference=None,
        )


def read_dem(path: Path | str, cell_size_m: float | None = None) -> Dem:
    """Read an elevation map; `.npy` and `.npz` are told by their ending, all else is GDAL's.

    Parameters
    ----------
    path : Path or str
        A raster of one band in one of `gdal_files.FORMATS`, whatever its name (for a PDS3 `.img`
        with a `.lbl` beside it, the label is opened); a 2-D `.npy`; an `.npz` with `elevation_m`,
        `elevation`, `dem` or a single 2-D array, and perhaps `cell_size_m` (or `cell_m`),
        `cell_width_m` and `transform`, as of `Georeference`.
    cell_size_m : float, optional
        Side of a cell, north-south. Wins over the file's; the ratio of width to height is kept.

    Returns
    -------
    Dem
        NaN where the file has no data, an infinity, or a height beyond 1e9 m (a fill value left
        undeclared).

    Raises
    ------
    TerrainError, InvalidQueryError, MissingExtraError
        The file is missing, broken, no elevation map, too large for the memory that is left, or
        lacks a cell size; the size given makes no sense; the format needs rasterio, which is not
        installed.

    Notes
    -----
    Cells are as long as the ground under them (`coordinates.cell_on_ground`). An offset over
    100 km is a body's radius (PDS3 labels of the Moon): it is left out, so heights count from that
    sphere and keep float32's precision.
    """
    path = Path(path)
    read = read_arrays if path.suffix.lower() in ARRAY_ENDINGS else read_raster
    with checked_file(path):
        elevation, cell, georeference = read(path)
    sides = cell_sides(path, elevation.shape, cell, georeference, cell_size_m)
    return Dem(known_heights(elevation), *sides, georeference, path)


@contextmanager
def checked_file(path: Path) -> Iterator[None]:
    """Refuse what is no file; whatever is raised meanwhile becomes a TerrainError."""
    problem = problem_with_file(path)
    if problem is not None:
        raise TerrainError(f"{path}: wanted a file with an elevation map ({problem})")
    wanted = f"{path}: wanted an elevation map, got a file that cannot be read"
    with refused_as(TerrainError, wanted):
        yield


def cell_sides(
    path: Path,
    shape: tuple[int, ...],
    cell: Sides | None,
    place: Georeference | None,
    wanted: float | None,
) -> Sides:
    """A cell's (size, width): the file's or its ground's, or of the size that was asked for;
    TerrainError without.
    """
    if cell is None and place is not None:
        cell = cell_on_ground(path, place, shape, warn=wanted is None)
    if cell is not None:
        check_sides(path, *cell)
    if wanted is not None:
        return wanted, wanted * cell[1] / cell[0] if cell else wanted
    if cell is None:
        raise TerrainError(f"{path}: no cell size in the file; give it with --cell-size METRES")
    return float(cell[0]), float(cell[1])


SAMPLES = ("earth_hummocks", "mars_victoria", "moon_highlands", "moon_rocks")


def sample_path(name: str) -> Path:
    """The file of a map in `SAMPLES`; InvalidQueryError if there is none of that name."""
    if name not in SAMPLES:
        raise InvalidQueryError(f"sample must be one of {', '.join(SAMPLES)}, got {name!r}")
    return Path(str(files("nnpp_edge.terrain") / "samples" / f"{name}.npz"))


def sample_dem(name: str) -> Dem:
    """A map in `SAMPLES`, to try things with.

    Examples
    --------
    >>> dem = sample_dem("mars_victoria")
    >>> dem.shape, dem.cell_size_m
    ((256, 176), 1.0)
    """
    return read_dem(sample_path(name))


_MOST_BLOCK_BYTES = 1 << 28
"""Of the blocks of a row of them, which are in memory at once."""


@dataclass(frozen=True, eq=False)
class DemWindows(Place):
    """An elevation map in an open file: what `Dem` holds, but its heights are read a rectangle at a
    time.
    """

    cell_size_m: float
    cell_width_m: float
    georeference: Georeference | None
    source: Path
    raster: Raster

    def __post_init__(self) -> None:
        self.check_place()

    @property
    def shape(self) -> Shape:
        return self.raster.shape

    def bands(self) -> Iterator[Rectangle]:
        """Rows that are stored together, from top to bottom."""
        rows, cols = self.shape
        high = max(self.raster.block[0], 256)
        return ((row, 0, min(high, rows - row), cols) for row in range(0, rows, high))

    def read(self, part: Rectangle) -> Float2D:
        """(rows, cols) float32 heights of a rectangle, as `read_dem` gives them; TerrainError for a
        broken file.
        """
        with refused_as(TerrainError, f"{self.source}: cells {part} could not be read"):
            return known_heights(self.raster.heights(part))


def size_of(path: Path) -> Shape | None:
    """Rows and columns of a raster, by its header; None for a file that only `read_dem` reads, or
    none at all.
    """
    if path.suffix.lower() in ARRAY_ENDINGS or problem_with_file(path) is not None:
        return None
    with checked_file(path), opened_raster(path) as raster:
        return raster.shape


@contextmanager
def open_dem(path: Path | str, cell_size_m: float | None = None) -> Iterator[DemWindows]:
    """An elevation map in a raster, to be read by windows; arguments and errors as of `read_dem`.

    TerrainError, too, for one stored in blocks too large to be read one at a time.
    """
    path = Path(path)
    with ExitStack() as stack:
        with checked_file(path):
            raster = stack.enter_context(opened_raster(path, by_windows=True))
            high, wide = raster.block
            row_of_blocks = high * max(raster.shape[1], wide) * raster.dtype.itemsize
            stored = ""
            if raster.driver == "AAIGrid":
                stored = "as text"
            elif row_of_blocks > _MOST_BLOCK_BYTES:
                stored = f"in blocks of {high} × {wide} cells"
            if stored:
                raise TerrainError(
                    f"{path}: wanted a raster that can be read by windows, got one stored "
                    f"{stored}: make it tiled with gdal_translate -of COG"
                )
            georeference = raster.place()
        sides = cell_sides(path, raster.shape, None, georeference, cell_size_m)
        yield DemWindows(*sides, georeference, path, raster)


def part_of(whole: Dem | DemWindows, part: Rectangle) -> Dem:
    """A rectangle of a map as a map; every cell keeps its coordinates."""
    located = whole.located
    a, b, _, d, e, _ = located.transform
    x, y = located.map_coordinates(part[0] - 0.5, part[1] - 0.5)
    moved = Georeference(located.crs, (a, b, x, d, e, y))
    return Dem(whole.read(part), whole.cell_size_m, whole.cell_width_m, moved, whole.source)
