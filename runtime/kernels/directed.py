"""The kernels of steps that cost by the slope: what each step of a map costs, and their means on
coarse levels.

Steps of a map (H, W) stand as (H + 2, W + 2, 8) float32, by cell, with a border, and direction; inf
where there is none.
"""

import numpy as np
from numpy import float32, float64, inf, int32, int64, uint32

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.nodes import COL_STEP, OPPOSITE, ROW_STEP
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.records import Area, FinerSteps, SlopePrices, Ways

STEEPEST = 3.0
PER_SLOPE = 1024
"""Slopes, rise a metre, up to which a table has knots, and how many to a slope of 1. See
`robots.slope.cost`.
"""
_INF_BITS = float32(inf).view(int32)


@helper
def _price_rises(prices, length, rises, segments, costs):
    """Costs of steps of one length with these rises, into `costs`."""
    last = float64(len(prices.level) - len(prices.kinks) - 1)
    over = PER_SLOPE / length
    for n in range(len(rises)):
        knot = rises[n] * over + STEEPEST * PER_SLOPE
        knot = knot if knot > 0.0 else 0.0  # also of what is not a number
        segments[n] = int32(knot if knot < last else last)
    for k in range(len(prices.kinks)):
        kink = prices.kinks[k] * length
        for n in range(len(rises)):
            segments[n] += int32(rises[n] >= kink)
    for n in range(len(rises)):
        segment = uint32(segments[n])
        costs[n] = prices.level[segment] * length + prices.gradient[segment] * rises[n]


@helper
def _on_ground(price, rises, here, there, costs):
    """Costs of steps by the ground at both ends; what their rise is worth stays the same."""
    for n in range(len(rises)):
        worth = price * rises[n]
        costs[n] = 0.5 * (here[n] + there[n]) * (costs[n] + worth) - worth


@helper
def _put_steps(row, first, k, weights, stride, ways, rises, costs, least, out):
    """Write the steps in direction k from cells of a row, from column `first` on, that may be
    made, none of which costs less than `least`.
    """
    down = ways.leads[k, 0] * stride
    right = ways.leads[k, 1]
    corners = ways.by_weights and not ways.corner_cutting and k >= 4
    node = (row + 1) * stride + first + 1
    for n in range(len(rises)):
        free = abs(rises[n]) < inf
        if ways.by_weights:
            free &= max(weights[node + n], weights[node + n + down + right]) < inf
        if corners:
            free &= max(weights[node + n + down], weights[node + n + right]) < inf
        cost = float32(max(costs[n], least))
        out[n] = cost if free else float32(inf)


@kernel
def price_steps(heights, ground, weights, prices: SlopePrices, ways: Ways, area: Area, steps):
    """Compute the steps that leave the cells of a rectangle.

    Parameters
    ----------
    heights : (H, W) float32
        Metres; not finite where unknown.
    ground : (H, W) float32
        How many times as dear a metre is on each cell; (0, 0) where that does not count.
    weights : (nodes,) float32
        Of the grid; inf where it is impassable.
    prices, ways, area
        `SlopePrices`, `Ways` and `Area`.
    steps : (H + 2, W + 2, K) float32
        Written inside the rectangle.

    Returns
    -------
    float
        The dearest step.
    """
    rows, cols = heights.shape
    count = len(ways.lengths)
    wide = area.col1 - area.col0
    greatest = int32(0)
    rises = np.empty(wide)
    costs = np.empty(wide)
    segments = np.empty(wide, int32)
    line = np.empty((count, wide), float32)
    for row in range(area.row0, area.row1):
        line[:] = inf  # where they lead off the map
        for k in range(count):
            there = row + ways.leads[k, 0]
            right = ways.leads[k, 1]
            first = max(area.col0, -right)
            last = min(area.col1, cols - right)
            if not 0 <= there < rows or last <= first:
                continue
            for col in range(first, last):
                rise = float64(heights[there, col + right]) - float64(heights[row, col])
                rises[col - first] = rise
            n = last - first
            length = ways.lengths[k]
            least = prices.least_per_m * length
            _price_rises(prices, length, rises[:n], segments, costs[:n])
            if len(ground):
                here = ground[row, first:last]
                beyond = ground[there, first + right : last + right]
                _on_ground(prices.height_price, rises[:n], here, beyond, costs[:n])
            out = line[k, first - area.col0 :]
            _put_steps(row, first, k, weights, cols + 2, ways, rises[:n], costs, least, out)
        for bits in line.view(int32).reshape(-1):  # ordered as the numbers, none of them below 0
            greatest = max(greatest, bits if bits < _INF_BITS else int32(0))
        for n in range(wide):
            for k in range(count):
                steps[row + 1, area.col0 + n + 1, k] = line[k, n]
    return np.array([greatest], int32).view(float32)[0]


@helper
def _mean_step(row, col, k, piece, finer, obstacle):
    """Mean of the steps in direction k that leave the cells below a coarse cell."""
    rows = finer.steps.shape[0] - 2
    cols = finer.steps.shape[1] - 2
    way = finer.neighbours[k]
    total = float32(0.0)
    count = 0
    for bit in range(FACTOR * FACTOR):
        i = row * FACTOR + bit // FACTOR
        j = col * FACTOR + bit % FACTOR
        to_row = i + ROW_STEP[k]
        to_col = j + COL_STEP[k]
        if i >= rows or j >= cols or not (0 <= to_row < rows and 0 <= to_col < cols):
            continue  # such steps do not count
        step = finer.steps[i + 1, j + 1, way]
        total += step if (piece >> bit) & 1 and step < inf else obstacle
        count += 1
    return total / float32(count) if count else obstacle


@kernel
def pool_steps(finer: FinerSteps, pieces, obstacle, area: Area, means):
    """Average the steps of a finer level, or of the map, over the cells of a rectangle of a coarse
    one.

    Parameters
    ----------
    finer, area
        `FinerSteps` and `Area`.
    pieces : (nodes,) uint16
        The cells below each cell that it stands for, as bits; what is in none of them counts as an
        obstacle.
    obstacle : (8,) float32
        What an impassable cell counts for, by direction.
    means : (h + 2, w + 2, 8) float32
        Written inside the rectangle.
    """
    stride = means.shape[1]
    for row in range(area.row0, area.row1):
        for col in range(area.col0, area.col1):
            piece = int64(pieces[(row + 1) * stride + col + 1])
            for k in range(8):
                mean = float32(inf)
                if piece != 0:
                    mean = _mean_step(row, col, k, piece, finer, obstacle[k])
                means[row + 1, col + 1, k] = mean


@kernel
def join_steps(means, area: Area, edges, backwards):
    """Steps of a rectangle of coarse cells: half by the cell that is left, half by the one that is
    come to.

    Parameters
    ----------
    means : (h + 2, w + 2, 8) float32
        As `pool_steps` writes them.
    area
        `Area`.
    edges, backwards : (h + 2, w + 2, 8) float32
        Written: of the step that leaves a cell in each direction, and of that by which it is come
        to from there.
    """
    half = float32(0.5)
    for row in range(area.row0 + 1, area.row1 + 1):
        for col in range(area.col0 + 1, area.col1 + 1):
            for k in range(8):
                i = row + ROW_STEP[k]
                j = col + COL_STEP[k]
                back = OPPOSITE[k]
                edges[row, col, k] = half * (means[row, col, k] + means[i, j, k])
                backwards[row, col, k] = half * (means[row, col, back] + means[i, j, back])
