"""Paths freed from the grid: stations moved across the path, all together, to where the line
integral is least.

See `planners.refine`, and `kernels.any_angle` for what lines cost.

A *station* is a way point that may be moved across the path, to one of its *places*. A leg from one
station's place to the next one's is priced by the weights on the two halves of the way, between the
places that it passes there. Few legs lie near anything impassable: only these are checked as they
are chosen, the line as a whole at the end of each stage.
"""

import math

import numpy as np
from numpy import inf, int64, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.any_angle import (
    corners,
    cost_along,
    ground_of,
    is_clear,
    is_passable,
    leg_between,
    mean_of_four,
    open_between,
    run_of,
    sampled_along,
    shortened,
    way_of,
    weight_at,
)
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import COL, ROW
from nnpp_edge.runtime.kernels.records import GridRecord, Leg, Places, Room, Stage

BLOCKED = 1e200
"""Weight of impassable places where sums of weights may have factors of 0: more than any sum of
others.
"""
SLOPE = 3
"""Places by which the next station may lie further aside."""
_FIRST_HALF = 0
_SECOND_HALF = 1
_NEAR = 2
"""Rows of a station's sums: weights along both halves of the way to each place, and how many of
their samples come near something impassable.
"""


@kernel
def freed(grid: GridRecord, room: Room, path, stages, tolerance, until):
    """Way points near a path of cells that cost less, by the line integral, than the path itself as
    a rule.

    Parameters
    ----------
    grid, room
        `GridRecord` and `Room`.
    path : (N, 2) int32
        Cells, each a neighbour of the one before it.
    stages : tuple of tuples
        How stations are moved, one `Stage` after another.
    tolerance : float
        Cells of mean ground, whose cost a way point must save.
    until : float
        From then on stations stay where they are.

    Returns
    -------
    tuple
        (M, 2) float64 way points, and their line integral: those at which the path turns where no
        line costs less.
    """
    ground = ground_of(grid, room)
    on_grid = corners(path)
    cost_on_grid = cost_along(ground, on_grid)
    points = on_grid
    cost = cost_on_grid
    for row in stages:
        if late(until):
            break
        stage = Stage(*row)
        stations = _evenly(points, stage)
        moved = _moved(ground, grid.tiles, stations, stage, until)
        cost_moved = sampled_along(ground, moved)
        if cost_moved < cost:
            points = moved
            cost = cost_moved
        elif moved is stations:
            # obstacles all around: a straighter line may leave more room
            points = shortened(ground, grid.tiles, points, 0.0)
    mean = cost / run_of(points)[-1]
    points = shortened(ground, grid.tiles, points, tolerance * mean)
    cost = cost_along(ground, points)
    if cost < cost_on_grid:
        return points, cost
    return on_grid, cost_on_grid


@helper
def _moved(ground, tiles, stations, stage, until):
    """Stations moved across the path to places, the cheapest choice.

    Legs are clear where a sample comes near something impassable. The stations themselves where
    there is no such choice, or none by `until`.
    """
    n = len(stations)
    count = 2 * stage.half + 1
    places = Places(np.empty((n, count)), np.empty((n, count)))
    sums = np.empty((3, count))
    costs = np.full((n, count), inf)
    legs = np.empty((2 * SLOPE + 1, count))
    before = np.zeros((n, count), np.int64)
    _put_places(ground, stations, stage, places)
    costs[0] = 0.0
    for k in range(1, n):
        if late(until):
            return stations
        _sum_between(ground, tiles, places, k, stage.samples, sums)
        _leg_costs(ground, places, k, sums, stage.samples, costs, legs)
        _choose(ground, places, k, legs, sums[_NEAR], costs, before)
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
def _evenly(points, stage):
    """Stations along way points, each the mean of three where the stage smooths, but for the
    ends.
    """
    run = run_of(points)
    count = max(int64(run[-1] / stage.spacing + 0.5), 1) + 1
    even = np.empty((count, 2))
    places = np.linspace(0.0, run[-1], count)
    for side in (ROW, COL):
        even[:, side] = np.interp(places, run, points[:, side])
    if stage.smooths:
        sums = even[:-2] + even[1:-1] + even[2:]
        even[1:-1] = sums / 3.0
    return even


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
    before = across[k - 1]
    here = across[k]
    ends = (before[0], before[-1], here[0], here[-1])
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
    SLOPE before it.
    """
    rows = places.rows
    cols = places.cols
    count = rows.shape[1]
    factor = 0.5 * ground.per_weight / samples
    one = uint64(k - 1)
    two = uint64(k)
    first_half = sums[_FIRST_HALF]
    second_half = sums[_SECOND_HALF]
    for d in range(2 * SLOPE + 1):
        aside = d - SLOPE
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
def _choose(ground, places, k, legs, near, costs, before):
    """Write the cheapest way to each of a station's places, its last leg clear where it is `near`
    anything.
    """
    rows = places.rows
    cols = places.cols
    count = legs.shape[1]
    for j in range(count):
        while True:
            best = 0
            least = inf
            for d in range(2 * SLOPE + 1):
                cost = legs[uint64(d), uint64(j)]
                best = d if cost < least else best
                least = min(cost, least)
            i = j - best + SLOPE
            if not least < BLOCKED:
                costs[k, j] = inf
                break
            row = rows[k - 1, i]
            col = cols[k - 1, i]
            leg = Leg(row, col, rows[k, j], cols[k, j])
            is_near = near[min(i, j) : max(i, j) + 1].any()
            if not is_near or is_clear(ground, leg):
                costs[k, j] = least
                before[k, j] = i
                break
            legs[best, j] = inf
