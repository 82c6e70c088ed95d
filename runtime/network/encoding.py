"""What the network is shown: the map brought to its size, and where start and goal lie.

Training takes these from here too, so that what runs is what was trained.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.encoding import (
    BETWEEN_CHANNELS,
    END_CHANNELS,
    ENDS_CHANNELS,
    GAUSSIAN_CHANNELS,
    encode_gaussian_into,
    fill_ends,
    mean_difference,
    pool_planes,
)
from nnpp_edge.runtime.map.region import Lookup

Point = tuple[float, float]
"""(row, col) in network cells."""

__all__ = [
    "BETWEEN_CHANNELS",
    "ENDS_CHANNELS",
    "END_CHANNELS",
    "GAUSSIAN_CHANNELS",
    "Frame",
    "Point",
    "encode_ends",
    "encode_gaussian",
    "map_planes",
    "mean_difference",
]


@dataclass(frozen=True)
class Frame:
    """How a map of rows × cols lies in the network's square.

    The longer side fills the square, the other keeps its proportion; what is left over, below or to the
    right, is shown as impassable. A step's two cost terms shrink alike, so the problem stays the same.
    """

    rows: int
    cols: int
    size: int

    @property
    def scale(self) -> float:
        """Network cells to a map cell."""
        return self.size / max(self.rows, self.cols)

    @functools.cached_property
    def inner(self) -> tuple[int, int]:
        """Rows and columns of the square that the map fills; at least 1."""
        return (
            max(1, min(self.size, round(self.rows * self.scale))),
            max(1, min(self.size, round(self.cols * self.scale))),
        )

    def lookup(self, blocks: int) -> Lookup:
        """Row and column, on a grid of blocks × blocks over the square, of each row and column of the map."""
        rows = _spread(self.rows, self.inner[0], self.size, blocks)
        return rows, _spread(self.cols, self.inner[1], self.size, blocks)

    def place(self, cell: Cell) -> tuple[float, float]:
        """Where a map cell's centre lies in the square, in network cells."""
        return (
            (cell[0] + 0.5) * self.inner[0] / self.rows - 0.5,
            (cell[1] + 0.5) * self.inner[1] / self.cols - 0.5,
        )


def _spread(cells: int, inner: int, size: int, blocks: int) -> NDArray[np.int32]:
    centres = (2 * np.arange(cells, dtype=np.int64) + 1) * inner  # in units of 1 / (2 · cells) network cells
    lookup: NDArray[np.int32] = (centres * blocks // (2 * cells * size)).astype(np.int32)
    return lookup


def map_planes(
    weights: NDArray[np.float32],
    stride: int,
    frame: Frame,
    scale: float,
    offset: float,
    out: NDArray[np.float32],
    parts: Sequence[Rectangle] | None = None,
) -> None:
    """Bring a map to the network's size by area averages.

    Parameters
    ----------
    weights, stride
        Of the map's `Grid`.
    frame : Frame
        How the map lies in the square.
    scale, offset : float
        T = scale · weight + offset is the traversability cost, here clipped to [0, 1].
    out : (2, S, S) float32
        Written: the mean cost with impassable cells counted as 1, and the share of impassable cells,
        both in [0, 1], both 1 outside the map.
    parts : sequence of (row, col, rows, cols)
        Only what lies under these rectangles of the map; by default all of it.
    """
    if parts is None:
        out[:] = 1.0
        parts = [(0, 0, frame.rows, frame.cols)]
    pool_planes(weights, stride, frame.rows, frame.cols, scale, offset, *frame.inner, np.array(parts), out)


def _check_out(out: NDArray[np.float32], channels: int, size: int) -> None:
    if out.shape != (channels, size, size):
        raise InvalidQueryError(f"out must be ({channels}, {size}, {size}) float32, got {out.shape} {out.dtype}")


def encode_gaussian(
    start: Point, goal: Point, size: int, spacing: int, sigma: float, out: NDArray[np.float32]
) -> None:
    """The paper's encoding (Eq. 5): a Gaussian around start and one around goal, each with a peak of 1.

    Parameters
    ----------
    start, goal : (row, col)
        In network cells.
    size, spacing : int
        `out` has size × size points, `spacing` network cells apart.
    sigma : float
        In network cells; the paper's best is a quarter of the map.
    out : (2, size, size) float32
        Written. Eq. 5's factor 1/(2πσ²) only scales the input and is left out.
    """
    _check_out(out, GAUSSIAN_CHANNELS, size)
    encode_gaussian_into(out[0], start[0], start[1], float(spacing), sigma)
    encode_gaussian_into(out[1], goal[0], goal[1], float(spacing), sigma)


def encode_ends(start: Point, goal: Point, size: int, spacing: int, sigma: float, out: NDArray[np.float32]) -> None:
    """Start and goal, each by the way to it, for a network that looks at the map before it knows the two.

    Parameters
    ----------
    start, goal, size, spacing, sigma
        As for `encode_gaussian`.
    out : (15, size, size) float32
        Written. Six for the start, then six for the goal: the weights of the bilinear interpolation that reads
        a value there off the points, rows and columns from a point to it and the distance, as shares of the
        side, and two Gaussians around it, of σ and of σ / 4. Then three for both: exp(-(a + b - d) / (0.25 d))
        for distances a and b to the two, which lie d apart, and a + b - d and d as shares of the side.
    """
    _check_out(out, ENDS_CHANNELS, size)
    fill_ends(out, start[0], start[1], goal[0], goal[1], float(spacing), sigma)
