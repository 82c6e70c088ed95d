"""What it costs a vehicle to get from block to block of a map all of whose poses have been checked.

A block of 4 × 4 cells is stood for by one of its cells: of those that belong to the largest connected part of the map
that reaches into the block, the one nearest its middle.
"""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.pooling import FACTOR

DOWN, RIGHT = (1, 1, 0, -1), (0, 1, 1, 1)
"""Of the step along each heading, see `terrain.vehicle.HEADINGS`."""
_AROUND = 3 * FACTOR
_DIAGONAL = np.float32(2.0**0.5)


@kernel
def connected_parts(costs, parts, queue, sizes):
    """Number the cells by the connected part that they belong to, and count the cells of each; the number of parts.

    `costs` are (4, H, W) T of poses, inf where one fails. `parts` (H, W), `queue` (H · W,) and `sizes` (H · W,), all
    int32, are written.
    """
    rows, cols = parts.shape
    parts[:] = -1
    found = 0
    for first in range(rows * cols):
        if parts[first // cols, first % cols] >= 0:
            continue
        head, tail = 0, 1
        queue[0] = first
        parts[first // cols, first % cols] = found
        while head < tail:
            row, col = queue[head] // cols, queue[head] % cols
            head += 1
            for k in range(4):
                if costs[k, row, col] == np.inf:
                    continue
                for sign in (-1, 1):
                    i, j = row + sign * DOWN[k], col + sign * RIGHT[k]
                    if 0 <= i < rows and 0 <= j < cols and parts[i, j] < 0 and costs[k, i, j] != np.inf:
                        parts[i, j] = found
                        queue[tail] = i * cols + j
                        tail += 1
        sizes[found] = tail
        found += 1
    return found


@kernel
def middles_of_blocks(parts, sizes, middles):
    """The cell that stands for each block, into `middles`, (R, C, 2) int32; -1 where no step leads anywhere."""
    middles[:] = -1
    half = 0.5 * (FACTOR - 1)
    for r in range(middles.shape[0]):
        for c in range(middles.shape[1]):
            largest, nearest = 1, np.inf
            for row in range(FACTOR * r, FACTOR * r + FACTOR):
                for col in range(FACTOR * c, FACTOR * c + FACTOR):
                    size = sizes[parts[row, col]]
                    away = (row - FACTOR * r - half) ** 2 + (col - FACTOR * c - half) ** 2
                    if size > largest or (size == largest and size > 1 and away < nearest):
                        largest, nearest = size, away
                        middles[r, c, 0], middles[r, c, 1] = row, col


@kernel
def _settle_around(costs, weight, first, corner, reached):
    """Costs from a cell to all within the 12 × 12 cells from `corner` on, by ways within these: Bellman and Ford."""
    rows, cols = costs.shape[1], costs.shape[2]
    reached[:] = np.inf
    reached[first[0] - corner[0], first[1] - corner[1]] = 0.0
    better = True
    while better:
        better = False
        for turn in range(2):
            for n in range(_AROUND * _AROUND):
                at = n if turn == 0 else _AROUND * _AROUND - 1 - n
                i, j = at // _AROUND, at % _AROUND
                if reached[i, j] == np.inf:
                    continue
                for k in range(4):
                    own = costs[k, corner[0] + i, corner[1] + j]
                    if own == np.inf:
                        continue
                    length = np.float32(1.0) if k % 2 == 0 else _DIAGONAL
                    for sign in (-1, 1):
                        a, b = i + sign * DOWN[k], j + sign * RIGHT[k]
                        row, col = corner[0] + a, corner[1] + b
                        if 0 <= a < _AROUND and 0 <= b < _AROUND and 0 <= row < rows and 0 <= col < cols:
                            cost = reached[i, j] + length + weight * (own + costs[k, row, col])
                            if cost < reached[a, b] - np.float32(1e-4):
                                reached[a, b] = cost
                                better = True


@kernel
def crossing_costs(costs, weight, middles, reached, out):
    """Cost from the middle of each block to that of the next along each heading, over what a straight way is long.

    Ways may lead through the 3 × 3 blocks around a block. `weight` is that of T = 1; `reached` (12, 12) float32 is
    overwritten; `out` is (4, R, C) float32, inf where there is no way.
    """
    rows, cols = middles.shape[0], middles.shape[1]
    out[:] = np.inf
    for r in range(rows):
        for c in range(cols):
            if middles[r, c, 0] < 0:
                continue
            corner = FACTOR * (r - 1), FACTOR * (c - 1)
            _settle_around(costs, weight, (middles[r, c, 0], middles[r, c, 1]), corner, reached)
            for k in range(4):
                for sign in (1, -1):
                    a, b = r + sign * DOWN[k], c + sign * RIGHT[k]
                    if not (0 <= a < rows and 0 <= b < cols) or middles[a, b, 0] < 0:
                        continue
                    down, right = abs(middles[a, b, 0] - middles[r, c, 0]), abs(middles[a, b, 1] - middles[r, c, 1])
                    straight = np.float32(max(down, right)) + (_DIAGONAL - np.float32(1.0)) * np.float32(
                        min(down, right)
                    )
                    cost = reached[middles[a, b, 0] - corner[0], middles[a, b, 1] - corner[1]] / straight
                    i, j = (r, c) if sign == 1 else (a, b)  # a link stands with the block that it leaves forwards
                    out[k, i, j] = min(out[k, i, j], cost)
