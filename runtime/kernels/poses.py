"""The check of poses: whether a body may stand on a cell in a heading, and what that costs. See `terrain.vehicle`.

Poses are checked a run at a time, `RUN` cells of a row in one heading, where a search first asks: so the compiler
checks eight at once, and a run takes about as long as a single pose would.

The heights under each wheel lie between a least and a greatest, and the plane of the wheels' contacts, fitted by
least squares, is linear in them: its steepest gradients, and the lowest that its belly can come above each cell, are
found from the middles and half widths of these ranges, without trying any out.

The kernels are given `poses`, a tuple (codes, unit, source, address):

    codes      (4 · nodes,) uint16, heading by heading: `UNCHECKED`, `FAILS`, or 1 + T · `MOST_CODE`, rounded up
    unit       float32, weight of a step of T's code
    source     (heights, offsets, starts, terms, gradients, limits, scratch, counts, shape), see `map.poses`
    address    of `check_run`
"""

import math

import numpy as np
from numba.extending import overload

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.by_address import address_of, call_at
from nnpp_edge.runtime.kernels.traversability import arc_tangent

RUN = 32
"""Poses that are checked at once."""
UNCHECKED, FAILS, MOST_CODE = 0, 65535, 65533
HEADING = (0, 0, 2, 2, 1, 3, 3, 1)
"""Number of the heading of each of the eight steps, see `terrain.vehicle.HEADINGS`."""
PITCH, ROLL, TILT, STEP, CLEARANCE = 0, 1, 2, 3, 4
TILT_WEIGHT, RISE_WEIGHT, STEP_WEIGHT, HALF_STEPS, MARGINS = 5, 6, 7, 8, 12
LIMIT_SLOTS = 16
"""Of the limits: the greatest gradients along and across, tilt in radians, step and clearance in metres; weights of
the terms of T; and of each heading half a step's length and the belly's margin."""
_ONE, _TWO, _HALF = np.float32(1.0), np.float32(2.0), np.float32(0.5)
_ZERO, _INF = np.float32(0.0), np.float32(np.inf)


@kernel
def pose_weight(code, unit):
    """Weight of a pose by its code: inf where it fails; 0, which no pose weighs less than, where unchecked."""
    weight = np.float32(max(np.int32(code), np.int32(1)) - np.int32(1)) * unit
    return _INF if code == FAILS else weight


@kernel
def _range_of(heights, first, offsets, low, high):
    """Least and greatest height of some cells beside each of a run."""
    lanes = len(low)  # a constant would have the compiler write out all lanes, one by one
    for c in range(lanes):
        low[c], high[c] = _INF, -_INF
    for n in range(len(offsets)):
        at = first + offsets[n]
        line = heights[at : at + lanes]
        for c in range(lanes):
            h = line[c]
            low[c] = h if h < low[c] else low[c]
            high[c] = h if h > high[c] else high[c]


@kernel
def _middle(lows, highs):
    """Of ranges, in place: their middles where their least numbers were, half their widths where the greatest."""
    low, high = lows.reshape(-1), highs.reshape(-1)
    for c in range(len(low)):
        half = (high[c] - low[c]) * _HALF
        high[c] = half
        low[c] += half


@kernel
def _weighed(shares, numbers, total):
    """Sums of the rows of an array, of which there are four or eight, …, each times its share."""
    for w in range(0, len(shares), 4):
        s0, s1, s2, s3 = shares[w], shares[w + 1], shares[w + 2], shares[w + 3]
        n0, n1, n2, n3 = numbers[w], numbers[w + 1], numbers[w + 2], numbers[w + 3]
        for c in range(len(total)):
            before = total[c] if w else _ZERO
            total[c] = before + ((s0 * n0[c] + s1 * n1[c]) + (s2 * n2[c] + s3 * n3[c]))


@kernel
def _widest(halves, steepest):
    """The greatest of the rows of an array, twice."""
    for w in range(0, len(halves), 4):
        n0, n1, n2, n3 = halves[w], halves[w + 1], halves[w + 2], halves[w + 3]
        for c in range(len(steepest)):
            one, other = n0[c] if n0[c] > n1[c] else n1[c], n2[c] if n2[c] > n3[c] else n3[c]
            step = _TWO * (one if one > other else other)
            before = steepest[c] if w else _ZERO
            steepest[c] = before if before > step else step


