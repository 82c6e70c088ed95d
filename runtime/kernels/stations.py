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
from numpy import float64, inf, int64, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.any_angle import (
    cost_along,
    ground_of,
    is_clear,
    is_passable,
    leg_between,
    mean_of_four,
    open_between,
    shortened,
    way_of,
    weight_at,
)
from nnpp_edge.runtime.kernels.by_address import borrowed
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import COL, ROW
from nnpp_edge.runtime.kernels.records import Grid, Leg, Places, Stage, Tiles

BLOCKED = 1e200
"""Weight of impassable places where sums of weights may have factors of 0: more than any sum of
others.
"""
LAST_STEP = 0.1
"""Cells by which the way points that are left may move in the end."""
_STAGE_SPACING = 0
_STAGE_STEP = 1
_STAGE_HALF = 2
_STAGE_SLOPE = 3
_STAGE_SAMPLES = 4
_STAGE_KEEPS = 5
"""Columns of stages, see `Stage`."""
_FIRST_HALF = 0
_SECOND_HALF = 1
_NEAR = 2
"""Rows of a station's sums: weights along both halves of the way to each place, and how many of
their samples come near something impassable.
"""


@kernel
def freed(grid, room, path, stages, tolerance, until):
    """Way points near a path of cells that cost less, by the line integral, than the path itself as
    a rule.

    Parameters
    ----------
    grid, room
        `Grid` and `Room`.
    path : (N, 2) int32
        Cells, each a neighbour of the one before it.
    stages : (S, 6) float64
        How stations are moved, one `Stage` after another.
    tolerance : float
        Cells of mean ground, whose cost a way point must save.
    until : float
        From then on stations stay where they are.

    Returns
    -------
    tuple
        (M, 2) float64 way points, and their line integral; inf where no line was found all of whose
        legs are clear.
    """
    ground = ground_of(grid, room)
    tiles = borrowed(Tiles(*Grid(*grid).tiles))
    points = _freed(ground, tiles, path, stages, tolerance, False, until)
    cost = cost_along(ground, points)
    if cost == inf:
        points = _freed(ground, tiles, path, stages, tolerance, True, until)
        cost = cost_along(ground, points)
    return points, cost


@inlined
def _stage(stages, s):
    """A row of the stages."""
    return Stage(
        stages[s, _STAGE_SPACING],
        stages[s, _STAGE_STEP],
        int64(stages[s, _STAGE_HALF]),
        int64(stages[s, _STAGE_SLOPE]),
        stages[s, _STAGE_SAMPLES],
        stages[s, _STAGE_KEEPS] > 0.0,
    )


@helper
def _freed(ground, tiles, path, stages, tolerance, wary, until):
    """As `freed`; every leg is checked as it is chosen where `wary`, else those near something
    impassable.
    """
    points = path.astype(float64)
    on_path = True
    for s in range(len(stages)):
        stage = _stage(stages, s)
        if stage.keeps and on_path:
            points = shortened(ground, tiles, points, 8, 32, 0.0)
            on_path = False
        if stage.keeps:
            stations = _with_stations(points, stage.spacing)
        else:
            stations = _evenly(points, stage.spacing)
        found = _moved(ground, tiles, stations, stage, wary, until)
        if stage.keeps or found is not stations:
            points = found
            on_path = False
    mean = cost_along(ground, points) / max(_length(points), 1e-12)
    before = 2 * len(points)
    while len(points) < 0.8 * before:
        before = len(points)
        points = shortened(ground, tiles, points, 1, 2, tolerance * mean)
    last = Stage(0.0, LAST_STEP, int64(1), int64(1), 1.5, True)
    return _moved(ground, tiles, points, last, wary, until)


