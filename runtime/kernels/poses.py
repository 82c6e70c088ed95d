"""The check of poses: whether a body may stand on a cell in a heading, and what that costs. See `terrain.vehicle`.

Poses are checked a run at a time, `RUN` cells of a row in one heading, where a search first asks: so the compiler
checks eight at once, and a run takes about as long as a single pose would.

The heights under each wheel lie between a least and a greatest, and the plane of the wheels' contacts, fitted by
least squares, is linear in them: its steepest gradients, and the lowest that its belly can come above each cell, are
found from the middles and half widths of these ranges, without trying any out.

The kernels are given `poses`, a tuple (codes, unit, source, address):

    codes      (nodes, 4) uint16, of each heading: `UNCHECKED`, `FAILS`, or 1 + T · `MOST_CODE`, rounded up
    unit       float32, weight of a step of T's code
    source     (heights, offsets, starts, terms, gradients, limits, scratch, counts, shape), see `map.poses`
    address    of `check_run`
"""

import math

import numpy as np
from numba.extending import overload

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.by_address import address_of, borrowed, call_at
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
    """Least and greatest height of some cells, a multiple of four, beside each of a run."""
    lanes = len(low)  # a constant would have the compiler write out all lanes, one by one
    for c in range(lanes):
        low[c], high[c] = _INF, -_INF
    for n in range(0, len(offsets), 4):
        at0, at1, at2, at3 = (
            first + offsets[n],
            first + offsets[n + 1],
            first + offsets[n + 2],
            first + offsets[n + 3],
        )
        line0, line1 = heights[at0 : at0 + lanes], heights[at1 : at1 + lanes]
        line2, line3 = heights[at2 : at2 + lanes], heights[at3 : at3 + lanes]
        for c in range(lanes):
            h0, h1, h2, h3, least, most = line0[c], line1[c], line2[c], line3[c], low[c], high[c]
            least = h0 if h0 < least else least
            least = h1 if h1 < least else least
            least = h2 if h2 < least else least
            low[c] = h3 if h3 < least else least
            most = h0 if h0 > most else most
            most = h1 if h1 > most else most
            most = h2 if h2 > most else most
            high[c] = h3 if h3 > most else most


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
def _lift(heights, first, offsets, belly, heading, gradients, halves, planes, rise):
    """How far the ground under the body comes above the lowest that the wheels' plane can be there, into `rise`.

    The first three of `planes` are the plane through the wheels' least heights: the lowest, wherever each wheel's
    height raises it. On a patch of the belly where a wheel's height lowers it, that wheel's greatest height counts.
    """
    places, of_heading, patches = belly
    lanes = len(rise)
    for c in range(lanes):
        rise[c] = -_INF
    for number in range(of_heading[heading], of_heading[heading + 1]):
        begin, end, like = patches[number, 0], patches[number, 1], patches[number, 2]
        own, wheel = patches[number, 3], patches[number, 4]
        if wheel >= 0:
            for part in range(3):
                share, half, other, plane = (
                    _TWO * gradients[part, wheel],
                    halves[wheel],
                    planes[like + part],
                    planes[own + part],
                )
                for c in range(lanes):
                    plane[c] = other[c] + share * half[c]
        level, along, across = planes[own], planes[own + 1], planes[own + 2]
        for n in range(begin, end, 4):
            at0, at1, at2, at3 = (
                first + offsets[n],
                first + offsets[n + 1],
                first + offsets[n + 2],
                first + offsets[n + 3],
            )
            line0, line1 = heights[at0 : at0 + lanes], heights[at1 : at1 + lanes]
            line2, line3 = heights[at2 : at2 + lanes], heights[at3 : at3 + lanes]
            x0, y0, x1, y1 = places[n, 0], places[n, 1], places[n + 1, 0], places[n + 1, 1]
            x2, y2, x3, y3 = places[n + 2, 0], places[n + 2, 1], places[n + 3, 0], places[n + 3, 1]
            for c in range(lanes):
                middle, x, y, most = level[c], along[c], across[c], rise[c]
                above = line0[c] - (middle + x0 * x + y0 * y)
                most = above if above > most else most
                above = line1[c] - (middle + x1 * x + y1 * y)
                most = above if above > most else most
                above = line2[c] - (middle + x2 * x + y2 * y)
                most = above if above > most else most
                above = line3[c] - (middle + x3 * x + y3 * y)
                rise[c] = above if above > most else most


