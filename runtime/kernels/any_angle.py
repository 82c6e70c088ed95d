"""Paths freed from the grid: way points anywhere on the map, priced by the line integral.

See `planners.refine`.

Places are (row, col) in cells, with the middle of the first cell at (0, 0), so that a cell's sides lie at halves. The
weight at a place is bilinear in those of the four cells whose middles surround it; the impassable ones among them are
left out, and the others' shares are raised to sum to 1. A cell's length costs `steps[0]` + 2 · `steps[2]` · weight:
what a straight step on even ground does.

A *leg* is the straight way between two way points, a *station* a way point that may be moved across the path.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.by_address import borrowed
from nnpp_edge.runtime.kernels.tiles import open_there

BLOCKED = 1e200
"""What impassable places weigh where sums of weights may have factors of 0: more than any sum of others."""
TOUCH = 1e-6
"""Cells: a leg that comes so near to a cell touches it."""
MOST_SAMPLES = 64
"""Samples along a leg, at most, by which stations are moved."""
LAST_STEP = 0.2
"""Cells by which the way points that are left may move in the end."""
SPACING, STEP, HALF, SLOPE, SAMPLES, KEEPS = 0, 1, 2, 3, 4, 5
"""Of a stage: cells between stations; cells between a station's places, and their number to each side; by how many of
them neighbours may differ; samples per cell; whether the way points are among the stations."""


@kernel
def ground_of(grid):
    """What the kernels below go by: (weights, stride, cost of a cell's length, what a weight adds to it, cutting)."""
    weights, stride, steps, corner_cutting, _ = grid
    return borrowed(weights), stride, steps[0], 2.0 * steps[2], corner_cutting


@kernel
def _open_between(grid, low, high):
    """See to it that the weights are there of all cells of a rectangle between two places, and of those around it."""
    tiles = grid[4]
    state, wanted, row_shift, col_shift, _, _ = tiles
    for i in range(np.int64(low[0] + 0.5) >> row_shift, (np.int64(high[0] + 0.5) >> row_shift) + 1):
        for j in range(np.int64(low[1] + 0.5) >> col_shift, (np.int64(high[1] + 0.5) >> col_shift) + 1):
            if not state[i, j] & wanted:
                open_there(tiles, i, j)


@kernel
def _all_open(ground, low, high):
    """Whether all cells of a rectangle between two places, and those around it, are passable."""
    weights, stride = ground[0], ground[1]
    left, right = np.int64(low[1] + 0.5), np.int64(high[1] + 0.5) + 3
    for row in range(np.int64(low[0] + 0.5), np.int64(high[0] + 0.5) + 3):
        worst = np.float32(0.0)
        for node in range(row * stride + left, row * stride + right):
            worst = max(worst, weights[np.uint64(node)])
        if worst == np.inf:
            return False
    return True


@kernel
def _is_passable(ground, row, col):
    """Whether a cell can be stood on; those outside the map cannot."""
    weights, stride = ground[0], ground[1]
    node = np.uint64((row + 1) * stride + col + 1)
    return weights[node] < np.inf


@kernel
def weight_at(ground, row, col):
    """Weight at a place in a passable cell."""
    weights, stride = ground[0], ground[1]
    i, j = np.int64(row + 1.0), np.int64(col + 1.0)
    down, right = row + 1.0 - i, col + 1.0 - j
    n, below = np.uint64(i * stride + j), np.uint64(i * stride + j + stride)
    one, two = np.float64(weights[n]), np.float64(weights[n + np.uint64(1)])
    three, four = np.float64(weights[below]), np.float64(weights[below + np.uint64(1)])
    mean = (1.0 - down) * ((1.0 - right) * one + right * two) + down * ((1.0 - right) * three + right * four)
    if mean < np.inf:
        return mean
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
    if not _is_passable(ground, up, left):
        return True
    if up == down and left == right:
        return False
    return not (
        _is_passable(ground, up, right) and _is_passable(ground, down, left) and _is_passable(ground, down, right)
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
        if not _is_passable(ground, i, j):
            return False
        if min(next_row, next_col) >= 1.0:
            return True
        if abs(next_row - next_col) <= near:  # a corner
            if not (diagonal and next_row == next_col) and not (
                _is_passable(ground, i + up, j) and _is_passable(ground, i, j + left)
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
                _open_between(grid, low, high)
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
def _with_stations(points, spacing):
    """Way points with others put between them, at most about `spacing` cells apart."""
    lengths = np.empty(len(points), np.int64)
    count = 1
    for k in range(len(points) - 1):
        rows, cols = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        lengths[k] = max(np.int64(math.sqrt(rows * rows + cols * cols) / spacing + 0.5), 1)
        count += lengths[k]
    out, m = np.empty((count, 2)), 0
    for k in range(len(points) - 1):
        for part in range(lengths[k]):
            share = part / lengths[k]
            for side in range(2):
                out[m, side] = points[k, side] + share * (points[k + 1, side] - points[k, side])
            m += 1
    out[m] = points[len(points) - 1]
    return out


@kernel
def _evenly(points, spacing):
    """Stations about `spacing` cells apart along way points, each the mean of three, but for the ends."""
    n = len(points)
    run = np.zeros(n)
    for k in range(1, n):
        rows, cols = points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1]
        run[k] = run[k - 1] + math.sqrt(rows * rows + cols * cols)
    count = max(np.int64(run[n - 1] / spacing + 0.5), 1) + 1
    even, k = np.empty((count, 2)), 0
    for m in range(count):
        at = run[n - 1] * m / (count - 1)
        while k < n - 2 and run[k + 1] < at:
            k += 1
        share = (at - run[k]) / max(run[k + 1] - run[k], 1e-12)
        for side in range(2):
            even[m, side] = points[k, side] + min(share, 1.0) * (points[k + 1, side] - points[k, side])
    even[0], even[count - 1] = points[0], points[n - 1]  # free of rounding
    out = even.copy()
    for m in range(1, count - 1):
        for side in range(2):
            out[m, side] = (even[m - 1, side] + even[m, side] + even[m + 1, side]) / 3.0
    return out


@kernel
def _places(grid, stations, step, half, rows, cols):
    """Write the places of each station across the path, those outside the map moved onto its rim. Ends stay."""
    stride = grid[1]
    n, last_row, last_col = len(stations), float(len(grid[0]) // stride - 3), float(stride - 3)
    for k in range(n):
        a, b = max(k - 1, 0), min(k + 1, n - 1)
        down, right = stations[b, 0] - stations[a, 0], stations[b, 1] - stations[a, 1]
        per_length = step / max(math.sqrt(down * down + right * right), 1e-12) if 0 < k < n - 1 else 0.0
        for j in range(2 * half + 1):
            aside = (j - half) * per_length
            rows[k, j] = min(max(stations[k, 0] - aside * right, 0.0), last_row)
            cols[k, j] = min(max(stations[k, 1] + aside * down, 0.0), last_col)


@kernel
def _open_around(grid, rows, cols):
    """See to it that the weights between two stations' places are there; whether all cells there are passable."""
    low, high = (rows.min(), cols.min()), (rows.max(), cols.max())
    _open_between(grid, low, high)
    return _all_open(ground_of(grid), low, high)


@kernel
def _sample_between(ground, rows, cols, samples, all_open, values):
    """Weights between two stations' places, row by row of equal shares of the way; `BLOCKED` where impassable."""
    for j in range(rows.shape[1]):
        down, right = (rows[1, j] - rows[0, j]) / samples, (cols[1, j] - cols[0, j]) / samples
        row, col = rows[0, j] + 0.5 * down, cols[0, j] + 0.5 * right
        for m in range(samples):
            passable = all_open or _is_passable(ground, np.int64(row + 0.5), np.int64(col + 0.5))
            values[m, j] = weight_at(ground, row, col) if passable else BLOCKED
            row, col = row + down, col + right


@kernel
def _leg_costs(ground, rows, cols, values, samples, slope, legs):
    """Costs of the legs between two stations' places: `legs[d, j]` ends at j and begins d - slope places before."""
    count, base, factor = rows.shape[1], ground[2], ground[3] / samples
    for d in range(2 * slope + 1):
        aside, line = d - slope, legs[d]
        first, last = max(aside, 0), min(count + aside, count)
        line[:] = 0.0
        for m in range(samples):
            shift = aside * (m + 0.5) / samples
            low = np.int64(math.floor(shift))
            share, ahead = shift - low, low - aside
            if share > 0.0:
                for j in range(first, last):
                    line[j] += (1.0 - share) * values[m, j + ahead] + share * values[m, j + ahead + 1]
            else:
                for j in range(first, last):
                    line[j] += values[m, j + ahead]
        for j in range(first, last):
            down, right = rows[1, j] - rows[0, j - aside], cols[1, j] - cols[0, j - aside]
            line[j] = math.sqrt(down * down + right * right) * (base + factor * line[j])
        line[:first], line[last:] = np.inf, np.inf


@kernel
def _choose(ground, rows, cols, legs, all_open, costs, before):
    """The cheapest clear way to each of a station's places, by the costs of the ways to those of the one before."""
    count, slope = legs.shape[1], legs.shape[0] // 2
    for d in range(2 * slope + 1):
        for j in range(max(d - slope, 0), min(count + d - slope, count)):
            legs[d, j] += costs[0, j - d + slope]
    for j in range(count):
        while True:
            best = 0
            for d in range(1, 2 * slope + 1):
                best = d if legs[d, j] < legs[best, j] else best
            if not legs[best, j] < BLOCKED:
                costs[1, j] = np.inf
                break
            i = j - best + slope
            if all_open or is_clear(ground, rows[0, i], cols[0, i], rows[1, j], cols[1, j]):
                costs[1, j], before[j] = legs[best, j], i
                break
            legs[best, j] = np.inf


@kernel
def moved(grid, stations, step, half, slope, per_cell):
    """Stations moved across the path by multiples of `step`, `half` to each side at most: the cheapest choice.

    Neighbours are moved by amounts that differ by `slope` multiples at most. Legs are priced by about `per_cell`
    samples a cell, and each that is chosen is checked cell by cell. The stations themselves where there is no choice
    whose legs are clear.
    """
    n, count, ground = len(stations), 2 * half + 1, ground_of(grid)
    rows, cols, costs = np.empty((n, count)), np.empty((n, count)), np.full((n, count), np.inf)
    before = np.zeros((n, count), np.int64)
    values, legs = np.empty((MOST_SAMPLES, count)), np.empty((2 * slope + 1, count))
    _places(grid, stations, step, half, rows, cols)
    costs[0] = 0.0
    for k in range(1, n):
        down, right = stations[k, 0] - stations[k - 1, 0], stations[k, 1] - stations[k - 1, 1]
        samples = min(max(np.int64(per_cell * math.sqrt(down * down + right * right) + 0.5), 1), MOST_SAMPLES)
        between = rows[k - 1 : k + 1], cols[k - 1 : k + 1]
        all_open = _open_around(grid, *between)
        _sample_between(ground, *between, samples, all_open, values)
        _leg_costs(ground, *between, values, samples, slope, legs)
        _choose(ground, *between, legs, all_open, costs[k - 1 : k + 1], before[k])
    j = costs[n - 1].argmin()
    if not costs[n - 1, j] < np.inf:
        return stations
    out = np.empty((n, 2))
    for k in range(n - 1, -1, -1):
        out[k, 0], out[k, 1] = rows[k, j], cols[k, j]
        j = before[k, j]
    return out


@kernel
def freed(grid, path, stages, tolerance):
    """Way points near a path of cells that cost less, by the line integral, than the path itself as a rule.

    Parameters
    ----------
    grid
        As everywhere.
    path : (N, 2) int32
        Cells, each a neighbour of the one before it.
    stages : (S, 6) float64
        How stations are moved, one stage after another; see `SPACING` and the others.
    tolerance : float
        Cells of mean ground, whose cost a way point must save.

    Returns
    -------
    (M, 2) float64
        The way points. All legs are clear.
    """
    points, on_path = path.astype(np.float64), True
    for s in range(len(stages)):
        spacing, keeps = stages[s, SPACING], stages[s, KEEPS] > 0.0
        if keeps and on_path:
            points, on_path = shortened(grid, points, 8, 32, 0.0, 1.0), False
        stations = _with_stations(points, spacing) if keeps else _evenly(points, spacing)
        step, half, slope = stages[s, STEP], np.int64(stages[s, HALF]), np.int64(stages[s, SLOPE])
        found = moved(grid, stations, step, half, slope, stages[s, SAMPLES])
        if keeps or found is not stations:
            points, on_path = found, False
    mean = line_cost(grid, points) / max(_length(points), 1e-12)
    before = 2 * len(points)
    while len(points) < 0.8 * before:
        before = len(points)
        points = shortened(grid, points, 1, 4, tolerance * mean, 1.0)
    return moved(grid, points, LAST_STEP, 1, 1, 1.5)


@kernel
def _length(points):
    total = 0.0
    for k in range(len(points) - 1):
        rows, cols = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        total += math.sqrt(rows * rows + cols * cols)
    return total
