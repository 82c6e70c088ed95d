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
_QUARTER, _HALF, _ROUNDED = np.float32(0.25), np.float32(0.5), np.float32(MIDDLE + 0.5)


@kernel
def _as_byte(value):
    """A number of steps around `MIDDLE`, cut off at both ends."""
    return np.uint8(min(max(value, np.float32(1 - MIDDLE)), np.float32(UNKNOWN - MIDDLE)) + _ROUNDED)


@kernel
def _on_map(first_col, cols, count):
    """Which of `count` cells from `first_col` on, one in each block of a row, lie on the map: from and to where."""
    begin = min(max(-(first_col // FACTOR), 0), count)
    return begin, min(max((cols - 1 - first_col) // FACTOR + 1, begin), count)


@kernel
def _mean_heights(heights, first, known, means):
    """Mean height of the known cells of each block, NaN where there are none. `first` is the block of means[0, 0]."""
    rows, cols = heights.shape
    for i in range(means.shape[0]):
        total = means[i]
        total[:], known[:] = 0.0, 0.0
        for k in range(CELLS):
            row, col = (first[0] + i) * FACTOR + k // FACTOR, first[1] * FACTOR + k % FACTOR
            if 0 <= row < rows:
                begin, end = _on_map(col, cols, len(total))
                _add_known(heights[row, col + FACTOR * begin :: FACTOR], total[begin:end], known[begin:end])
        total /= known


@kernel
def _add_known(line, total, known):
    """Add the finite heights among a line's to their blocks' totals, and count them."""
    for j in range(len(total)):
        finite = abs(line[j]) < np.inf
        total[j] += line[j] if finite else np.float32(0.0)
        known[j] += np.float32(1.0) if finite else np.float32(0.0)


@kernel
def _gradient(before, here, after):
    """Rise from a block to the next, by those of its neighbours that are known."""
    if np.isnan(before):
        return np.float32(0.0) if np.isnan(after) else after - here
    return here - before if np.isnan(after) else _HALF * (after - before)


@kernel
def _above_neighbours(here, beside):
    """How far a block's mean lies above that of its known neighbours."""
    total, known = np.float32(0.0), 0
    for other in beside:
        if not np.isnan(other):
            total += other
            known += 1
    return here - total / np.float32(known) if known else np.float32(0.0)


@kernel
def _describe_line(line, place, planes, by_height, out):
    """How far one cell of each block, at `place` from the block's middle, stands above the block's plane."""
    low, right = place
    means, down, across = planes
    for j in range(len(out)):
        plane = means[j] + _QUARTER * (down[j] * low + across[j] * right)
        known = abs(line[j] - means[j]) < np.inf
        out[j] = _as_byte((line[j] - plane) * by_height if known else np.float32(UNKNOWN))


@kernel
def describe_blocks(heights, first, scales, scratch, out):
    """Fill `out` with what is shown of a rectangle of blocks.

    Parameters
    ----------
    heights : (H, W) float32
        Metres; not finite where unknown.
    first : (row, col)
        The first block; it may lie off the map, where all is unknown.
    scales : (height, down, across)
        Steps of a byte to a metre; to a metre's rise from a block to the one below; and to the one at its right.
    scratch : ((R + 2, C + 2), (3, C + 2)) float32
        Overwritten.
    out : (19, R, C) uint8
    """
    by_height, by_down, by_across = scales
    rows, cols = heights.shape
    means, (down, across, known) = scratch[0], scratch[1]
    _mean_heights(heights, (first[0] - 1, first[1] - 1), known, means)
    for i in range(out.shape[1]):
        for j in range(out.shape[2]):
            here = means[i + 1, j + 1]
            up, below, left, right = means[i, j + 1], means[i + 2, j + 1], means[i + 1, j], means[i + 1, j + 2]
            down[j], across[j], above = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            if not np.isnan(here):
                down[j], across[j] = _gradient(up, here, below), _gradient(left, here, right)
                above = _above_neighbours(here, (up, below, left, right))
            out[CELLS, i, j] = _as_byte(down[j] * by_down)
            out[CELLS + 1, i, j] = _as_byte(across[j] * by_across)
            out[CELLS + 2, i, j] = _as_byte(above * by_height)
        for k in range(CELLS):
            row, col = (first[0] + i) * FACTOR + k // FACTOR, first[1] * FACTOR + k % FACTOR
            out[k, i] = UNKNOWN
            if 0 <= row < rows:
                begin, end = _on_map(col, cols, out.shape[2])
                place = np.float32(k // FACTOR) - np.float32(1.5), np.float32(k % FACTOR) - np.float32(1.5)
                planes = means[i + 1, begin + 1 : end + 1], down[begin:end], across[begin:end]
                line = heights[row, col + FACTOR * begin :: FACTOR]
                _describe_line(line, place, planes, by_height, out[k, i, begin:end])
