"""Maps as arrays: their type, and how what a user hands over becomes one."""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import InvalidMapError

Float2D = NDArray[np.float32]


def as_map(array: NDArray[np.generic], name: str) -> Float2D:
    """`array` as a C-contiguous (H, W) float32 map, or an InvalidMapError that says what came."""
    array = np.asarray(array)
    if array.ndim != 2 or array.size == 0 or array.dtype.kind not in "fiub":
        raise InvalidMapError(f"{name} must be a (H, W) map of numbers, got {array.shape} {array.dtype}")
    return np.ascontiguousarray(array, np.float32)
