"""The kernels of steps that cost by the slope: what each step of a map costs, and their means on coarse levels.

Steps of a map (H, W) stand as (H + 2, W + 2, 8) float32, by cell, with a border, and direction; inf where there is
none.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.nodes import COL_STEP, OPPOSITE, ROW_STEP
from nnpp_edge.runtime.kernels.pooling import FACTOR

TOBLER, LINEAR, TIME, ENERGY = range(4)
"""Models, see `map.slope_cost`."""
LARGEST_EXPONENT = 60.0
"""Of Tobler's function, so that no wall's cost overflows: 0.6 s · e^60 a metre."""


@helper
def _exponential(x):
    """e^x for x from 0 to `LARGEST_EXPONENT`, to 1e-12 of it; for several x at once, unlike the library's."""
    x *= 1.0 / 256.0
    e = 1.0 + x / 8.0 * (1.0 + x / 9.0 * (1.0 + x / 10.0))
    e = 1.0 + x / 4.0 * (1.0 + x / 5.0 * (1.0 + x / 6.0 * (1.0 + x / 7.0 * e)))
    e = 1.0 + x * (1.0 + x / 2.0 * (1.0 + x / 3.0 * e))
    for _ in range(8):
        e *= e
    return e


@helper
def _arc_tangent(x):
    """The angle whose tangent is x, to 1e-15: eight times an eighth of it, by its series; for several x at once."""
    for _ in range(3):
        x /= 1.0 + math.sqrt(1.0 + x * x)
    y = x * x
    tail = 1.0 / 13.0 - y * (1.0 / 15.0 - y * (1.0 / 17.0 - y * (1.0 / 19.0 - y / 21.0)))
    tail = 1.0 / 5.0 - y * (1.0 / 7.0 - y * (1.0 / 9.0 - y * (1.0 / 11.0 - y * tail)))
    return 8.0 * x * (1.0 - y * (1.0 / 3.0 - y * tail))


@helper
def _price_by_time(values, length, rises, costs):
    """As `price_ways`, by the speeds on slopes: `values` has the slopes, radians, then the speeds."""
    speeds, slopes = len(values) // 2, np.empty(len(rises))
    for at in range(len(rises)):
        slopes[at] = _arc_tangent(rises[at] / length)
        costs[at] = values[speeds]
    for first in range(speeds - 1):
        low, gain = values[first], values[speeds + first + 1] - values[speeds + first]
        share = 1.0 / (values[first + 1] - low)
        for at in range(len(rises)):
            costs[at] += gain * min(max((slopes[at] - low) * share, 0.0), 1.0)
    for at in range(len(rises)):
        costs[at] = math.sqrt(length * length + rises[at] * rises[at]) / costs[at]


@helper
def price_ways(model, values, length, rises, costs):
    """Costs of ways of one length with these rises by a model, as `SlopeCost.cost`, into `costs`.

    A model is its number and its values, as its ``packed`` has them.
    """
    if model == TOBLER:
        best, steepness, best_slope = values[0], values[1], values[2]
        for at in range(len(rises)):
            off = steepness * abs(rises[at] / length - best_slope)
            costs[at] = length * best * _exponential(min(off, LARGEST_EXPONENT))
    elif model == LINEAR:
        level, up, down, steep_down, steep_slope = values
        for at in range(len(rises)):
            rise = rises[at]
            by_height = up if rise >= 0.0 else (-steep_down if rise < steep_slope * length else -down)
            costs[at] = length * level + by_height * rise
    elif model == TIME:
        _price_by_time(values, length, rises, costs)
    else:
        weight, resistance, efficiency, recovery, idle = values
        for at in range(len(rises)):
            rise = rises[at]
            work = weight * (resistance * length + rise)
            costs[at] = max(work / efficiency, recovery * work) + idle * math.sqrt(length * length + rise * rise)


