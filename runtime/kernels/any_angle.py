"""Costs of lines that lead anywhere on the map: the line integral, the check of a leg, way points
left out.

See `planners.refine`, and `kernels.stations` for how lines are found.

Places are (row, col) in cells, with the middle of the first cell at (0, 0), so that a cell's sides
lie at halves. The weight at a place is bilinear in those of the four cells whose middles surround
it; the impassable ones among them are left out, and the others' shares are raised to sum to 1. A
cell's length costs `steps[0]` + 2 · `steps[2]` · weight: what a straight step on even ground does.

A *leg* is the straight way between two way points. It is clear where every cell that it touches is
passable and, for a disc, where it keeps the disc's radius away from every obstacle. For that the
kernels are given `room`, a tuple

    weights    (nodes,) float32, a point's, inf where a cell is an obstacle or off the map
    rows, cols of the map
    radius     metres
    sides      height and width of a cell, metres: two numbers

which is `NO_DISC` for a point and a body.
"""

import math

import numpy as np
from numpy import int64

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.by_address import borrowed
from nnpp_edge.runtime.kernels.records import Grid, Tiles
from nnpp_edge.runtime.kernels.tiles import open_there

TOUCH = 1e-6
"""Cells: a leg that comes so near to a cell touches it."""
_GAUSS = (
    (-0.906179845938664, 0.2369268850561891),
    (-0.5384693101056831, 0.4786286704993665),
    (0.0, 0.5688888888888889),
    (0.5384693101056831, 0.4786286704993665),
    (0.906179845938664, 0.2369268850561891),
)
NO_DISC = np.empty(0, np.float32), 0, 0, 0.0, 1.0, 1.0
_ROUNDING = 1.0 - 1e-7
"""Share of the radius that is kept away."""


@helper
def ground_of(grid, room):
    """Constants of the kernels below: (weights, stride, a cell's length, what a weight adds,
    cutting, room).
    """
    weights, stride, steps, corner_cutting, _ = grid
    around = borrowed(room[0]), *room[1:]
    return borrowed(weights), stride, steps[0], 2.0 * steps[2], corner_cutting, around


@helper
def open_between(grid, low, high):
    """See to it that the weights are there of all cells of a rectangle between two places, and of
    those around it.
    """
    tiles = borrowed(Tiles(*Grid(*grid).tiles))
    down = tiles.row_shift
    right = tiles.col_shift
    for i in range(int64(low[0] + 0.5) >> down, (int64(high[0] + 0.5) >> down) + 1):
        for j in range(int64(low[1] + 0.5) >> right, (int64(high[1] + 0.5) >> right) + 1):
            if not tiles.state[i, j] & tiles.wanted:
                open_there(tiles, i, j)


@helper
def is_passable(ground, row, col):
    """Whether a cell can be stood on; those outside the map cannot."""
    weights = ground[0]
    stride = ground[1]
    node = np.uint64((row + 1) * stride + col + 1)
    return weights[node] < np.inf


@helper
def mean_of_four(weights, stride, row, col):
    """Weight at a place by the four cells around it; inf or NaN where one of them is impassable."""
    i = np.int64(row + 1.0)
    j = np.int64(col + 1.0)
    down = row + 1.0 - i
    right = col + 1.0 - j
    n = np.uint64(i * stride + j)
    below = np.uint64(i * stride + j + stride)
    one = np.float64(weights[n])
    two = np.float64(weights[n + np.uint64(1)])
    three = np.float64(weights[below])
    four = np.float64(weights[below + np.uint64(1)])
    return (1.0 - down) * ((1.0 - right) * one + right * two) + down * (
        (1.0 - right) * three + right * four
    )


@helper
def weight_at(ground, row, col):
    """Weight at a place in a passable cell."""
    weights = ground[0]
    stride = ground[1]
    mean = mean_of_four(weights, stride, row, col)
    if mean < np.inf:
        return mean
    i = np.int64(row + 1.0)
    j = np.int64(col + 1.0)
    down = row + 1.0 - i
    right = col + 1.0 - j
    total = 0.0
    shares = 0.0
    for k in range(4):
        there = np.float64(weights[np.uint64((i + (k >> 1)) * stride + j + (k & 1))])
        share = (down if k >> 1 else 1.0 - down) * (right if k & 1 else 1.0 - right)
        if there < np.inf and share > 0.0:
            total += share * there
            shares += share
    return total / shares if shares > 0.0 else np.inf


@helper
def _touches(ground, row, col):
    """Whether a place lies in an impassable cell, or touches one."""
    up = np.int64(math.floor(row + 0.5 - TOUCH))
    down = np.int64(math.floor(row + 0.5 + TOUCH))
    left = np.int64(math.floor(col + 0.5 - TOUCH))
    right = np.int64(math.floor(col + 0.5 + TOUCH))
    if not is_passable(ground, up, left):
        return True
    if up == down and left == right:
        return False
    return not (
        is_passable(ground, up, right)
        and is_passable(ground, down, left)
        and is_passable(ground, down, right)
    )