@helper
def _moved(ground, tiles, stations, stage, wary, until):
    """Stations moved across the path to places, the cheapest choice.

    Legs are clear where a sample comes near something impassable, and all of them where `wary`. The
    stations themselves where there is no such choice, or none by `until`.
    """
    n = len(stations)
    count = 2 * stage.half + 1
    places = Places(np.empty((n, count)), np.empty((n, count)))
    sums = np.empty((3, count))
    costs = np.full((n, count), inf)
    legs = np.empty((2 * stage.slope + 1, count))
    before = np.zeros((n, count), np.int64)
    _put_places(ground, stations, stage, places)
    costs[0] = 0.0
    for k in range(1, n):
        if late(until):
            return stations
        _, _, length = way_of(leg_between(stations, k - 1, k))
        samples = max(int64(0.5 * stage.samples * length + 0.5), 1)
        _sum_between(ground, tiles, places, k, samples, sums)
        _leg_costs(ground, places, k, sums, samples, costs, legs)
        _choose(ground, places, k, legs, wary, sums[_NEAR], costs, before)
    j = costs[n - 1].argmin()
    if not costs[n - 1, j] < inf:
        return stations
    out = np.empty((n, 2))
    for k in range(n - 1, -1, -1):
        out[k, ROW] = places.rows[k, j]
        out[k, COL] = places.cols[k, j]
        j = before[k, j]
    return out


@helper
def _with_stations(points, spacing):
    """Way points with others put between them, at most about `spacing` cells apart."""
    parts = np.empty(len(points), np.int64)
    count = 1
    for k in range(len(points) - 1):
        _, _, length = way_of(leg_between(points, k, k + 1))
        parts[k] = max(int64(length / spacing + 0.5), 1)
        count += parts[k]
    out = np.empty((count, 2))
    m = 0
    for k in range(len(points) - 1):
        for part in range(parts[k]):
            _put_between(points, k, part / parts[k], out, m)
            m += 1
    out[m] = points[len(points) - 1]
    return out


@inlined
def _put_between(points, k, share, out, m):
    """Write the place at a share of the leg from way point k to the next into `out`."""
    for side in (ROW, COL):
        way = points[k + 1, side] - points[k, side]
        out[m, side] = points[k, side] + share * way


@helper
def _evenly(points, spacing):
    """Stations about `spacing` cells apart along way points, each the mean of three, but for the
    ends.
    """
    n = len(points)
    run = np.zeros(n)
    for k in range(1, n):
        _, _, length = way_of(leg_between(points, k - 1, k))
        run[k] = run[k - 1] + length
    count = max(int64(run[n - 1] / spacing + 0.5), 1) + 1
    even = np.empty((count, 2))
    k = 0
    for m in range(count):
        at = run[n - 1] * m / (count - 1)
        while k < n - 2 and run[k + 1] < at:
            k += 1
        share = (at - run[k]) / max(run[k + 1] - run[k], 1e-12)
        _put_between(points, k, min(share, 1.0), even, m)
    # free of rounding
    even[0] = points[0]
    even[count - 1] = points[n - 1]
    out = even.copy()
    for m in range(1, count - 1):
        for side in (ROW, COL):
            two = even[m - 1, side] + even[m, side]
            out[m, side] = (two + even[m + 1, side]) / 3.0
    return out


