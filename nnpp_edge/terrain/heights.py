"""Elevations as every reader of a map makes them: which part is read, whether it fits into memory, metres."""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import TerrainError
from nnpp_edge.runtime.memory import available_bytes
from nnpp_edge.terrain.georeference import Georeference

Reading = tuple[Float2D, tuple[float, float] | None, Georeference | None]
"""(H, W) heights in metres, a cell's (size, width) in metres and the map's place, if known."""
_BYTES_PER_CELL = 20
"""That reading takes beside the stored values: a float64 copy, the float32 map, masks."""
_FARTHEST_M = 1e9


def check_room(path: Path, shape: tuple[int, ...], dtype: np.dtype[np.generic], more_bytes: int = 0) -> None:
    """TerrainError where an array of this shape cannot become a map in the memory that is left, before it is read.

    `more_bytes` is what reading it takes besides.
    """
    wanted = math.prod(shape) * (dtype.itemsize + _BYTES_PER_CELL) + more_bytes
    room = available_bytes()
    if wanted > room:
        size = " × ".join(map(str, shape))
        raise TerrainError(
            f"{path}: wanted {wanted / 1e9:.1f} GB of memory for {size} {dtype.name} heights, got {room / 1e9:.1f} GB"
        )


def metres(values: npt.NDArray[np.generic], scale: float, offset: float = 0.0) -> Float2D:
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


def check_grid(path: Path, array: npt.NDArray[np.generic]) -> None:
    """TerrainError for what is not a 2-D array of at least one real number."""
    if array.ndim != 2 or array.size == 0 or array.dtype.kind not in "iuf":
        raise TerrainError(f"{path}: wanted an (H, W) array of heights, got {array.shape} {array.dtype}")