@helper
def _along_sides(ground, row, col, rows, cols):
    """Whether a leg along cells' sides touches an impassable one."""
    steps = np.int64(2.0 * max(abs(rows), abs(cols))) + 1
    for k in range(steps + 1):
        if _touches(ground, row + rows * k / steps, col + cols * k / steps):
            return True
    return False


@helper
def _beside(row, col, to_row, to_col, height, width):
    """Square of the metres from a leg to a cell's square; the leg's ends are in metres, from the
    square's middle.
    """
    near = np.inf
    for r, c in ((row, col), (to_row, to_col)):
        down = max(abs(r) - height, 0.0)
        right = max(abs(c) - width, 0.0)
        near = min(near, down * down + right * right)
    rows = to_row - row
    cols = to_col - col
    length = rows * rows + cols * cols
    sides = 0
    for r, c in ((-height, -width), (-height, width), (height, width), (height, -width)):
        across = (r - row) * cols - (c - col) * rows
        sides += 1 if across > 0.0 else -1
        share = ((r - row) * rows + (c - col) * cols) / length
        if 0.0 < share < 1.0:
            near = min(near, across * across / length)
    overlaps = min(row, to_row) <= height and max(row, to_row) >= -height
    overlaps = overlaps and min(col, to_col) <= width and max(col, to_col) >= -width
    return 0.0 if overlaps and abs(sides) < 4 else near


@helper
def _keeps_away(room, row, col, to_row, to_col):
    """Whether a disc that follows a leg touches no obstacle: by the distance of the leg from each
    cell's square.
    """
    weights, rows, cols, radius, height, width = room
    if radius == 0.0:
        return True
    up = radius / height + 0.5
    left = radius / width + 0.5
    least = (radius * _ROUNDING) ** 2
    down = to_row - row
    right = to_col - col
    if down == 0.0 and right == 0.0:
        down = TOUCH
    for i in range(math.ceil(min(row, to_row) - up), math.floor(max(row, to_row) + up) + 1):
        # the part of the leg that may be so near to this row
        first = 0.0
        last = 1.0
        if down != 0.0:
            one = (i - up - row) / down
            two = (i + up - row) / down
            first = max(min(one, two), 0.0)
            last = min(max(one, two), 1.0)
        low = col + first * right
        high = col + last * right
        for j in range(math.ceil(min(low, high) - left), math.floor(max(low, high) + left) + 1):
            if (
                0 <= i < rows
                and 0 <= j < cols
                and weights[np.uint64((i + 1) * (cols + 2) + j + 1)] < np.inf
            ):
                continue
            begin = (row - i) * height, (col - j) * width
            if (
                _beside(
                    *begin,
                    begin[0] + down * height,
                    begin[1] + right * width,
                    0.5 * height,
                    0.5 * width,
                )
                < least
            ):
                return False
    return True


@helper
def is_clear(ground, row, col, to_row, to_col):
    """Whether every cell that a leg touches is passable, and a disc that follows it touches no
    obstacle.
    """
    return _is_passable_along(ground, row, col, to_row, to_col) and _keeps_away(
        ground[5], row, col, to_row, to_col
    )


@helper
def _is_passable_along(ground, row, col, to_row, to_col):
    """Whether every cell that a leg touches is passable.

    Where corners may be cut, diagonal legs from the middle of a cell may lead through them, as the
    grid's steps do. Of other legs rounding hides whether they pass a corner or cut a sliver off the
    cell beside it.
    """
    rows = to_row - row
    cols = to_col - col
    if _touches(ground, row, col) or _touches(ground, to_row, to_col):
        return False
    for along, across, at in ((cols, rows, row), (rows, cols, col)):
        if (
            abs(across) <= TOUCH
            and abs(at + 0.5 - round(at + 0.5)) <= 2.0 * TOUCH
            and abs(along) > 0.0
        ):
            return not _along_sides(ground, row, col, rows, cols)
    i = np.int64(math.floor(row + 0.5))
    j = np.int64(math.floor(col + 0.5))
    up = 1 if rows > 0.0 else -1
    left = 1 if cols > 0.0 else -1
    per_row = 1.0 / abs(rows) if rows != 0.0 else np.inf
    per_col = 1.0 / abs(cols) if cols != 0.0 else np.inf
    next_row = (i + 0.5 - row if rows > 0.0 else row + 0.5 - i) * per_row if rows != 0.0 else np.inf
    next_col = (j + 0.5 - col if cols > 0.0 else col + 0.5 - j) * per_col if cols != 0.0 else np.inf
    near = TOUCH * min(per_row, per_col)
    diagonal = (
        ground[4] and abs(rows) == abs(cols) and row == math.floor(row) and col == math.floor(col)
    )
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
            i = i + up
            j = j + left
            next_row = next_row + per_row
            next_col = next_col + per_col
        elif next_row < next_col:
            i = i + up
            next_row = next_row + per_row
        else:
            j = j + left
            next_col = next_col + per_col


@helper
def _beside_obstacles(ground, row, col, rows, cols, at, end):
    """The integral of the weight over a leg's share from `at` to `end`, where cells are left out of
    its means.
    """
    total = 0.0
    half = 0.25 * (end - at)
    for k in range(2):
        middle = at + half * (2 * k + 1)
        for place, factor in _GAUSS:
            share = middle + half * place
            total += half * factor * weight_at(ground, row + share * rows, col + share * cols)
    return total


