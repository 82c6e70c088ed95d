"""The check of poses: whether a body may stand on a cell in a heading, and what that costs. See `terrain.vehicle`.

Poses are checked a run at a time, `RUN` cells of a row in one heading, where a search first asks: a run takes about
as long as two or three poses would take one by one.

The heights under each wheel lie between a least and a greatest, and the plane of the wheels' contacts, fitted by
least squares, is linear in them: its steepest gradients, and the lowest that its belly can come above each cell, are
found from the middles and half widths of these ranges, without trying any out.

The kernels are given `poses`, a tuple (codes, unit, source, address):

    codes      (nodes, 4) uint16, of each heading: `UNCHECKED`, `FAILS`, or 1 + T · `MOST_CODE`, rounded up
    unit       float32, weight of a step of T's code
    source     (heights, offsets, starts, belly, gradients, limits, halves, counts, shape), see `map.poses`
    address    of `check_run`
"""

import numpy as np
from numba.extending import overload

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.by_address import address_of, borrowed, call_at
from nnpp_edge.runtime.kernels.lanes import LANES, chosen, in_all, put_run, root, rounded_up, run_at
from nnpp_edge.runtime.kernels.traversability import arc_tangent

RUN = LANES
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
_ZERO, _INF, _MOST = np.float32(0.0), np.float32(np.inf), np.float32(MOST_CODE)


@helper
def pose_weight(code, unit):
    """Weight of a pose by its code: inf where it fails; 0, which no pose weighs less than, where unchecked."""
    weight = np.float32(max(np.int32(code), np.int32(1)) - np.int32(1)) * unit
    return _INF if code == FAILS else weight


@kernel
def put_heights(heights, base, unknown, out, row, col):
    """Write heights, less `base`, into `out` from a place on; `unknown` where they are not finite."""
    for i in range(heights.shape[0]):
        line, there = heights[i], out[row + i, col : col + heights.shape[1]]
        for c in range(len(there)):
            h = line[c]
            there[c] = h - base if abs(h) < _INF else unknown


@kernel
def _lift(heights, first, offsets, belly, heading, plane, gradients, halves):
    """How far the ground under the body comes above the lowest that the wheels' plane can be there.

    `plane` goes through the wheels' least heights: the lowest, wherever each wheel's height raises it. On a patch of
    the belly where some wheels' heights lower it, their greatest heights count.
    """
    places, of_heading, patches, raised = belly
    rise = in_all(-_INF)
    for patch in range(of_heading[heading], of_heading[heading + 1]):
        level, along, across = plane
        for n in range(patches[patch, 2], patches[patch, 3]):
            w = raised[n]
            more = _TWO * run_at(halves, w * RUN)
            level += gradients[0, w] * more
            along += gradients[1, w] * more
            across += gradients[2, w] * more
        for n in range(patches[patch, 0], patches[patch, 1]):
            above = run_at(heights, first + offsets[n]) - (level + places[n, 0] * along + places[n, 1] * across)
            rise = chosen(above > rise, above, rise)
    return rise


@helper
def _verdicts(pitch, roll, step, rise, limits, heading):
    """Codes of a run's poses by their greatest gradients along and across, and by how far the ground is above."""
    tilt = arc_tangent(root(pitch * pitch + roll * roll))
    up = rise + limits[HALF_STEPS + heading] * pitch
    up = chosen(up > _ZERO, up, _ZERO)
    stands = (pitch <= limits[PITCH]) & (roll <= limits[ROLL]) & (tilt <= limits[TILT])
    stands &= (step <= limits[STEP]) & (up + limits[MARGINS + heading] <= limits[CLEARANCE])
    t = limits[TILT_WEIGHT] / limits[TILT] * tilt + limits[RISE_WEIGHT] / limits[CLEARANCE] * up
    t += limits[STEP_WEIGHT] / limits[STEP] * step
    codes = rounded_up(t * _MOST) + _ONE
    return chosen(stands, chosen(codes < _MOST, codes, _MOST), np.float32(FAILS))


@kernel
def check_run(poses, row, col, heading):
    """Check all poses of the run that a cell lies in, in one heading, and write their codes."""
    source = poses[2]
    codes, heights = borrowed(poses[0]), borrowed(source[0])
    offsets, starts = borrowed(source[1]), borrowed(source[2])
    belly = borrowed(source[3][0]), borrowed(source[3][1]), borrowed(source[3][2]), borrowed(source[3][3])
    gradients, limits, halves = borrowed(source[4]), borrowed(source[5]), borrowed(source[6])
    counts, shape = borrowed(source[7]), borrowed(source[8])
    cols, width, margin = shape[1], shape[2], shape[3]
    col -= col % RUN
    first = (row + margin) * width + col + margin
    level, along, across, step = in_all(_ZERO), in_all(_ZERO), in_all(_ZERO), in_all(_ZERO)
    pitch, roll, more_pitch, more_roll = in_all(_ZERO), in_all(_ZERO), in_all(_ZERO), in_all(_ZERO)
    for w in range(gradients.shape[1]):
        low, high = in_all(_INF), in_all(-_INF)
        for n in range(starts[heading, w], starts[heading, w + 1]):
            there = run_at(heights, first + offsets[n])
            low, high = chosen(there < low, there, low), chosen(there > high, there, high)
        half = _HALF * (high - low)
        put_run(halves, w * RUN, half)
        level += gradients[0, w] * low
        along += gradients[1, w] * low
        across += gradients[2, w] * low
        pitch += gradients[1, w] * (low + half)
        roll += gradients[2, w] * (low + half)
        more_pitch += gradients[3, w] * half
        more_roll += gradients[4, w] * half
        step = chosen(half > step, half, step)
    rise = _lift(heights, first, offsets, belly, heading, (level, along, across), gradients, halves)
    put_run(halves, 0, _verdicts(abs(pitch) + more_pitch, abs(roll) + more_roll, _TWO * step, rise, limits, heading))
    n = min(RUN, cols - col)
    there = codes[(row + 1) * (cols + 2) + col + 1 :, heading]
    for c in range(n):
        there[c] = np.uint16(halves[c])
    counts[0] += n


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


@helper
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
