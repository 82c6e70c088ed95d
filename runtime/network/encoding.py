"""What the network is shown: the map brought to its size, and where start and goal lie.

Training takes these from here too, so that what runs is what was trained.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.errors import InvalidQueryError

GAUSSIAN_CHANNELS = 2
PAIR_CHANNELS = 3
END_CHANNELS = 6
ENDS_CHANNELS = 2 * END_CHANNELS + PAIR_CHANNELS


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

    def lookup(self, blocks: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Row and column, on a grid of blocks × blocks over the square, of each row and column of the map."""
        return _spread(self.rows, self.inner[0], self.size, blocks), _spread(
            self.cols, self.inner[1], self.size, blocks
        )

    def place(self, cell: Cell) -> tuple[float, float]:
        """Where a map cell's centre lies in the square, in network cells."""
        return (
            (cell[0] + 0.5) * self.inner[0] / self.rows - 0.5,
            (cell[1] + 0.5) * self.inner[1] / self.cols - 0.5,
        )


def _spread(cells: int, inner: int, size: int, blocks: int) -> NDArray[np.int32]:
    centres = (2 * np.arange(cells, dtype=np.int64) + 1) * inner  # in units of 1 / (2 · cells) network cells
    return (centres * blocks // (2 * cells * size)).astype(np.int32)


@kernel
def _bounds(n, inner, cells):
    """First and one past the last map cell under network cell n."""
    first = n * cells // inner
    return first, max(-((-(n + 1) * cells) // inner), first + 1)


@kernel
def _pool(weights, stride, rows, cols, scale, offset, inner_rows, inner_cols, parts, planes):
    """Average what lies under these rectangles of the map, (N, 4) of row, col, rows and cols."""
    for n in range(len(parts)):
        row0, row1 = parts[n, 0] * inner_rows // rows, -(-(parts[n, 0] + parts[n, 2]) * inner_rows // rows)
        col0, col1 = parts[n, 1] * inner_cols // cols, -(-(parts[n, 1] + parts[n, 3]) * inner_cols // cols)
        for row in range(row0, min(row1, inner_rows)):
            top, bottom = _bounds(row, inner_rows, rows)
            for col in range(col0, min(col1, inner_cols)):
                left, right = _bounds(col, inner_cols, cols)
                total, blocked = 0.0, 0
                for i in range(top, bottom):
                    for j in range(left, right):
                        w = weights[(i + 1) * stride + j + 1]
                        if w == np.inf:
                            blocked += 1
                        else:
                            total += min(max(w * scale + offset, 0.0), 1.0)
                cells = (bottom - top) * (right - left)
                planes[0, row, col] = (total + blocked) / cells
                planes[1, row, col] = blocked / cells


@kernel
def mean_difference(planes, others):
    """Mean absolute difference of two (C, S, S) float32 arrays."""
    total = np.float32(0.0)
    for c in range(planes.shape[0]):
        for i in range(planes.shape[1]):
            for j in range(planes.shape[2]):
                total += abs(planes[c, i, j] - others[c, i, j])
    return total / planes.size


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
    _pool(weights, stride, frame.rows, frame.cols, scale, offset, *frame.inner, np.array(parts), out)


@kernel
def _gaussian(out, row, col, spacing, sigma):
    size = out.shape[0]
    offset = (spacing - 1.0) / 2.0
    over_rows, over_cols = np.empty(size), np.empty(size)  # the Gaussian is a product of these two
    for i in range(size):
        over_rows[i] = math.exp(-0.5 * ((i * spacing + offset - row) / sigma) ** 2)
        over_cols[i] = math.exp(-0.5 * ((i * spacing + offset - col) / sigma) ** 2)
    for i in range(size):
        for j in range(size):
            out[i, j] = over_rows[i] * over_cols[j]


@kernel
def _detour(row, col, row_a, col_a, row_b, col_b, apart):
    """How much longer the way from a to b, which lie so far apart, is by way of a point."""
    return max(math.hypot(row - row_a, col - col_a) + math.hypot(row - row_b, col - col_b) - apart, 0.0)


@kernel
def _pair(out, row_a, col_a, row_b, col_b, spacing, sigma, sharp_sigma, slack):
    size = out.shape[1]
    offset = (spacing - 1.0) / 2.0
    apart = max(math.hypot(row_a - row_b, col_a - col_b), spacing)
    wide, sharp = -0.5 / sigma**2, -0.5 / sharp_sigma**2
    for i in range(size):
        for j in range(size):
            y, x = i * spacing + offset, j * spacing + offset
            a2 = (y - row_a) ** 2 + (x - col_a) ** 2
            b2 = (y - row_b) ** 2 + (x - col_b) ** 2
            out[0, i, j] = 0.5 * (math.exp(wide * a2) + math.exp(wide * b2))
            out[1, i, j] = min(math.exp(sharp * a2) + math.exp(sharp * b2), 1.0)
            detour = _detour(y, x, row_a, col_a, row_b, col_b, apart)
            out[2, i, j] = math.exp(-detour / (slack * apart))


@kernel
def _end(out, row, col, spacing, sigma):
    """Where one end lies: the share that each point has in it, and the way to it from each."""
    size = out.shape[1]
    offset, side = (spacing - 1.0) / 2.0, size * spacing
    y, x = (row - offset) / spacing, (col - offset) / spacing  # in points
    y, x = min(max(y, 0.0), size - 1.0), min(max(x, 0.0), size - 1.0)
    wide, sharp = -0.5 / sigma**2, -8.0 / sigma**2
    for i in range(size):
        over_rows = max(1.0 - abs(i - y), 0.0)
        down = row - (i * spacing + offset)
        for j in range(size):
            right = col - (j * spacing + offset)
            square = down * down + right * right
            out[0, i, j] = over_rows * max(1.0 - abs(j - x), 0.0)
            out[1, i, j] = down / side
            out[2, i, j] = right / side
            out[3, i, j] = math.sqrt(square) / side
            out[4, i, j] = math.exp(wide * square)
            out[5, i, j] = math.exp(sharp * square)


@kernel
def _between(out, row_a, col_a, row_b, col_b, spacing):
    """How much of a detour each point is from the straight way between the two ends."""
    size = out.shape[1]
    offset, side = (spacing - 1.0) / 2.0, size * spacing
    apart = max(math.hypot(row_a - row_b, col_a - col_b), spacing)
    for i in range(size):
        for j in range(size):
            detour = _detour(i * spacing + offset, j * spacing + offset, row_a, col_a, row_b, col_b, apart)
            out[0, i, j] = math.exp(-detour / (0.25 * apart))
            out[1, i, j] = detour / side
            out[2, i, j] = apart / side


@kernel
def fill_ends(out, row_a, col_a, row_b, col_b, spacing, sigma):
    """What `encode_ends` writes, for other kernels to call."""
    _end(out[:END_CHANNELS], row_a, col_a, spacing, sigma)
    _end(out[END_CHANNELS : 2 * END_CHANNELS], row_b, col_b, spacing, sigma)
    _between(out[2 * END_CHANNELS :], row_a, col_a, row_b, col_b, spacing)


def _check_out(out: NDArray[np.float32], channels: int, size: int) -> None:
    if out.shape != (channels, size, size):
        raise InvalidQueryError(f"out must be ({channels}, {size}, {size}) float32, got {out.shape} {out.dtype}")


def encode_gaussian(
    start: tuple[float, float], goal: tuple[float, float], size: int, spacing: int, sigma: float,
    out: NDArray[np.float32],
) -> None:  # fmt: skip
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
    _gaussian(out[0], start[0], start[1], float(spacing), sigma)
    _gaussian(out[1], goal[0], goal[1], float(spacing), sigma)


def encode_pair(
    start: tuple[float, float], goal: tuple[float, float], size: int, spacing: int, sigma: float,
    out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Start and goal as an unordered pair: a step costs the same both ways, so their order means nothing.

    Parameters
    ----------
    start, goal, size, spacing, sigma
        As for `encode_gaussian`.
    out : (3, size, size) float32
        Written: the mean of the two Gaussians; the sum of two sharp ones, of σ / 4; and
        exp(-(a + b - d) / (0.25 d)) for distances a and b to the two, which lie d apart.
    """
    _check_out(out, PAIR_CHANNELS, size)
    _pair(out, *start, *goal, float(spacing), sigma, sigma / 4.0, 0.25)


def encode_ends(
    start: tuple[float, float], goal: tuple[float, float], size: int, spacing: int, sigma: float,
    out: NDArray[np.float32],
) -> None:  # fmt: skip
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