@helper
def leg_cost(ground, row, col, to_row, to_col):
    """The line integral along a clear leg, between the lines through the cells' middles.

    By Simpson's rule, which is exact; beside impassable cells by Gauss's with five points on each
    of two halves.
    """
    rows = to_row - row
    cols = to_col - col
    length = math.sqrt(rows * rows + cols * cols)
    per_row = 1.0 / abs(rows) if rows != 0.0 else np.inf
    per_col = 1.0 / abs(cols) if cols != 0.0 else np.inf
    next_row = np.inf
    next_col = np.inf
    if rows != 0.0:
        next_row = (
            math.floor(row) + 1.0 - row if rows > 0.0 else row + 1.0 - math.ceil(row)
        ) * per_row
    if cols != 0.0:
        next_col = (
            math.floor(col) + 1.0 - col if cols > 0.0 else col + 1.0 - math.ceil(col)
        ) * per_col
    at = 0.0
    total = 0.0
    first = weight_at(ground, row, col)
    while at < 1.0:
        end = min(next_row, next_col, 1.0)
        if end > at:
            middle = 0.5 * (at + end)
            last = weight_at(ground, row + end * rows, col + end * cols)
            between = mean_of_four(ground[0], ground[1], row + middle * rows, col + middle * cols)
            if between < np.inf:
                total += (end - at) * (first + 4.0 * between + last) / 6.0
            else:
                total += _beside_obstacles(ground, row, col, rows, cols, at, end)
            first = last
        if next_row <= end:
            next_row += per_row
        if next_col <= end:
            next_col += per_col
        at = end
    return length * (ground[2] + ground[3] * total)


@kernel
def line_cost(grid, room, points):
    """The line integral along way points, (N, 2) float64; inf if a leg is not clear."""
    ground = ground_of(grid, room)
    total = 0.0
    for k in range(len(points) - 1):
        if not is_clear(ground, points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1]):
            return np.inf
        total += leg_cost(ground, points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1])
    return total


@helper
def _sampled_cost(ground, row, col, to_row, to_col):
    """About `leg_cost`, by a sample a cell; inf where the leg is not clear."""
    if not is_clear(ground, row, col, to_row, to_col):
        return np.inf
    rows = to_row - row
    cols = to_col - col
    length = math.sqrt(rows * rows + cols * cols)
    samples = max(np.int64(length + 0.5), 1)
    total = 0.0
    for k in range(samples):
        share = (k + 0.5) / samples
        total += weight_at(ground, row + share * rows, col + share * cols)
    return length * (ground[2] + ground[3] * total / samples)


@helper
def shortened(grid, room, points, every, most, penalty):
    """Way points without those that may be left out: the cheapest choice, each way point costing
    `penalty` more.

    Legs may skip `every`, twice, four times that many points and so on, up to `most`, between
    points whose numbers `every` divides, and lead from each point to the next.
    """
    n = len(points)
    ground = ground_of(grid, room)
    costs = np.empty(n)
    before = np.empty(n, np.int64)
    costs[0] = 0.0
    before[0] = -1
    for k in range(1, n):
        costs[k] = np.inf
        before[k] = k - 1
        skipped = 1
        while skipped <= min(most, k):
            i = k - skipped
            rows = points[k, 0] - points[i, 0]
            cols = points[k, 1] - points[i, 1]
            least = costs[i] + penalty + ground[2] * math.sqrt(rows * rows + cols * cols)
            if least < costs[k]:
                low = min(points[i, 0], points[k, 0]), min(points[i, 1], points[k, 1])
                high = max(points[i, 0], points[k, 0]), max(points[i, 1], points[k, 1])
                open_between(grid, low, high)
                cost = _sampled_cost(ground, points[i, 0], points[i, 1], points[k, 0], points[k, 1])
                if costs[i] + penalty + cost < costs[k]:
                    costs[k] = costs[i] + penalty + cost
                    before[k] = i
            if k % every:
                break
            skipped = 2 * skipped if skipped >= every else every
    count = 0
    k = n - 1
    while k >= 0:
        count = count + 1
        k = before[k]
    out = np.empty((count, 2))
    k = n - 1
    for m in range(count - 1, -1, -1):
        out[m, 0] = points[k, 0]
        out[m, 1] = points[k, 1]
        k = before[k]
    return out


@kernel
def corners(path):
    """(M, 2) float64 cells of a path (N, 2) int32 at which its direction changes, and its ends."""
    out = np.empty((len(path), 2))
    count = 0
    n = len(path)
    for k in range(n):
        inside = 0 < k < n - 1
        down = inside and path[k + 1, 0] - path[k, 0] == path[k, 0] - path[k - 1, 0]
        if not (down and path[k + 1, 1] - path[k, 1] == path[k, 1] - path[k - 1, 1]):
            out[count, 0] = path[k, 0]
            out[count, 1] = path[k, 1]
            count += 1
    return out[:count].copy()
