"""Elevation maps that are read by windows, as they are larger than the memory that is left."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.errors import TerrainError
from nnpp_edge.runtime.reading import problem_with_file, refused_as
from nnpp_edge.terrain.dem import ARRAY_ENDINGS, cell_sides, checked_file
from nnpp_edge.terrain.georeference import Georeference, Place
from nnpp_edge.terrain.heights import known_heights, metres
from nnpp_edge.terrain.rasters import Raster, opened_raster

_STREAMS = {"AAIGrid": "as text", "PNG": "as one stream"}
"""Drivers whose files can only be read from the beginning on."""
_MOST_BLOCK_BYTES = 1 << 28
"""Of the blocks of a row of them, which are in memory at once."""


@dataclass(frozen=True, eq=False)
class DemWindows(Place):
    """An elevation map in an open file: what `Dem` holds, but its heights are read a rectangle at a time."""

    cell_size_m: float
    cell_width_m: float
    georeference: Georeference | None
    source: Path
    raster: Raster
    scale: float
    """Of heights, where the map is grown or shrunk."""

    def __post_init__(self) -> None:
        self.check_place()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.raster.shape

    @property
    def block(self) -> tuple[int, int]:
        """Rows and columns of a stored block."""
        return self.raster.block

    def read(self, part: Rectangle) -> Float2D:
        """(rows, cols) float32 heights of a rectangle, as `read_dem` gives them; TerrainError for a broken file."""
        with refused_as(TerrainError, f"{self.source}: cells {part} could not be read"):
            heights = known_heights(self.raster.heights(part))
        return heights if self.scale == 1.0 else metres(heights, self.scale)


def size_of(path: Path, *, allow_vrt: bool = False) -> tuple[int, int] | None:
    """Rows and columns of a raster, by its header; None for a file that only `read_dem` reads, or none at all."""
    if path.suffix.lower() in (*ARRAY_ENDINGS, ".png") or problem_with_file(path) is not None:
        return None
    with checked_file(path, None, None), opened_raster(path, None, allow_vrt) as raster:
        return raster.shape


@contextmanager
def open_dem(
    path: Path | str,
    cell_size_m: float | None = None,
    vertical_scale: float | None = None,
    *,
    rescale_m: float | None = None,
    allow_vrt: bool = False,
) -> Iterator[DemWindows]:
    """An elevation map in a raster, to be read by windows; arguments and errors as of `read_dem` and `Dem.rescaled`.

    TerrainError, too, for one stored in blocks too large to be read one at a time.
    """
    path = Path(path)
    with ExitStack() as stack:
        with checked_file(path, cell_size_m, vertical_scale):
            raster = stack.enter_context(opened_raster(path, vertical_scale, allow_vrt, by_windows=True))
            row_of_blocks = raster.block[0] * max(raster.shape[1], raster.block[1]) * raster.dtype.itemsize
            if raster.driver in _STREAMS or row_of_blocks > _MOST_BLOCK_BYTES:
                stored = _STREAMS.get(raster.driver, "in blocks of {} × {} cells".format(*raster.block))
                raise TerrainError(
                    f"{path}: wanted a raster that can be read by windows, got one stored {stored}: "
                    "make it tiled with gdal_translate -of COG"
                )
            georeference = raster.place()
        size, width = cell_sides(path, raster.shape, None, georeference, cell_size_m)
        factor = 1.0 if rescale_m is None else rescale_m / size
        yield DemWindows(size * factor, width * factor, georeference, path, raster, factor)