@helper
def _put_places(ground, stations, stage, places):
    """Write the places of each station across the path, those outside the map moved onto its rim.
    Ends stay.
    """
    n = len(stations)
    last_row = float(len(ground.weights) // ground.stride - 3)
    last_col = float(ground.stride - 3)
    for k in range(n):
        around = leg_between(stations, max(k - 1, 0), min(k + 1, n - 1))
        down, right, length = way_of(around)
        per_length = stage.step / max(length, 1e-12) if 0 < k < n - 1 else 0.0
        for j in range(2 * stage.half + 1):
            aside = (j - stage.half) * per_length
            row = stations[k, ROW] - aside * right
            col = stations[k, COL] + aside * down
            places.rows[k, j] = min(max(row, 0.0), last_row)
            places.cols[k, j] = min(max(col, 0.0), last_col)


@inlined
def _extent(across, k):
    """Least and greatest coordinate of the outermost places of a station and the one before it."""
    last = across.shape[1] - 1
    before = across[k - 1]
    here = across[k]
    ends = (before[0], before[last], here[0], here[last])
    return min(*ends), max(*ends)


@helper
def _sum_between(ground, tiles, places, k, samples, sums):
    """Write sums of weights along both halves of the way from each place of a station to the next
    one's.

    `samples` are taken of each half; what is impassable weighs `BLOCKED`.
    """
    rows = places.rows
    cols = places.cols
    top, bottom = _extent(rows, k)
    left, right = _extent(cols, k)
    open_between(tiles, Leg(top, left, bottom, right))
    share = 0.5 / samples
    sums[_NEAR] = 0.0
    for j in range(rows.shape[1]):
        row = rows[k - 1, j]
        col = cols[k - 1, j]
        per_row = share * (rows[k, j] - row)
        per_col = share * (cols[k, j] - col)
        row = row + 0.5 * per_row
        col = col + 0.5 * per_col
        for part in (_FIRST_HALF, _SECOND_HALF):
            total = 0.0
            for _ in range(samples):
                weight = mean_of_four(ground, row, col)
                if not weight < inf:
                    sums[_NEAR, j] += 1.0
                    passable = is_passable(ground, int64(row + 0.5), int64(col + 0.5))
                    weight = weight_at(ground, row, col) if passable else BLOCKED
                total += weight
                row = row + per_row
                col = col + per_col
            sums[part, j] = total


@helper
def _leg_costs(ground, places, k, sums, samples, costs, legs):
    """Costs of the ways to a station's places: `legs[d, j]` by the leg to place j from that d -
    slope before it.
    """
    rows = places.rows
    cols = places.cols
    count = rows.shape[1]
    slope = legs.shape[0] // 2
    factor = 0.5 * ground.per_weight / samples
    one = uint64(k - 1)
    two = uint64(k)
    first_half = sums[_FIRST_HALF]
    second_half = sums[_SECOND_HALF]
    for d in range(2 * slope + 1):
        aside = d - slope
        first = max(aside, 0)
        last = min(count + aside, count)
        legs[d, :first] = inf
        legs[d, last:] = inf
        # the leg passes a quarter, and three quarters, of the way aside in the middle of each half
        low = int64(math.floor(0.25 * aside))
        high = int64(math.floor(0.75 * aside))
        first_share = 0.25 * aside - low
        second_share = 0.75 * aside - high
        more = uint64(aside != 0)
        for j in range(first, last):
            i = uint64(j - aside)
            to = uint64(j)
            down = rows[two, to] - rows[one, i]
            right = cols[two, to] - cols[one, i]
            length = math.sqrt(down * down + right * right)
            n = uint64(j - aside + low)
            m = uint64(j - aside + high)
            total = (1.0 - first_share) * first_half[n] + first_share * first_half[n + more]
            total += (1.0 - second_share) * second_half[m] + second_share * second_half[m + more]
            cost = length * (ground.per_cell + factor * total)
            legs[uint64(d), to] = cost + costs[one, i]


@helper
def _choose(ground, places, k, legs, wary, near, costs, before):
    """Write the cheapest way to each of a station's places, its last leg clear where `wary`, or
    `near` anything.
    """
    rows = places.rows
    cols = places.cols
    count = legs.shape[1]
    slope = legs.shape[0] // 2
    for j in range(count):
        while True:
            best = 0
            least = inf
            for d in range(2 * slope + 1):
                cost = legs[uint64(d), uint64(j)]
                best = d if cost < least else best
                least = min(cost, least)
            i = j - best + slope
            if not least < BLOCKED:
                costs[k, j] = inf
                break
            checked = wary
            for passed in range(min(i, j), max(i, j) + 1):
                checked = checked or near[passed] > 0.0
            before_row = rows[k - 1, i]
            before_col = cols[k - 1, i]
            leg = Leg(before_row, before_col, rows[k, j], cols[k, j])
            if not checked or is_clear(ground, leg):
                costs[k, j] = least
                before[k, j] = i
                break
            legs[best, j] = inf


@helper
def _length(points):
    """Length of way points, in cells."""
    total = 0.0
    for k in range(len(points) - 1):
        _, _, length = way_of(leg_between(points, k, k + 1))
        total += length
    return total