@kernel
def _lift(heights, first, offsets, places, shares, plane, halves, more, rise):
    """How far the ground under the body comes above the lowest that the wheels' plane can be there, into `rise`.

    `places` are (N, 2) metres ahead and to the left of the middle; `shares` (N, W) what each wheel's height adds
    there, without sign. W is a multiple of four.
    """
    level, along, across = plane
    lanes = len(level)
    for c in range(lanes):
        more[c], rise[c] = _ZERO, -_INF
    h0, h1, h2, h3 = halves[0], halves[1], halves[2], halves[3]
    for n in range(len(offsets)):
        for w in range(4, shares.shape[1]):
            share, half = shares[n, w], halves[w]
            for c in range(lanes):
                more[c] = share * half[c] + (more[c] if w > 4 else _ZERO)
        at = first + offsets[n]
        line = heights[at : at + lanes]
        x, y = places[n, 0], places[n, 1]
        t0, t1, t2, t3 = shares[n, 0], shares[n, 1], shares[n, 2], shares[n, 3]
        for c in range(lanes):
            above = line[c] - (level[c] + x * along[c] + y * across[c]) + more[c]
            above += (t0 * h0[c] + t1 * h1[c]) + (t2 * h2[c] + t3 * h3[c])
            rise[c] = above if above > rise[c] else rise[c]


@kernel
def check_run(poses, row, col, heading):
    """Check all poses of the run that a cell lies in, in one heading, and write their codes."""
    codes, _, source, _ = poses
    heights, offsets, starts, (places, shares), gradients, limits, scratch, counts, shape = source
    rows, cols, width, margin, wheels = shape[0], shape[1], shape[2], shape[3], shape[4]
    col -= col % RUN
    first = (row + margin) * width + col + margin
    most = shares.shape[1]
    lows, halves, rest = scratch[:most], scratch[most : 2 * most], scratch[2 * most :]
    plane, spread, steepest, rise, more = (rest[0], rest[1], rest[2]), (rest[3], rest[4]), rest[5], rest[6], rest[7]
    for w in range(wheels):
        _range_of(heights, first, offsets[starts[heading, w] : starts[heading, w + 1]], lows[w], halves[w])
    _middle(lows, halves)
    for n in range(3):
        _weighed(gradients[n], lows, plane[n])
    for n in range(2):
        _weighed(gradients[3 + n], halves, spread[n])
    _widest(halves, steepest)
    begin, end = starts[heading, wheels], starts[heading, wheels + 1]
    _lift(heights, first, offsets[begin:end], places[begin:end], shares[begin:end], plane, halves, more, rise)
    n = min(RUN, cols - col)
    out = (heading * (rows + 2) + row + 1) * (cols + 2) + col + 1
    moved = limits[HALF_STEPS + heading], limits[MARGINS + heading]
    _write_codes(plane, spread, steepest, rise, limits, moved, codes[out : out + n])
    counts[0] += n


@kernel
def _write_codes(plane, spread, steepest, rise, limits, moved, codes):
    """The verdict on each pose of a run, and its T; `moved` is half a step, and the belly's margin on it."""
    half_step, margin = moved
    _, along, across = plane
    spread_along, spread_across = spread
    over_tilt, over_step = _ONE / limits[TILT], _ONE / limits[STEP]
    over_clearance, most = _ONE / limits[CLEARANCE], np.float32(MOST_CODE)
    for c in range(len(codes)):
        pitch, roll = abs(along[c]) + spread_along[c], abs(across[c]) + spread_across[c]
        tilt, up = (
            arc_tangent(math.sqrt(pitch * pitch + roll * roll)),
            max(rise[c] + half_step * pitch, _ZERO),
        )
        stands = (pitch <= limits[PITCH]) & (roll <= limits[ROLL]) & (tilt <= limits[TILT])
        stands &= (steepest[c] <= limits[STEP]) & (up + margin <= limits[CLEARANCE])
        t = limits[TILT_WEIGHT] * (tilt * over_tilt) + limits[RISE_WEIGHT] * (up * over_clearance)
        t += limits[STEP_WEIGHT] * (steepest[c] * over_step)
        t = min(t, _ONE) if stands else _ZERO
        code = min(np.int32(np.ceil(t * most)), np.int32(MOST_CODE - 1)) + np.int32(1)
        codes[c] = np.uint16(code) if stands else np.uint16(FAILS)


