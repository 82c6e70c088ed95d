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
from nnpp_edge.terrain.georeference import Georeference, Place, cell_sides
from nnpp_edge.terrain.rasters import Raster, opened_raster

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
    with checked_file(path):
        if path.suffix.lower() in ARRAY_ENDINGS:
            elevation, cell, place = read_arrays(path)
            sides = cell_sides(path, cell, cell_size_m)
            return Dem(known_heights(elevation), *sides, place, path)
        with opened_raster(path) as dataset:
            raster = Raster(path, dataset, cell_size_m)
            heights = raster.read_whole()
            return Dem(heights, *raster.sides_m, raster.georeference, path)


@contextmanager
def checked_file(path: Path) -> Iterator[None]:
    """Refuse what is no file; whatever is raised meanwhile becomes a TerrainError."""
    problem = problem_with_file(path)
    if problem is not None:
        raise TerrainError(f"{path}: wanted a file with an elevation map ({problem})")
    wanted = f"{path}: wanted an elevation map, got a file that cannot be read"
    with refused_as(TerrainError, wanted):
        yield


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


def size_of(path: Path) -> Shape | None:
    """Rows and columns of a raster, by its header; None for a file that only `read_dem` reads, or
    none at all.
    """
    if path.suffix.lower() in ARRAY_ENDINGS or problem_with_file(path) is not None:
        return None
    with checked_file(path), opened_raster(path) as dataset:
        rows, cols = dataset.shape
        return rows, cols


@contextmanager
def open_dem(path: Path | str, cell_size_m: float | None = None) -> Iterator[Raster]:
    """An elevation map in a raster, to be read by windows; arguments and errors as of `read_dem`.

    TerrainError, too, for one that cannot be read so.
    """
    path = Path(path)
    with ExitStack() as stack:
        with checked_file(path):
            raster = Raster(path, stack.enter_context(opened_raster(path)), cell_size_m)
            raster.check_windows()
        yield raster


def part_of(whole: Dem | Raster, part: Rectangle) -> Dem:
    """A rectangle of a map as a map; every cell keeps its coordinates."""
    located = whole.located
    a, b, _, d, e, _ = located.transform
    x, y = located.map_coordinates(part[0] - 0.5, part[1] - 0.5)
    moved = Georeference(located.crs, (a, b, x, d, e, y))
    return Dem(whole.read(part), whole.cell_size_m, whole.cell_width_m, moved, whole.source)
