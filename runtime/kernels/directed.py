"""The kernels of steps that cost by the slope: what each step of a map costs, and their means on
coarse levels.

Steps of a map (H, W) stand as (H + 2, W + 2, 8) float32, by cell, with a border, and direction; inf
where there is none.
"""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.nodes import COL_STEP, OPPOSITE, ROW_STEP
from nnpp_edge.runtime.kernels.pooling import FACTOR

STEEPEST = 3.0
PER_SLOPE = 1024
"""Slopes, rise a metre, up to which a table has knots, and how many to a slope of 1. See
`robots.slope.cost`.
"""
_INF_BITS = np.float32(np.inf).view(np.int32)


@helper
def _price_ways(table, length, rises, at, costs):
    """Costs of ways of one length with these rises, by a table as for `price_steps`, into
    `costs`.
    """
    kinks, level, gradient = table
    last = np.float64(len(level) - len(kinks) - 1)
    over = PER_SLOPE / length
    for n in range(len(rises)):
        step = rises[n] * over + STEEPEST * PER_SLOPE
        step = step if step > 0.0 else 0.0  # also of what is not a number
        at[n] = np.int32(step if step < last else last)
    for k in range(len(kinks)):
        kink = kinks[k] * length
        for n in range(len(rises)):
            at[n] += np.int32(rises[n] >= kink)
    for n in range(len(rises)):
        segment = np.uint32(at[n])
        costs[n] = level[segment] * length + gradient[segment] * rises[n]


@kernel
def price_steps(heights, weights, rule, priced, ways, area, steps):
    """Compute the steps that leave the cells of a rectangle.

    Parameters
    ----------
    heights : (H, W) float32
        Metres; not finite where unknown.
    weights : (nodes,) float32
        Of the grid; inf where it is impassable.
    rule : (by_weights, corner_cutting)
        Whether impassable cells may not be entered, and whether a diagonal step may pass beside
        one.
    priced : (kinks, level, gradient), least_per_m
        What a metre costs, as `robots.slope.cost.Table`, less what its rise is worth, and the
        cheapest metre.
    ways : (steps, lengths)
        (K, 2) int64 rows and columns that the step in each direction leads to, and (K,) float64 its
        length in metres: the eight neighbours', or a body's sixteen legs, which poses decide on.
    area : (row0, row1, col0, col1)
    steps : (H + 2, W + 2, K) float32
        Written inside the rectangle.

    Returns
    -------
    float
        The dearest step.
    """
    by_weights, corner_cutting = rule
    table, least_per_m = priced
    rows, cols = heights.shape
    row0, row1, col0, col1 = area
    leads, lengths = ways
    stride = cols + 2
    greatest = np.int32(0)
    inf = np.float32(np.inf)
    rises = np.empty(col1 - col0)
    costs = np.empty(col1 - col0)
    segments = np.empty(col1 - col0, np.int32)
    line = np.empty((len(lengths), col1 - col0), np.float32)
    for row in range(row0, row1):
        line[:] = inf  # where they lead off the map
        for k in range(len(lengths)):
            up = leads[k, 0]
            left = leads[k, 1]
            length = lengths[k]
            first = max(col0, -left)
            last = min(col1, cols - left)
            there = row + up
            if not 0 <= there < rows or last <= first:
                continue
            for col in range(first, last):
                rises[col - first] = np.float64(heights[there, col + left]) - np.float64(
                    heights[row, col]
                )
            count = last - first
            least = least_per_m * length
            _price_ways(table, length, rises[:count], segments, costs[:count])
            corners = by_weights and not corner_cutting and k >= 4
            node = (row + 1) * stride + first + 1
            out = line[k, first - col0 :]
            for at in range(count):
                free = abs(rises[at]) < inf
                if by_weights:
                    free &= max(weights[node + at], weights[node + at + up * stride + left]) < inf
                if corners:
                    free &= max(weights[node + at + up * stride], weights[node + at + left]) < inf
                cost = np.float32(max(costs[at], least))
                out[at] = cost if free else inf
        for bits in line.view(np.int32).reshape(
            -1
        ):  # ordered as the numbers, none of which is below 0
            greatest = max(greatest, bits if bits < _INF_BITS else np.int32(0))
        for at in range(col1 - col0):
            for k in range(len(lengths)):
                steps[row + 1, col0 + at + 1, k] = line[k, at]
    return np.array([greatest], np.int32).view(np.float32)[0]


@kernel
def pool_steps(finer, pieces, obstacle, area, means):
    """Average the steps of a finer level, or of the map, over the cells of a rectangle of a coarse
    one.

    Parameters
    ----------
    finer : (steps, neighbours)
        (H + 2, W + 2, K) float32 of the map, or means of the finer level, and (8,) int64, which of
        the K lead to the neighbours. Those that lead off the map do not count.
    pieces : (nodes,) uint16
        The cells below each cell that it stands for, as bits; what is in none of them counts as an
        obstacle.
    obstacle : (8,) float32
        What an impassable cell counts for, by direction.
    area : (row0, row1, col0, col1)
    means : (h + 2, w + 2, 8) float32
        Written inside the rectangle.
    """
    steps, neighbours = finer
    rows = steps.shape[0] - 2
    cols = steps.shape[1] - 2
    row0, row1, col0, col1 = area
    stride = means.shape[1]
    for row in range(row0, row1):
        for col in range(col0, col1):
            own = np.int64(pieces[(row + 1) * stride + col + 1])
            for k in range(8):
                if own == 0:
                    means[row + 1, col + 1, k] = np.inf
                    continue
                total = np.float32(0.0)
                count = 0
                way = neighbours[k]
                for bit in range(FACTOR * FACTOR):
                    r = row * FACTOR + bit // FACTOR
                    c = col * FACTOR + bit % FACTOR
                    i = r + ROW_STEP[k]
                    j = c + COL_STEP[k]
                    if r >= rows or c >= cols or not (0 <= i < rows and 0 <= j < cols):
                        continue
                    step = steps[r + 1, c + 1, way]
                    total += step if (own >> bit) & 1 and step < np.inf else obstacle[k]
                    count += 1
                means[row + 1, col + 1, k] = total / np.float32(count) if count else obstacle[k]


@kernel
def join_steps(means, area, edges, backwards):
    """Steps of a rectangle of coarse cells: half by the cell that is left, half by the one that is
    come to.

    Parameters
    ----------
    means : (h + 2, w + 2, 8) float32
        As `pool_steps` writes them.
    area : (row0, row1, col0, col1)
    edges, backwards : (h + 2, w + 2, 8) float32
        Written: of the step that leaves a cell in each direction, and of that by which it is come
        to from there.
    """
    row0, row1, col0, col1 = area
    half = np.float32(0.5)
    for row in range(row0 + 1, row1 + 1):
        for col in range(col0 + 1, col1 + 1):
            for k in range(8):
                i = row + ROW_STEP[k]
                j = col + COL_STEP[k]
                back = OPPOSITE[k]
                edges[row, col, k] = half * (means[row, col, k] + means[i, j, k])
                backwards[row, col, k] = half * (means[row, col, back] + means[i, j, back])