@kernel
def check_run(poses, row, col, heading):
    """Check all poses of the run that a cell lies in, in one heading, and write their codes."""
    source = poses[2]
    codes, heights = borrowed(poses[0]), borrowed(source[0])
    offsets, starts = borrowed(source[1]), borrowed(source[2])
    belly = borrowed(source[3][0]), borrowed(source[3][1]), borrowed(source[3][2])
    gradients, limits, scratch = borrowed(source[4]), borrowed(source[5]), borrowed(source[6])
    counts, shape = borrowed(source[7]), borrowed(source[8])
    cols, width, margin, wheels = shape[1], shape[2], shape[3], shape[4]
    col -= col % RUN
    first = (row + margin) * width + col + margin
    most = gradients.shape[1]
    lows, halves, rest, planes = scratch[6:][:most], scratch[6 + most :][:most], scratch[:6], scratch[6 + 2 * most :]
    plane, spread, steepest, rise = (rest[0], rest[1]), (rest[2], rest[3]), rest[4], rest[5]
    for w in range(wheels):
        _range_of(heights, first, offsets[starts[heading, w] : starts[heading, w + 1]], lows[w], halves[w])
    for n in range(3):
        _weighed(gradients[n], lows, planes[n])
    _middle(lows, halves)
    for n in range(2):
        _weighed(gradients[1 + n], lows, plane[n])
        _weighed(gradients[3 + n], halves, spread[n])
    _widest(halves, steepest)
    _lift(heights, first, offsets, belly, heading, gradients, halves, planes, rise)
    n = min(RUN, cols - col)
    out = (row + 1) * (cols + 2) + col + 1
    moved = limits[HALF_STEPS + heading], limits[MARGINS + heading]
    _judge(plane, spread, steepest, rise, limits, moved)
    there = codes[out : out + n, heading]
    for c in range(n):
        there[c] = np.uint16(rise[c])
    counts[0] += n


@kernel
def _judge(plane, spread, steepest, rise, limits, moved):
    """The code of each pose of a run, into `rise`; `moved` is half a step, and the belly's margin on it."""
    half_step, margin = moved
    along, across = plane
    spread_along, spread_across = spread
    over_tilt, over_step = _ONE / limits[TILT], _ONE / limits[STEP]
    over_clearance, most = _ONE / limits[CLEARANCE], np.float32(MOST_CODE)
    for c in range(len(rise)):
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
        rise[c] = min(np.ceil(t * most), most - _ONE) + _ONE if stands else np.float32(FAILS)


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
    cols = source[8][1]
    for row in range(row0, row1):
        first = (row + 1) * (cols + 2) + 1
        for heading in range(4):
            for col in range(0, cols, RUN):
                if codes[first + col, heading] == UNCHECKED:
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
    for row in range(row0, row1):
        first = (row + 1) * (cols + 2) + 1
        for col in range(col0, col1):
            for heading in range(4):
                forgotten += codes[first + col, heading] != UNCHECKED
                codes[first + col, heading] = UNCHECKED
    return forgotten


@kernel
def weight_of_pose(poses, node, stride, heading):
    """Weight of a pose, which is checked if it was not."""
    codes, unit, source, _ = poses
    if codes[np.uint64(node), np.uint64(heading)] == UNCHECKED:
        check_there(poses, node // stride - 1, node % stride - 1, heading)
    return pose_weight(codes[np.uint64(node), np.uint64(heading)], unit)


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
