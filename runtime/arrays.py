"""Maps and paths as arrays: their type, how what a user hands over becomes a map, and how a path
heads.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnpp_edge.runtime.errors import InvalidMapError

Float2D = NDArray[np.float32]
"""(H, W)."""
Float32s = NDArray[np.float32]
Floats = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]
Bool = NDArray[np.bool_]
Int64 = NDArray[np.int64]
Int32 = NDArray[np.int32]
Cells = NDArray[np.int32]
"""(N, 2) rows and columns."""
Planes = NDArray[np.float32]
"""(N, H, W)."""
Mask = NDArray[np.bool_]
"""(H, W)."""
Array = NDArray[np.generic]
Float = TypeVar("Float", np.float32, np.float64)
NumberT = TypeVar("NumberT", bound=np.generic)


def unmasked(array: ArrayLike) -> NDArray[np.generic]:
    """An array, with NaN for the masked values of a masked one: what is masked is unknown."""
    try:
        values = np.asarray(array)
    except ValueError:
        raise InvalidMapError(
            "wanted a (H, W) map of numbers, got rows of different lengths"
        ) from None
    if (
        not isinstance(array, np.ma.MaskedArray)
        or not np.ma.is_masked(array)
        or values.dtype.kind not in "fiub"
    ):
        return values
    return np.where(np.ma.getmaskarray(array), np.nan, values)


def as_map(array: ArrayLike, name: str, dtype: type[Float] = np.float32) -> NDArray[Float]:  # type: ignore[assignment]
    """`array` as a C-contiguous (H, W) map of floats, or an InvalidMapError that says what came.

    Masked cells become NaN, which is unknown wherever a map is read.
    """
    values = numbers(array, name)
    try:
        with np.errstate(over="raise"):
            return np.ascontiguousarray(values, dtype)
    except FloatingPointError:
        furthest = np.abs(values[np.isfinite(values)]).max()
        raise InvalidMapError(
            f"{name} must hold 32-bit floats, got a value of size {furthest:.3g}"
        ) from None


def in_blocks(array: NDArray[NumberT], factor: int) -> NDArray[NumberT]:
    """A view (..., H / f, f, W / f, f) of maps (..., H, W): their blocks of f × f cells, in
    which both sides can be divided.
    """
    *others, rows, cols = array.shape
    return array.reshape(*others, rows // factor, factor, cols // factor, factor)


def numbers(array: ArrayLike, name: str) -> NDArray[np.generic]:
    """`array` as (H, W) numbers of whichever kind, or an InvalidMapError that says what came."""
    values = unmasked(array)
    if values.ndim != 2 or values.size == 0 or values.dtype.kind not in "fiub":
        raise InvalidMapError(
            f"{name} must be a (H, W) map of numbers, got {values.shape} {values.dtype}"
        )
    return values


def close_border(weights: NDArray[np.float32], rows: int, cols: int) -> None:
    """Make the border impassable of a grid of (rows + 2) · (cols + 2) nodes."""
    padded = weights.reshape(rows + 2, cols + 2)
    padded[0] = padded[-1] = np.inf
    padded[:, 0] = padded[:, -1] = np.inf


def headings_along(path: NDArray[np.int32] | NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) degrees in which each cell or way point of a path (N, 2) is left; the last as it is
    arrived at.

    Clockwise from grid north, in [0, 360), as if cells were square; empty for less than two cells.
    """
    if len(path) < 2:
        return np.empty(0)
    rows, cols = np.diff(path, axis=0).T
    headings: NDArray[np.float64] = np.degrees(np.arctan2(cols, -rows)) % 360.0
    return np.append(headings, headings[-1])


def curvatures(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) one over the radius of the widest arc that fits into the turn of a line at each of its
    points (N, 2), in their unit; 0 at the ends.

    The arc touches both legs, each within the half of it that lies next to the point.
    """
    across_and_down = np.array((1.0, 1.0j))
    legs = np.diff(points @ across_and_down)
    turns = np.abs(np.angle(legs[1:] * legs[:-1].conj()))
    lengths = np.abs(legs)
    shorter = np.minimum(lengths[:-1], lengths[1:])
    found = np.zeros(len(points))
    found[1:-1] = 2.0 * np.tan(0.5 * turns) / np.maximum(shorter, 1e-12)
    return found
