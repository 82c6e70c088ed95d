"""What lines cost that lead anywhere on the map: the line integral, the check of a leg, way points left out.

See `planners.refine`, and `kernels.stations` for how lines are found.

Places are (row, col) in cells, with the middle of the first cell at (0, 0), so that a cell's sides lie at halves. The
weight at a place is bilinear in those of the four cells whose middles surround it; the impassable ones among them are
left out, and the others' shares are raised to sum to 1. A cell's length costs `steps[0]` + 2 · `steps[2]` · weight:
what a straight step on even ground does.

A *leg* is the straight way between two way points.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.by_address import borrowed
from nnpp_edge.runtime.kernels.tiles import open_there

TOUCH = 1e-6
"""Cells: a leg that comes so near to a cell touches it."""


@kernel
def ground_of(grid):
    """What the kernels below go by: (weights, stride, cost of a cell's length, what a weight adds to it, cutting)."""
    weights, stride, steps, corner_cutting, _ = grid
    return borrowed(weights), stride, steps[0], 2.0 * steps[2], corner_cutting


@kernel
def open_between(grid, low, high):
    """See to it that the weights are there of all cells of a rectangle between two places, and of those around it."""
    tiles = grid[4]
    state, wanted, row_shift, col_shift, _, _ = tiles
    for i in range(np.int64(low[0] + 0.5) >> row_shift, (np.int64(high[0] + 0.5) >> row_shift) + 1):
        for j in range(np.int64(low[1] + 0.5) >> col_shift, (np.int64(high[1] + 0.5) >> col_shift) + 1):
            if not state[i, j] & wanted:
                open_there(tiles, i, j)


@kernel
def is_passable(ground, row, col):
    """Whether a cell can be stood on; those outside the map cannot."""
    weights, stride = ground[0], ground[1]
    node = np.uint64((row + 1) * stride + col + 1)
    return weights[node] < np.inf


@kernel
def mean_of_four(weights, stride, row, col):
    """Weight at a place by the four cells around it; inf or NaN where one of them is impassable."""
    i, j = np.int64(row + 1.0), np.int64(col + 1.0)
    down, right = row + 1.0 - i, col + 1.0 - j
    n, below = np.uint64(i * stride + j), np.uint64(i * stride + j + stride)
    one, two = np.float64(weights[n]), np.float64(weights[n + np.uint64(1)])
    three, four = np.float64(weights[below]), np.float64(weights[below + np.uint64(1)])
    return (1.0 - down) * ((1.0 - right) * one + right * two) + down * ((1.0 - right) * three + right * four)


@kernel
def weight_at(ground, row, col):
    """Weight at a place in a passable cell."""
    weights, stride = ground[0], ground[1]
    mean = mean_of_four(weights, stride, row, col)
    if mean < np.inf:
        return mean
    i, j = np.int64(row + 1.0), np.int64(col + 1.0)
    down, right = row + 1.0 - i, col + 1.0 - j
    total, shares = 0.0, 0.0
    for k in range(4):
        there = np.float64(weights[np.uint64((i + (k >> 1)) * stride + j + (k & 1))])
        share = (down if k >> 1 else 1.0 - down) * (right if k & 1 else 1.0 - right)
        if there < np.inf and share > 0.0:
            total += share * there
            shares += share
    return total / shares if shares > 0.0 else np.inf


@kernel
def _touches(ground, row, col):
    """Whether a place lies in an impassable cell, or touches one."""
    up, down = np.int64(math.floor(row + 0.5 - TOUCH)), np.int64(math.floor(row + 0.5 + TOUCH))
    left, right = np.int64(math.floor(col + 0.5 - TOUCH)), np.int64(math.floor(col + 0.5 + TOUCH))
    if not is_passable(ground, up, left):
        return True
    if up == down and left == right:
        return False
    return not (
        is_passable(ground, up, right) and is_passable(ground, down, left) and is_passable(ground, down, right)
    )


@kernel
def _along_sides(ground, row, col, rows, cols):
    """Whether a leg along cells' sides touches an impassable one."""
    steps = np.int64(2.0 * max(abs(rows), abs(cols))) + 1
    for k in range(steps + 1):  # noqa: SIM110
        if _touches(ground, row + rows * k / steps, col + cols * k / steps):
            return True
    return False


@kernel
def is_clear(ground, row, col, to_row, to_col):
    """Whether every cell that a leg touches is passable.

    Where corners may be cut, diagonal legs from the middle of a cell may lead through them, as the grid's steps do.
    Of other legs rounding hides whether they pass a corner or cut a sliver off the cell beside it.
    """
    rows, cols = to_row - row, to_col - col
    if _touches(ground, row, col) or _touches(ground, to_row, to_col):
        return False
    for along, across, at in ((cols, rows, row), (rows, cols, col)):
        if abs(across) <= TOUCH and abs(at + 0.5 - round(at + 0.5)) <= 2.0 * TOUCH and abs(along) > 0.0:
            return not _along_sides(ground, row, col, rows, cols)
    i, j = np.int64(math.floor(row + 0.5)), np.int64(math.floor(col + 0.5))
    up, left = (1 if rows > 0.0 else -1), (1 if cols > 0.0 else -1)
    per_row = 1.0 / abs(rows) if rows != 0.0 else np.inf
    per_col = 1.0 / abs(cols) if cols != 0.0 else np.inf
    next_row = (i + 0.5 - row if rows > 0.0 else row + 0.5 - i) * per_row if rows != 0.0 else np.inf
    next_col = (j + 0.5 - col if cols > 0.0 else col + 0.5 - j) * per_col if cols != 0.0 else np.inf
    near = TOUCH * min(per_row, per_col)
    diagonal = ground[4] and abs(rows) == abs(cols) and row == math.floor(row) and col == math.floor(col)
    while True:
        if not is_passable(ground, i, j):
            return False
        if min(next_row, next_col) >= 1.0:
            return True
        if abs(next_row - next_col) <= near:  # a corner
            if not (diagonal and next_row == next_col) and not (
                is_passable(ground, i + up, j) and is_passable(ground, i, j + left)
            ):
                return False
            i, j = i + up, j + left
            next_row, next_col = next_row + per_row, next_col + per_col
        elif next_row < next_col:
            i, next_row = i + up, next_row + per_row
        else:
            j, next_col = j + left, next_col + per_col


@kernel
def leg_cost(ground, row, col, to_row, to_col):
    """The line integral along a clear leg, by Simpson's rule between the lines through the cells' middles.

    It is exact where no impassable cell lies beside the leg.
    """
    rows, cols = to_row - row, to_col - col
    length = math.sqrt(rows * rows + cols * cols)
    per_row = 1.0 / abs(rows) if rows != 0.0 else np.inf
    per_col = 1.0 / abs(cols) if cols != 0.0 else np.inf
    next_row, next_col = np.inf, np.inf
    if rows != 0.0:
        next_row = (math.floor(row) + 1.0 - row if rows > 0.0 else row + 1.0 - math.ceil(row)) * per_row
    if cols != 0.0:
        next_col = (math.floor(col) + 1.0 - col if cols > 0.0 else col + 1.0 - math.ceil(col)) * per_col
    at, total, first = 0.0, 0.0, weight_at(ground, row, col)
    while at < 1.0:
        end = min(next_row, next_col, 1.0)
        if end > at:
            middle, last = 0.5 * (at + end), weight_at(ground, row + end * rows, col + end * cols)
            between = weight_at(ground, row + middle * rows, col + middle * cols)
            total += (end - at) * (first + 4.0 * between + last) / 6.0
            first = last
        if next_row <= end:
            next_row += per_row
        if next_col <= end:
            next_col += per_col
        at = end
    return length * (ground[2] + ground[3] * total)


@kernel
def line_cost(grid, points):
    """The line integral along way points, (N, 2) float64; inf if a leg touches an impassable cell."""
    ground, total = ground_of(grid), 0.0
    for k in range(len(points) - 1):
        if not is_clear(ground, points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1]):
            return np.inf
        total += leg_cost(ground, points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1])
    return total


