"""Elevations as every reader of a map makes them, and maps in NumPy files, which need no
rasterio.
"""

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.lib.format import open_memmap
from numpy.lib.npyio import NpzFile

from nnpp_edge.runtime.arrays import Array, Float2D
from nnpp_edge.runtime.errors import TerrainError
from nnpp_edge.runtime.memory import available_bytes
from nnpp_edge.runtime.reading import problem_with_file, refused_as
from nnpp_edge.terrain.georeference import Georeference, Sides

Reading = tuple[Float2D, Sides | None, Georeference | None]
"""(H, W) heights in metres, a cell's (size, width) in metres and the map's place, if known."""
_BYTES_PER_CELL = 20
"""That reading takes beside the stored values: a float64 copy, the float32 map, masks."""
_FARTHEST_M = 1e9
_ARRAY_NAMES = ("elevation_m", "elevation", "dem")


def read_arrays(path: Path) -> Reading:
    """Elevation and cell (size, width) of a NumPy file; its first bytes show whether it is an
    archive.

    Raises TerrainError and InvalidQueryError as `read_dem` does, and whatever else NumPy raises for
    a broken file.
    """
    with path.open("rb") as file:
        packed = file.read(4) in (b"PK\x03\x04", b"PK\x05\x06")
    if packed:
        with _archive(path) as archive:
            heights = archive[_elevation_name(path, archive)]
            check_grid(path, heights)
            return metres(heights), _cell(path, archive), _place(path, archive)
    with _without_warnings():
        heights = open_memmap(path, mode="r")  # of which nothing is in memory yet
    check_grid(path, heights)
    check_room(path, heights.shape, heights.dtype)
    return metres(heights), None, None


def read_cost_map(path: Path) -> tuple[Float2D, float] | None:
    """Costs and cell size of an archive that `nnpp-edge costmap` has written; None for a file of
    another kind.

    The (H, W) costs are float32, the cell size is in metres, 1 where the archive has none.
    TerrainError where the archive is damaged, holds no map of costs, or one that is larger than the
    memory that is free.
    """
    if path.suffix.lower() != ".npz" or problem_with_file(path) is not None:
        return None
    with (
        refused_as(TerrainError, f"{path}: wanted a map, got a file that cannot be read"),
        _archive(path) as archive,
    ):
        if "cost" not in archive:
            return None
        cell = _cell(path, archive)
        cost = archive["cost"]
        check_grid(path, cost, "costs", "biuf")
        return metres(cost), cell[0] if cell else 1.0


def check_room(
    path: Path,
    shape: tuple[int, ...],
    dtype: np.dtype[np.generic],
    more_bytes: int = 0,
) -> None:
    """TerrainError where an array of this shape cannot become a map in the memory that is left,
    before it is read.

    `more_bytes` is what reading it takes as well.
    """
    wanted = math.prod(shape) * (dtype.itemsize + _BYTES_PER_CELL) + more_bytes
    room = available_bytes()
    if wanted > room:
        size = " × ".join(map(str, shape))
        raise TerrainError(
            f"{path}: wanted {wanted / 1e9:.1f} GB of memory for {size} {dtype.name} heights, got "
            f"{room / 1e9:.1f} GB"
        )


def metres(values: Array, scale: float = 1.0, offset: float = 0.0) -> Float2D:
    """A fresh float32 array of scale * values + offset, worked out in float64."""
    with np.errstate(over="ignore", invalid="ignore"):
        if scale == 1.0 and offset == 0.0:
            return np.array(values, dtype=np.float32, order="C")
        scaled = values.astype(np.float64)
        scaled *= scale
        scaled += offset
        return np.ascontiguousarray(scaled, np.float32)


def known_heights(elevation: Float2D) -> Float2D:
    """This array, with NaN for infinities and for heights beyond 1e9 m."""
    elevation[~(np.abs(elevation) < _FARTHEST_M)] = np.nan
    return elevation


def check_grid(path: Path, array: Array, what: str = "heights", kinds: str = "iuf") -> None:
    """TerrainError for what is not a 2-D array of at least one number of these kinds."""
    if array.ndim != 2 or array.size == 0 or array.dtype.kind not in kinds:
        raise TerrainError(
            f"{path}: wanted an (H, W) array of {what}, got {array.shape} {array.dtype}"
        )


@contextmanager
def _archive(path: Path) -> Iterator[NpzFile]:
    """The arrays of an `.npz`, each read when it is asked for; TerrainError where they are more
    than fit into the memory that is left.
    """
    with _without_warnings(), path.open("rb") as file, NpzFile(file) as archive:
        assert archive.zip is not None  # only once it is closed
        stored = sum(member.file_size for member in archive.zip.infolist())
        check_room(path, (stored // 4,), np.dtype(np.float32))
        yield archive


@contextmanager
def _without_warnings() -> Iterator[None]:
    """A damaged header is parsed as Python, which warns of odd spellings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _elevation_name(path: Path, archive: NpzFile) -> str:
    """That of the array of heights: one of ours, or the only one of two dimensions; TerrainError
    for others.
    """
    for name in _ARRAY_NAMES:
        if name in archive:
            return name
    if "cost" in archive:
        raise TerrainError(
            f"{path}: wanted heights, got costs: `nnpp-edge run` takes them, no other command"
        )
    grids = [name for name, array in archive.items() if array.ndim == 2]
    if len(grids) != 1:
        wanted = ", ".join(_ARRAY_NAMES)
        got = ", ".join(archive) or "nothing"
        raise TerrainError(f"{path}: wanted {wanted} or a single 2-D array, got {got}")
    return grids[0]


def _cell(path: Path, archive: NpzFile) -> Sides | None:
    """Size and width of a cell; None where the archive does not say."""
    size = _numbers(path, archive, "cell_size_m", 1) or _numbers(path, archive, "cell_m", 1)
    width = _numbers(path, archive, "cell_width_m", 1)
    if width and not size:
        raise TerrainError(
            f"{path}: wanted cell_size_m beside cell_width_m, got cell_width_m alone"
        )
    return (size[0], (width or size)[0]) if size else None


def _place(path: Path, archive: NpzFile) -> Georeference | None:
    """Where the map lies, by the array `transform`; None where there is none."""
    values = _numbers(path, archive, "transform", 6)
    if values is None:
        return None
    a, b, c, d, e, f = values
    if a * e == b * d:
        raise TerrainError(f"{path}: transform must place cells apart, got {values}")
    return Georeference(None, (a, b, c, d, e, f))


def _numbers(path: Path, archive: NpzFile, name: str, count: int) -> list[float] | None:
    """So many finite numbers under a name, a single one above 0; None where it is not there."""
    if name not in archive:
        return None
    array = archive[name]
    got: object = f"{array.dtype} {array.shape}"
    if array.size == count and array.dtype.kind in "iuf":
        got = values = array.ravel().tolist()
        if all(map(math.isfinite, values)) and (count > 1 or values[0] > 0.0):
            return list(values)
    wanted = "one number above 0" if count == 1 else "6 numbers (a, b, c, d, e, f)"
    raise TerrainError(f"{path}: {name} must be {wanted}, got {got}")