def check_there(poses, row, col, heading):
    """`check_run`, for other kernels to call; `address_of_check` must have been asked for."""
    check_run(poses, row, col, heading)


@overload(check_there)
def _compiled_check_there(poses, row, col, heading):
    return lambda poses, row, col, heading: call_at(poses[3], (poses, row, col, heading))


def address_of_check(poses):
    """Where `check_run`, compiled for such arguments as these, lies in memory; 0 where kernels are not compiled."""
    return address_of(check_run, poses, 0, 0, 0)


@kernel
def check_rows(poses, row0, row1):
    """Check all poses of some rows that are not checked yet."""
    codes, _, source, _ = poses
    rows, cols = source[8][0], source[8][1]
    for row in range(row0, row1):
        for heading in range(4):
            first = (heading * (rows + 2) + row + 1) * (cols + 2) + 1
            for col in range(0, cols, RUN):
                if codes[first + col] == UNCHECKED:
                    check_run(poses, row, col, heading)


@kernel
def forget_poses(poses, area, reach):
    """Take the poses near a rectangle of cells, (row0, row1, col0, col1), as unchecked: those within reach of it.

    `reach` is (rows, columns). Returns how many had been checked.
    """
    codes, _, source, _ = poses
    rows, cols = source[8][0], source[8][1]
    row0, row1 = max(area[0] - reach[0], 0), min(area[1] + reach[0], rows)
    col0, col1 = max(area[2] - reach[1], 0), min(area[3] + reach[1], cols)
    col0 -= col0 % RUN
    col1 = min(col1 + (RUN - col1 % RUN) % RUN, cols)
    forgotten = 0
    for heading in range(4):
        for row in range(row0, row1):
            first = (heading * (rows + 2) + row + 1) * (cols + 2) + 1
            for col in range(col0, col1):
                forgotten += codes[first + col] != UNCHECKED
                codes[first + col] = UNCHECKED
    return forgotten


@kernel
def weight_of_pose(poses, node, stride, heading):
    """Weight of a pose, which is checked if it was not."""
    codes, unit, source, _ = poses
    at = np.uint64(heading * (np.int64(len(codes)) // 4) + node)
    if codes[at] == UNCHECKED:
        check_there(poses, node // stride - 1, node % stride - 1, heading)
    return pose_weight(codes[at], unit)


@kernel
def walk_poses(poses, stride, steps, path, first, costs):
    """As `kernels.paths.walk`, of a path over poses: the first cell that a failing pose leads to, or -1."""
    total = 0.0
    for n in range(first, len(path)):
        if n > first:
            up, left = path[n, 0] - path[n - 1, 0], path[n, 1] - path[n - 1, 1]
            heading = 0 if left == 0 else (2 if up == 0 else (1 if up == left else 3))
            node = (path[n, 0] + 1) * stride + path[n, 1] + 1
            weights = np.float64(weight_of_pose(poses, node - up * stride - left, stride, heading))
            weights += np.float64(weight_of_pose(poses, node, stride, heading))
            if weights == np.inf:
                return n
            length, factor = (steps[1], steps[3]) if up != 0 and left != 0 else (steps[0], steps[2])
            total += length + factor * weights
        costs[n] = total
    return -1


@kernel
def measure_poses(poses, stride, path):
    """As `kernels.paths.measure`, of a path over poses; a cell counts with the mean of its one or two headings."""
    straight, diagonal, by_straight, by_diagonal, ends = 0, 0, 0.0, 0.0, 0.0
    for n in range(1, len(path)):
        up, left = path[n, 0] - path[n - 1, 0], path[n, 1] - path[n - 1, 1]
        heading = 0 if left == 0 else (2 if up == 0 else (1 if up == left else 3))
        node = (path[n, 0] + 1) * stride + path[n, 1] + 1
        here = np.float64(weight_of_pose(poses, node, stride, heading))
        before = np.float64(weight_of_pose(poses, node - up * stride - left, stride, heading))
        if n == 1:
            ends += before
        if n == len(path) - 1:
            ends += here
        if up != 0 and left != 0:
            diagonal += 1
            by_diagonal += before + here
        else:
            straight += 1
            by_straight += before + here
    return straight, diagonal, by_straight, by_diagonal, 0.5 * (by_straight + by_diagonal + ends)
