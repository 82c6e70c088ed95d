"""Costs of lines that lead anywhere on the map: the line integral, the check of a leg, way points
left out.

See `planners.refine`, and `kernels.stations` for how lines are found.

Places are (row, col) in cells, with the middle of the first cell at (0, 0), so that a cell's sides
lie at halves. The weight at a place is bilinear in those of the four cells whose middles surround
it; the impassable ones among them are left out, and the others' shares are raised to sum to 1. A
cell's length costs what a straight step on even ground does: its length, and its weight twice.

A leg is clear where every cell that it touches is passable and, for a disc, where it keeps the
disc's radius away from every obstacle.
"""

import math

import numpy as np
from numpy import float64, inf, int64, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined
from nnpp_edge.runtime.kernels.nodes import COL, ROW
from nnpp_edge.runtime.kernels.records import GroundRecord, Leg, Room
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
"""Places, in the middle half of a leg's length to each side, and weights of Gauss's rule."""
NO_DISC = tuple(Room(np.empty(0, np.float32), 0, 0, 0.0, 1.0, 1.0))
_ROUNDING = 1.0 - 1e-7
"""Share of the radius that is kept away."""


# The ground


@helper
def ground_of(grid, room):
    """`GroundRecord` of a `GridRecord` and a `Room`."""
    steps = grid.steps
    per_cell = steps.length_straight
    per_weight = 2.0 * steps.weight_straight
    return GroundRecord(grid.weights, grid.stride, per_cell, per_weight, grid.corner_cutting, room)


@helper
def open_between(tiles, leg):
    """See to it that the weights are there of all cells of the rectangle around a leg, and of those
    around it.
    """
    top = int64(min(leg.row, leg.to_row) + 0.5) >> tiles.row_shift
    bottom = int64(max(leg.row, leg.to_row) + 0.5) >> tiles.row_shift
    left = int64(min(leg.col, leg.to_col) + 0.5) >> tiles.col_shift
    right = int64(max(leg.col, leg.to_col) + 0.5) >> tiles.col_shift
    for i in range(top, bottom + 1):
        for j in range(left, right + 1):
            if not tiles.state[i, j] & tiles.wanted:
                open_there(tiles, i, j)


@helper
def is_passable(ground, row, col):
    """Whether a cell can be stood on; those outside the map cannot."""
    return ground.weights[uint64((row + 1) * ground.stride + col + 1)] < inf


@helper
def mean_of_four(ground, row, col):
    """Weight at a place by the four cells around it; inf or NaN where one of them is impassable."""
    weights = ground.weights
    i = int64(row + 1.0)
    j = int64(col + 1.0)
    down = row + 1.0 - i
    right = col + 1.0 - j
    n = uint64(i * ground.stride + j)
    below = uint64(i * ground.stride + j + ground.stride)
    one = float64(weights[n])
    two = float64(weights[n + uint64(1)])
    three = float64(weights[below])
    four = float64(weights[below + uint64(1)])
    upper = (1.0 - right) * one + right * two
    lower = (1.0 - right) * three + right * four
    return (1.0 - down) * upper + down * lower


@helper
def weight_at(ground, row, col):
    """Weight at a place in a passable cell."""
    mean = mean_of_four(ground, row, col)
    if mean < inf:
        return mean
    i = int64(row + 1.0)
    j = int64(col + 1.0)
    down = row + 1.0 - i
    right = col + 1.0 - j
    total = 0.0
    shares = 0.0
    for k in range(4):
        below = k >> 1
        beside = k & 1
        node = (i + below) * ground.stride + j + beside
        there = float64(ground.weights[uint64(node)])
        share = (1.0 - abs(down - below)) * (1.0 - abs(right - beside))
        if there < inf and share > 0.0:
            total += share * there
            shares += share
    return total / shares if shares > 0.0 else inf


# Legs


@inlined
def leg_between(points, i, k):
    """The leg from one way point to another."""
    begin = points[i]
    end = points[k]
    return Leg(begin[ROW], begin[COL], end[ROW], end[COL])


@inlined
def way_of(leg):
    """Rows and columns that a leg leads, and its length, in cells."""
    down = leg.to_row - leg.row
    right = leg.to_col - leg.col
    return down, right, math.sqrt(down * down + right * right)