@kernel
def _sampled_cost(ground, row, col, to_row, to_col, per_cell):
    """About `leg_cost`, by so many samples a cell; inf where the leg is not clear."""
    if not is_clear(ground, row, col, to_row, to_col):
        return np.inf
    rows, cols = to_row - row, to_col - col
    length = math.sqrt(rows * rows + cols * cols)
    samples = max(np.int64(per_cell * length + 0.5), 1)
    total = 0.0
    for k in range(samples):
        share = (k + 0.5) / samples
        total += weight_at(ground, row + share * rows, col + share * cols)
    return length * (ground[2] + ground[3] * total / samples)


@kernel
def shortened(grid, points, every, most, penalty, per_cell):
    """Way points without those that may be left out: the cheapest choice, each way point costing `penalty` more.

    Legs may skip `every`, twice, four times that many points and so on, up to `most`, between points whose numbers
    `every` divides, and lead from each point to the next.
    """
    n, ground = len(points), ground_of(grid)
    costs, before = np.empty(n), np.empty(n, np.int64)
    costs[0], before[0] = 0.0, -1
    for k in range(1, n):
        costs[k], before[k] = np.inf, k - 1
        skipped = 1
        while skipped <= min(most, k):
            i = k - skipped
            rows, cols = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
            least = costs[i] + penalty + ground[2] * math.sqrt(rows * rows + cols * cols)
            if least < costs[k]:
                low = min(points[i, 0], points[k, 0]), min(points[i, 1], points[k, 1])
                high = max(points[i, 0], points[k, 0]), max(points[i, 1], points[k, 1])
                open_between(grid, low, high)
                cost = _sampled_cost(ground, points[i, 0], points[i, 1], points[k, 0], points[k, 1], per_cell)
                if costs[i] + penalty + cost < costs[k]:
                    costs[k], before[k] = costs[i] + penalty + cost, i
            if k % every:
                break
            skipped = 2 * skipped if skipped >= every else every
    count, k = 0, n - 1
    while k >= 0:
        count, k = count + 1, before[k]
    out, k = np.empty((count, 2)), n - 1
    for m in range(count - 1, -1, -1):
        out[m, 0], out[m, 1], k = points[k, 0], points[k, 1], before[k]
    return out


@kernel
def corners(path):
    """(M, 2) float64 cells of a path (N, 2) int32 at which its direction changes, and its ends."""
    out, count, n = np.empty((len(path), 2)), 0, len(path)
    for k in range(n):
        inside = 0 < k < n - 1
        down = inside and path[k + 1, 0] - path[k, 0] == path[k, 0] - path[k - 1, 0]
        if not (down and path[k + 1, 1] - path[k, 1] == path[k, 1] - path[k - 1, 1]):
            out[count, 0], out[count, 1] = path[k, 0], path[k, 1]
            count += 1
    return out[:count].copy()
