"""Elevations as every reader of a map makes them, and maps in NumPy files, which need no
rasterio.
"""

import math
import warnings
import zipfile
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy

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
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_arrays(path: Path) -> Reading:
    """Elevation and cell (size, width) of a NumPy file; its first bytes show whether it is an
    archive.

    Raises TerrainError and InvalidQueryError as `read_dem` does, and whatever else NumPy raises for
    a broken file.
    """
    with path.open("rb") as file:
        if file.read(4) not in (b"PK\x03\x04", b"PK\x05\x06"):
            file.seek(0)
            promised = _promised(file)
            check_grid(path, promised)
            check_room(path, promised.shape, promised.dtype)
            return metres(np.load(path, allow_pickle=False)), None, None
    with _Archive(path) as archive:
        place = archive.place()
        cell = archive.cell()
        if cell is None and place is not None:
            cell = place.drawn_sides
        return archive.grid(archive.elevation_name()), cell, place


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
        _Archive(path) as archive,
    ):
        if "cost" not in archive.names:
            return None
        cell = archive.cell()
        return archive.grid("cost", "costs", "biuf"), cell[0] if cell else 1.0


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


class _Archive(zipfile.ZipFile):
    """An `.npz` whose arrays' headers are read before the arrays."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.path = path
        self.names = {name.removesuffix(".npy"): name for name in self.namelist()}

    def promised(self, name: str) -> Array:
        with self.open(self.names[name]) as member:
            return _promised(member)

    def array(self, name: str) -> Array:
        with self.open(self.names[name]) as member:
            found: Array = npy.read_array(member, allow_pickle=False)
        return found

    def grid(self, name: str, what: str = "heights", kinds: str = "iuf") -> Float2D:
        """A map; TerrainError for one of another kind, or too large for the memory that is left."""
        promised = self.promised(name)
        check_grid(self.path, promised, what, kinds)
        check_room(self.path, promised.shape, promised.dtype, promised.nbytes)
        return metres(self.array(name))

    def elevation_name(self) -> str:
        """That of the array of heights: one of ours, or the only one of two dimensions;
        TerrainError for others.
        """
        for name in _ARRAY_NAMES:
            if name in self.names:
                return name
        if "cost" in self.names:
            raise TerrainError(
                f"{self.path}: wanted heights, got costs: `nnpp-edge run` takes them, no other "
                "command"
            )
        grids = [name for name in self.names if self.promised(name).ndim == 2]
        if len(grids) != 1:
            wanted = ", ".join(_ARRAY_NAMES)
            got = ", ".join(self.names) or "nothing"
            raise TerrainError(f"{self.path}: wanted {wanted} or a single 2-D array, got {got}")
        return grids[0]

    def cell(self) -> Sides | None:
        """Size and width of a cell; None where the archive does not say."""
        size = self._numbers("cell_size_m", 1) or self._numbers("cell_m", 1)
        width = self._numbers("cell_width_m", 1)
        if width and not size:
            raise TerrainError(
                f"{self.path}: wanted cell_size_m beside cell_width_m, got cell_width_m alone"
            )
        return (size[0], (width or size)[0]) if size else None

    def place(self) -> Georeference | None:
        """Where the map lies, by the array `transform`; None where there is none."""
        values = self._numbers("transform", 6)
        if values is None:
            return None
        a, b, c, d, e, f = values
        if a * e == b * d:
            raise TerrainError(f"{self.path}: transform must place cells apart, got {values}")
        return Georeference(None, (a, b, c, d, e, f))

    def _numbers(self, name: str, count: int) -> list[float] | None:
        """So many finite numbers under a name, a single one above 0; None where it is not there."""
        if name not in self.names:
            return None
        promised = self.promised(name)
        got: object = f"{promised.dtype} {promised.shape}"
        if promised.size == count and promised.dtype.kind in "iuf":
            got = values = self.array(name).ravel().tolist()
            if all(map(math.isfinite, values)) and (count > 1 or values[0] > 0.0):
                return values
        wanted = "one number above 0" if count == 1 else "6 numbers (a, b, c, d, e, f)"
        raise TerrainError(f"{self.path}: {name} must be {wanted}, got {got}")


def _promised(file: IO[bytes]) -> Array:
    """An array that takes no memory, of the shape and type that the header of a `.npy` promises."""
    version = npy.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"wanted version 1 or 2 of NumPy's format, got {version}")
    # a damaged header is parsed as Python, which warns of odd spellings
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        shape, _, dtype = _HEADERS[version](file)
    return np.broadcast_to(np.empty((), dtype), shape)