@inlined
def _columns_near(leg, i, rows_off, cols_off):
    """First and last of the columns that are so near to the part of a leg that is so near to a
    row; the last is before the first where there is none.
    """
    down, right, _ = way_of(leg)
    first = 0.0
    last = 1.0
    if down != 0.0:
        one = (i - rows_off - leg.row) / down
        two = (i + rows_off - leg.row) / down
        first = max(min(one, two), 0.0)
        last = min(max(one, two), 1.0)
    begin = leg.col + first * right
    end = leg.col + last * right
    return math.ceil(min(begin, end) - cols_off), math.floor(max(begin, end) + cols_off)


@helper
def _is_passable_along(ground, leg):
    """Whether every cell that a leg touches is passable.

    Where corners may be cut, diagonal legs from the middle of a cell may lead through them, as the
    grid's steps do. Of other legs rounding hides whether they pass a corner or cut a sliver off the
    cell beside it.
    """
    down, right, _ = way_of(leg)
    from_middle = leg.row == math.floor(leg.row) and leg.col == math.floor(leg.col)
    through_corners = ground.corner_cutting and abs(down) == abs(right) and from_middle
    off = 0.5 - TOUCH if through_corners else 0.5 + TOUCH
    top = math.ceil(min(leg.row, leg.to_row) - off)
    bottom = math.floor(max(leg.row, leg.to_row) + off)
    for i in range(top, bottom + 1):
        left, last = _columns_near(leg, i, off, off)
        for j in range(left, last + 1):
            if not is_passable(ground, i, j):
                return False
    return True


@inlined
def _beyond(at, half):
    """Square of how far a coordinate lies outside [-half, half]."""
    over = max(abs(at) - half, 0.0)
    return over * over


@helper
def _square_apart(leg, height, width):
    """Square of the metres from a leg to a cell's square, of half this height and width, that it
    does not cross; the leg's ends are in metres, from the square's middle.
    """
    down, right, _ = way_of(leg)
    of_start = _beyond(leg.row, height) + _beyond(leg.col, width)
    of_end = _beyond(leg.to_row, height) + _beyond(leg.to_col, width)
    near = min(of_start, of_end)
    length = down * down + right * right
    for row, col in ((-height, -width), (-height, width), (height, width), (height, -width)):
        across = (row - leg.row) * right - (col - leg.col) * down
        along = (row - leg.row) * down + (col - leg.col) * right
        if 0.0 < along < length:
            near = min(near, across * across / length)
    return near


@helper
def _keeps_away(room, leg):
    """Whether a disc that follows a leg over passable cells touches no obstacle: by the distance
    of the leg from each cell's square.
    """
    if room.radius == 0.0:
        return True
    height = room.cell_height
    width = room.cell_width
    rows_off = room.radius / height + 0.5
    cols_off = room.radius / width + 0.5
    least = (room.radius * _ROUNDING) ** 2
    down, right, _ = way_of(leg)
    # what lies off the map begins with the row, or column, beside it
    top = max(math.ceil(min(leg.row, leg.to_row) - rows_off), -1)
    bottom = min(math.floor(max(leg.row, leg.to_row) + rows_off), room.rows)
    for i in range(top, bottom + 1):
        left, last = _columns_near(leg, i, rows_off, cols_off)
        for j in range(max(left, -1), min(last, room.cols) + 1):
            if room.weights[uint64((i + 1) * (room.cols + 2) + j + 1)] < inf:
                continue
            row = (leg.row - i) * height
            col = (leg.col - j) * width
            metres = Leg(row, col, row + down * height, col + right * width)
            if _square_apart(metres, 0.5 * height, 0.5 * width) < least:
                return False
    return True


@helper
def is_clear(ground, leg):
    """Whether every cell that a leg touches is passable, and a disc that follows it touches no
    obstacle.
    """
    return _is_passable_along(ground, leg) and _keeps_away(ground.room, leg)


# Costs


@helper
def _integral_beside_obstacles(ground, leg, at, end):
    """The integral of the weight over a leg's share from `at` to `end`, where cells are left out of
    its means.
    """
    down, right, _ = way_of(leg)
    total = 0.0
    half = 0.25 * (end - at)
    for k in range(2):
        middle = at + half * (2 * k + 1)
        for place, factor in _GAUSS:
            share = middle + half * place
            weight = weight_at(ground, leg.row + share * down, leg.col + share * right)
            total += half * factor * weight
    return total


@inlined
def _per(way):
    """Share of a leg that leads a row, or a column, on."""
    return 1.0 / abs(way) if way != 0.0 else inf


