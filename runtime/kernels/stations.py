"""Paths freed from the grid: stations moved across the path, all together, to where the line
integral is least.

See `planners.refine`, and `kernels.any_angle` for what lines cost.

A *station* is a way point that may be moved across the path, to one of its *places*. A leg from one
station's place to the next one's is priced by the weights on the two halves of the way, between the
places that it passes there. Few legs lie near anything impassable: only these are checked as they
are chosen, the line as a whole in the end. Where it turns out not to be clear, all of it is done
again with every leg checked.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.any_angle import (
    ground_of,
    is_clear,
    is_passable,
    line_cost,
    mean_of_four,
    open_between,
    shortened,
    weight_at,
)
from nnpp_edge.runtime.kernels.clock import late

BLOCKED = 1e200
"""Weight of impassable places where sums of weights may have factors of 0: more than any sum of
others.
"""
LAST_STEP = 0.1
"""Cells by which the way points that are left may move in the end."""
SPACING = 0
STEP = 1
HALF = 2
SLOPE = 3
SAMPLES = 4
KEEPS = 5
"""Of a stage: cells between stations; cells between a station's places, and their number to each
side; by how many of them neighbours may differ; samples per cell; whether the way points are
among the stations."""


@kernel
def freed(grid, room, path, stages, tolerance, until):
    """Way points near a path of cells that cost less, by the line integral, than the path itself as
    a rule.

    Parameters
    ----------
    path : (N, 2) int32
        Cells, each a neighbour of the one before it.
    stages : (S, 6) float64
        How stations are moved, one stage after another; see `SPACING` and the others.
    tolerance : float
        Cells of mean ground, whose cost a way point must save.
    until : float
        From then on stations stay where they are.

    Returns
    ------- (M, 2) float64 way points, and their line integral; inf where no line was found all of
    whose legs are clear.
    """
    points = _freed(grid, room, path, stages, tolerance, False, until)
    cost = line_cost(grid, room, points)
    if cost == np.inf:
        points = _freed(grid, room, path, stages, tolerance, True, until)
        cost = line_cost(grid, room, points)
    return points, cost


@helper
def _freed(grid, room, path, stages, tolerance, wary, until):
    """As `freed`; every leg is checked as it is chosen where `wary`, else those near something
    impassable.
    """
    points = path.astype(np.float64)
    on_path = True
    for s in range(len(stages)):
        spacing = stages[s, SPACING]
        keeps = stages[s, KEEPS] > 0.0
        if keeps and on_path:
            points = shortened(grid, room, points, 8, 32, 0.0)
            on_path = False
        stations = _with_stations(points, spacing) if keeps else _evenly(points, spacing)
        step = stages[s, STEP]
        half = np.int64(stages[s, HALF])
        slope = np.int64(stages[s, SLOPE])
        found = moved(grid, room, stations, step, half, slope, stages[s, SAMPLES], wary, until)
        if keeps or found is not stations:
            points = found
            on_path = False
    mean = line_cost(grid, room, points) / max(_length(points), 1e-12)
    before = 2 * len(points)
    while len(points) < 0.8 * before:
        before = len(points)
        points = shortened(grid, room, points, 1, 2, tolerance * mean)
    return moved(grid, room, points, LAST_STEP, 1, 1, 1.5, wary, until)


@helper
def moved(grid, room, stations, step, half, slope, per_cell, wary, until):
    """Stations moved across the path by multiples of `step`, `half` to each side at most: the
    cheapest choice.

    Neighbours are moved by amounts that differ by `slope` multiples at most. Legs are priced by
    about `per_cell` samples a cell. They are clear where a sample comes near something impassable,
    and all of them where `wary`. The stations themselves where there is no such choice, or none by
    `until`.
    """
    n = len(stations)
    count = 2 * half + 1
    ground = ground_of(grid, room)
    rows = np.empty((n, count))
    cols = np.empty((n, count))
    sums = np.empty((3, count))
    costs = np.full((n, count), np.inf)
    legs = np.empty((2 * slope + 1, count))
    before = np.zeros((n, count), np.int64)
    _places(grid, stations, step, half, rows, cols)
    costs[0] = 0.0
    for k in range(1, n):
        if late(until):
            return stations
        down = stations[k, 0] - stations[k - 1, 0]
        right = stations[k, 1] - stations[k - 1, 1]
        samples = max(np.int64(0.5 * per_cell * math.sqrt(down * down + right * right) + 0.5), 1)
        _sum_between(grid, ground, rows, cols, k, samples, sums)
        _leg_costs(ground, rows, cols, k, sums, samples, costs, legs)
        _choose(ground, rows, cols, k, legs, wary, sums[2], costs, before)
    j = costs[n - 1].argmin()
    if not costs[n - 1, j] < np.inf:
        return stations
    out = np.empty((n, 2))
    for k in range(n - 1, -1, -1):
        out[k, 0] = rows[k, j]
        out[k, 1] = cols[k, j]
        j = before[k, j]
    return out


@helper
def _with_stations(points, spacing):
    """Way points with others put between them, at most about `spacing` cells apart."""
    lengths = np.empty(len(points), np.int64)
    count = 1
    for k in range(len(points) - 1):
        rows = points[k + 1, 0] - points[k, 0]
        cols = points[k + 1, 1] - points[k, 1]
        lengths[k] = max(np.int64(math.sqrt(rows * rows + cols * cols) / spacing + 0.5), 1)
        count += lengths[k]
    out = np.empty((count, 2))
    m = 0
    for k in range(len(points) - 1):
        for part in range(lengths[k]):
            share = part / lengths[k]
            for side in range(2):
                out[m, side] = points[k, side] + share * (points[k + 1, side] - points[k, side])
            m += 1
    out[m] = points[len(points) - 1]
    return out


@helper
def _evenly(points, spacing):
    """Stations about `spacing` cells apart along way points, each the mean of three, but for the
    ends.
    """
    n = len(points)
    run = np.zeros(n)
    for k in range(1, n):
        rows = points[k, 0] - points[k - 1, 0]
        cols = points[k, 1] - points[k - 1, 1]
        run[k] = run[k - 1] + math.sqrt(rows * rows + cols * cols)
    count = max(np.int64(run[n - 1] / spacing + 0.5), 1) + 1
    even = np.empty((count, 2))
    k = 0
    for m in range(count):
        at = run[n - 1] * m / (count - 1)
        while k < n - 2 and run[k + 1] < at:
            k += 1
        share = (at - run[k]) / max(run[k + 1] - run[k], 1e-12)
        for side in range(2):
            even[m, side] = points[k, side] + min(share, 1.0) * (
                points[k + 1, side] - points[k, side]
            )
    # free of rounding
    even[0] = points[0]
    even[count - 1] = points[n - 1]
    out = even.copy()
    for m in range(1, count - 1):
        for side in range(2):
            out[m, side] = (even[m - 1, side] + even[m, side] + even[m + 1, side]) / 3.0
    return out


@helper
def _places(grid, stations, step, half, rows, cols):
    """Write the places of each station across the path, those outside the map moved onto its rim.
    Ends stay.
    """
    stride = grid[1]
    n = len(stations)
    last_row = float(len(grid[0]) // stride - 3)
    last_col = float(stride - 3)
    for k in range(n):
        a = max(k - 1, 0)
        b = min(k + 1, n - 1)
        down = stations[b, 0] - stations[a, 0]
        right = stations[b, 1] - stations[a, 1]
        per_length = (
            step / max(math.sqrt(down * down + right * right), 1e-12) if 0 < k < n - 1 else 0.0
        )
        for j in range(2 * half + 1):
            aside = (j - half) * per_length
            rows[k, j] = min(max(stations[k, 0] - aside * right, 0.0), last_row)
            cols[k, j] = min(max(stations[k, 1] + aside * down, 0.0), last_col)


@helper
def _sum_between(grid, ground, rows, cols, k, samples, sums):
    """Write sums of weights along both halves of the way from each place of a station to the next
    one's.

    `samples` are taken of each half; what is impassable weighs `BLOCKED`. `sums[2]` says how many
    of them come near something impassable.
    """
    last = rows.shape[1] - 1
    low = min(rows[k - 1, 0], rows[k - 1, last], rows[k, 0], rows[k, last])
    high = max(rows[k - 1, 0], rows[k - 1, last], rows[k, 0], rows[k, last])
    left = min(cols[k - 1, 0], cols[k - 1, last], cols[k, 0], cols[k, last])
    right = max(cols[k - 1, 0], cols[k - 1, last], cols[k, 0], cols[k, last])
    open_between(grid, (low, left), (high, right))
    share = 0.5 / samples
    sums[2] = 0.0
    for j in range(last + 1):
        row = rows[k - 1, j]
        col = cols[k - 1, j]
        per_row = share * (rows[k, j] - row)
        per_col = share * (cols[k, j] - col)
        row = row + 0.5 * per_row
        col = col + 0.5 * per_col
        for part in range(2):
            total = 0.0
            for _ in range(samples):
                weight = mean_of_four(ground[0], ground[1], row, col)
                if not weight < np.inf:
                    sums[2, j] += 1.0
                    passable = is_passable(ground, np.int64(row + 0.5), np.int64(col + 0.5))
                    weight = weight_at(ground, row, col) if passable else BLOCKED
                total += weight
                row = row + per_row
                col = col + per_col
            sums[part, j] = total


@helper
def _leg_costs(ground, rows, cols, k, sums, samples, costs, legs):
    """Costs of the ways to a station's places: `legs[d, j]` by the leg to place j from that d -
    slope before it.
    """
    count = rows.shape[1]
    slope = legs.shape[0] // 2
    base = ground[2]
    factor = 0.5 * ground[3] / samples
    one = np.uint64(k - 1)
    two = np.uint64(k)
    first_half = np.uint64(0)
    second_half = np.uint64(1)
    for d in range(2 * slope + 1):
        aside = d - slope
        line = np.uint64(d)
        first = max(aside, 0)
        last = min(count + aside, count)
        legs[d, :first] = np.inf
        legs[d, last:] = np.inf
        low = np.int64(math.floor(0.25 * aside))
        high = np.int64(math.floor(0.75 * aside))
        early = 0.25 * aside - low
        late = 0.75 * aside - high
        more = np.uint64(aside != 0)
        for j in range(first, last):
            i = np.uint64(j - aside)
            to = np.uint64(j)
            down = rows[two, to] - rows[one, i]
            right = cols[two, to] - cols[one, i]
            n = np.uint64(j - aside + low)
            m = np.uint64(j - aside + high)
            total = (1.0 - early) * sums[first_half, n] + early * sums[first_half, n + more]
            total += (1.0 - late) * sums[second_half, m] + late * sums[second_half, m + more]
            legs[line, to] = (
                math.sqrt(down * down + right * right) * (base + factor * total) + costs[one, i]
            )


@helper
def _choose(ground, rows, cols, k, legs, wary, near, costs, before):
    """Write the cheapest way to each of a station's places, its last leg clear where `wary`, or
    `near` anything.
    """
    count = legs.shape[1]
    slope = legs.shape[0] // 2
    for j in range(count):
        while True:
            best = 0
            least = np.inf
            for d in range(2 * slope + 1):
                cost = legs[np.uint64(d), np.uint64(j)]
                best, least = (d, cost) if cost < least else (best, least)
            i = j - best + slope
            if not least < BLOCKED:
                costs[k, j] = np.inf
                break
            checked = wary
            for passed in range(min(i, j), max(i, j) + 1):
                checked = checked or near[passed] > 0.0
            if not checked or is_clear(
                ground, rows[k - 1, i], cols[k - 1, i], rows[k, j], cols[k, j]
            ):
                costs[k, j] = least
                before[k, j] = i
                break
            legs[best, j] = np.inf


@helper
def _length(points):
    total = 0.0
    for k in range(len(points) - 1):
        rows = points[k + 1, 0] - points[k, 0]
        cols = points[k + 1, 1] - points[k, 1]
        total += math.sqrt(rows * rows + cols * cols)
    return total
