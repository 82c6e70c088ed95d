"""What a network is shown of blocks of 4 × 4 cells of a map of heights. See `network.passage`.

A block's mean height, the gradient between its neighbours' means, and how far its cells stand out from the plane of
that gradient through its mean; in shares of what a vehicle can take, as bytes around `MIDDLE`.
"""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.pooling import FACTOR

CELLS = FACTOR * FACTOR
CHANNELS = CELLS + 3
"""Its cells, row by row; gradients down and to the right; its mean above the mean of its four neighbours'."""
MIDDLE = 128
UNKNOWN = 255
"""A cell that is unknown or off the map: so high that nothing would stand on it."""
_QUARTER, _HALF = np.float32(0.25), np.float32(0.5)


@kernel
def _as_byte(value):
    """A number of steps around `MIDDLE`, cut off at both ends."""
    return np.uint8(min(max(np.rint(value), np.float32(1 - MIDDLE)), np.float32(UNKNOWN - MIDDLE)) + MIDDLE)


@kernel
def _mean_heights(heights, first, means):
    """Mean height of the known cells of each block, NaN where there are none. `first` is the block of means[0, 0]."""
    rows, cols = heights.shape
    for i in range(means.shape[0]):
        row0, row1 = max((first[0] + i) * FACTOR, 0), min((first[0] + i + 1) * FACTOR, rows)
        for j in range(means.shape[1]):
            col0, col1 = max((first[1] + j) * FACTOR, 0), min((first[1] + j + 1) * FACTOR, cols)
            total, known = np.float32(0.0), 0
            for row in range(row0, row1):
                for col in range(col0, col1):
                    h = heights[row, col]
                    if np.isfinite(h):
                        total += h
                        known += 1
            means[i, j] = total / np.float32(known) if known else np.float32(np.nan)


@kernel
def _gradient(before, here, after):
    """Rise from a block to the next, by those of its neighbours that are known."""
    if np.isnan(before):
        return np.float32(0.0) if np.isnan(after) else after - here
    return here - before if np.isnan(after) else _HALF * (after - before)


@kernel
def describe_blocks(heights, first, scales, means, out):
    """Fill `out` with what is shown of a rectangle of blocks.

    Parameters
    ----------
    heights : (H, W) float32
        Metres; not finite where unknown.
    first : (row, col)
        The first block; it may lie off the map, where all is unknown.
    scales : (height, down, across)
        Steps of a byte to a metre; to a metre's rise from a block to the one below; and to the one at its right.
    means : (R + 2, C + 2) float32
        Scratch.
    out : (19, R, C) uint8
    """
    rows, cols = heights.shape
    by_height, by_down, by_across = scales
    _mean_heights(heights, (first[0] - 1, first[1] - 1), means)
    for i in range(out.shape[1]):
        for j in range(out.shape[2]):
            here = means[i + 1, j + 1]
            if np.isnan(here):
                out[:CELLS, i, j] = UNKNOWN
                out[CELLS:, i, j] = MIDDLE
                continue
            up, below, left, right = means[i, j + 1], means[i + 2, j + 1], means[i + 1, j], means[i + 1, j + 2]
            down, across = _gradient(up, here, below), _gradient(left, here, right)
            row0, col0 = (first[0] + i) * FACTOR, (first[1] + j) * FACTOR
            for k in range(CELLS):
                row, col = row0 + k // FACTOR, col0 + k % FACTOR
                code = np.uint8(UNKNOWN)
                if row < rows and col < cols and np.isfinite(heights[row, col]):
                    plane = down * (np.float32(k // FACTOR) - np.float32(1.5))
                    plane += across * (np.float32(k % FACTOR) - np.float32(1.5))
                    code = _as_byte((heights[row, col] - here - _QUARTER * plane) * by_height)
                out[k, i, j] = code
            total, known = np.float32(0.0), 0
            for beside in (up, below, left, right):
                if not np.isnan(beside):
                    total += beside
                    known += 1
            above = here - total / np.float32(known) if known else np.float32(0.0)
            out[CELLS, i, j] = _as_byte(down * by_down)
            out[CELLS + 1, i, j] = _as_byte(across * by_across)
            out[CELLS + 2, i, j] = _as_byte(above * by_height)