@kernel
def price_steps(heights, weights, rule, priced, lengths, area, steps):
    """Compute the steps that leave the cells of a rectangle.

    Parameters
    ----------
    heights : (H, W) float32
        Metres; not finite where unknown.
    weights : (nodes,) float32
        Of the grid; inf where it is impassable.
    rule : (by_weights, corner_cutting)
        Whether impassable cells may not be entered, and whether a diagonal step may pass beside one.
    priced : (model, values, height_price, least_per_m)
        As for `price_ways`; what a metre of height is worth, and the cheapest metre.
    lengths : (8,) float64
        Of a step in each direction, metres.
    area : (row0, row1, col0, col1)
    steps : (H + 2, W + 2, 8) float32
        Written inside the rectangle.

    Returns
    -------
    float
        The dearest step.
    """
    by_weights, corner_cutting = rule
    model, values, height_price, least_per_m = priced
    (rows, cols), (row0, row1, col0, col1) = heights.shape, area
    stride, greatest, inf = cols + 2, np.float32(0.0), np.float32(np.inf)
    rises, costs = np.empty(col1 - col0), np.empty(col1 - col0)
    for row in range(row0, row1):
        for k in range(8):
            up, left, length = ROW_STEP[k], COL_STEP[k], lengths[k]
            first, last, there = max(col0, -left), min(col1, cols - left), row + up
            if not 0 <= there < rows:
                last = first = col0
            for col in range(first, last):
                rises[col - first] = np.float64(heights[there, col + left]) - np.float64(heights[row, col])
            count, least = last - first, least_per_m * length
            price_ways(model, values, length, rises[:count], costs[:count])
            corners = by_weights and not corner_cutting and k >= 4
            steps[row + 1, col0 + 1, k] = steps[row + 1, col1, k] = inf  # where they lead off the map
            node = (row + 1) * stride + first + 1
            for at in range(count):
                rise, free = rises[at], True
                if by_weights:
                    free = max(weights[node + at], weights[node + at + up * stride + left]) < inf
                if corners:
                    free &= max(weights[node + at + up * stride], weights[node + at + left]) < inf
                free &= abs(rise) < inf
                cost = np.float32(max(costs[at] - height_price * rise, least))
                greatest = cost if free and cost > greatest else greatest
                steps[row + 1, first + at + 1, k] = cost if free else inf
            if count <= 0:
                for col in range(col0, col1):
                    steps[row + 1, col + 1, k] = inf
    return greatest


@kernel
def pool_steps(finer, pieces, obstacle, area, means):
    """Average the steps of a finer level, or of the map, over the cells of a rectangle of a coarse one.

    Parameters
    ----------
    finer : (H + 2, W + 2, 8) float32
        Steps of the map, or means of the finer level. Those that lead off the map do not count.
    pieces : (nodes,) uint16
        The cells below each cell that it stands for, as bits; what is in none of them counts as an obstacle.
    obstacle : (8,) float32
        What an impassable cell counts for, by direction.
    area : (row0, row1, col0, col1)
    means : (h + 2, w + 2, 8) float32
        Written inside the rectangle.
    """
    rows, cols = finer.shape[0] - 2, finer.shape[1] - 2
    row0, row1, col0, col1 = area
    stride = means.shape[1]
    for row in range(row0, row1):
        for col in range(col0, col1):
            own = np.int64(pieces[(row + 1) * stride + col + 1])
            for k in range(8):
                if own == 0:
                    means[row + 1, col + 1, k] = np.inf
                    continue
                total, count = np.float32(0.0), 0
                for bit in range(FACTOR * FACTOR):
                    r, c = row * FACTOR + bit // FACTOR, col * FACTOR + bit % FACTOR
                    i, j = r + ROW_STEP[k], c + COL_STEP[k]
                    if r >= rows or c >= cols or not (0 <= i < rows and 0 <= j < cols):
                        continue
                    step = finer[r + 1, c + 1, k]
                    total += step if (own >> bit) & 1 and step < np.inf else obstacle[k]
                    count += 1
                means[row + 1, col + 1, k] = total / np.float32(count) if count else obstacle[k]


@kernel
def join_steps(means, area, edges, backwards):
    """Steps of a rectangle of coarse cells: half by the cell that is left, half by the one that is come to.

    Parameters
    ----------
    means : (h + 2, w + 2, 8) float32
        As `pool_steps` writes them.
    area : (row0, row1, col0, col1)
    edges, backwards : (h + 2, w + 2, 8) float32
        Written: of the step that leaves a cell in each direction, and of that by which it is come to from there.
    """
    row0, row1, col0, col1 = area
    half = np.float32(0.5)
    for row in range(row0 + 1, row1 + 1):
        for col in range(col0 + 1, col1 + 1):
            for k in range(8):
                i, j, back = row + ROW_STEP[k], col + COL_STEP[k], OPPOSITE[k]
                edges[row, col, k] = half * (means[row, col, k] + means[i, j, k])
                backwards[row, col, k] = half * (means[row, col, back] + means[i, j, back])