@inlined
def _to_middle(at, way):
    """Share of a leg up to the next line through the cells' middles."""
    if way == 0.0:
        return inf
    apart = math.floor(at) + 1.0 - at if way > 0.0 else at + 1.0 - math.ceil(at)
    return apart * _per(way)


@helper
def leg_cost(ground, leg):
    """The line integral along a clear leg, between the lines through the cells' middles.

    By Simpson's rule, which is exact; beside impassable cells by Gauss's with five points on each
    of two halves.
    """
    row = leg.row
    col = leg.col
    down, right, length = way_of(leg)
    next_row = _to_middle(row, down)
    next_col = _to_middle(col, right)
    at = 0.0
    total = 0.0
    first = weight_at(ground, row, col)
    while at < 1.0:
        end = min(next_row, next_col, 1.0)
        if end > at:
            middle = 0.5 * (at + end)
            last = weight_at(ground, row + end * down, col + end * right)
            between = mean_of_four(ground, row + middle * down, col + middle * right)
            if between < inf:
                total += (end - at) * (first + 4.0 * between + last) / 6.0
            else:
                total += _integral_beside_obstacles(ground, leg, at, end)
            first = last
        if next_row <= end:
            next_row += _per(down)
        if next_col <= end:
            next_col += _per(right)
        at = end
    return length * (ground.per_cell + ground.per_weight * total)


@helper
def cost_along(ground, points):
    """The line integral along way points; inf if a leg is not clear."""
    total = 0.0
    for k in range(len(points) - 1):
        leg = leg_between(points, k, k + 1)
        if not is_clear(ground, leg):
            return inf
        total += leg_cost(ground, leg)
    return total


@helper
def _sampled_cost(ground, leg):
    """About `leg_cost`, by a sample a cell; inf where the leg is not clear."""
    if not is_clear(ground, leg):
        return inf
    down, right, length = way_of(leg)
    samples = max(int64(length + 0.5), 1)
    total = 0.0
    for k in range(samples):
        share = (k + 0.5) / samples
        total += weight_at(ground, leg.row + share * down, leg.col + share * right)
    return length * (ground.per_cell + ground.per_weight * total / samples)


@helper
def sampled_along(ground, points):
    """About `cost_along`."""
    total = 0.0
    for k in range(len(points) - 1):
        total += _sampled_cost(ground, leg_between(points, k, k + 1))
    return total


@helper
def run_of(points):
    """Length of the line up to each way point, in cells."""
    run = np.zeros(len(points))
    for k in range(1, len(points)):
        _, _, length = way_of(leg_between(points, k - 1, k))
        run[k] = run[k - 1] + length
    return run


@helper
def shortened(ground, tiles, points, penalty):
    """Way points without those that may be left out, as long as a fifth of them is."""
    before = 2 * len(points)
    while len(points) < 0.8 * before:
        before = len(points)
        points = _without_some(ground, tiles, points, penalty)
    return points


@helper
def _without_some(ground, tiles, points, penalty):
    """The cheapest choice of legs from each way point to the next or the one after, each way point
    costing `penalty` more.
    """
    n = len(points)
    costs = np.full(n, inf)
    before = np.arange(-1, n - 1)
    costs[0] = 0.0
    for k in range(1, n):
        for i in range(k - 1, max(k - 3, -1), -1):
            leg = leg_between(points, i, k)
            _, _, length = way_of(leg)
            begun = costs[i] + penalty
            if begun + ground.per_cell * length < costs[k]:
                open_between(tiles, leg)
                cost = begun + _sampled_cost(ground, leg)
                if cost < costs[k]:
                    costs[k] = cost
                    before[k] = i
    return _chosen(points, before)


@helper
def _chosen(points, before):
    """The way points from the last back to the first, by the number of the one before each."""
    backwards = np.empty_like(points)
    count = 0
    k = len(points) - 1
    while k >= 0:
        backwards[count] = points[k]
        count += 1
        k = before[k]
    return backwards[:count][::-1].copy()


@helper
def corners(path):
    """(M, 2) float64 cells of a path (N, 2) int32 at which its direction changes, and its ends."""
    out = np.empty((len(path), 2))
    count = 0
    last = len(path) - 1
    for k in range(len(path)):
        if 0 < k < last:
            before = path[k - 1]
            after = path[k + 1]
            down = before[ROW] + after[ROW] - 2 * path[k, ROW]
            right = before[COL] + after[COL] - 2 * path[k, COL]
            if down == 0 and right == 0:
                continue
        out[count] = path[k]
        count += 1
    return out[:count].copy()
