"""The check of a body's motions: whether it can follow a leg or turn on a cell, what that costs,
and why it cannot.

Motions are checked a run at a time, `RUN` cells of a row, where a search first asks: a run takes
about as long as two or three motions would take one by one. docs/vehicle-check.md has the
definitions and proof, `robots.body.motions` the tables.

The kernels are given `poses`, a tuple (codes, source, address):

    codes      (nodes, M) uint16, of each motion that begins on a node: `UNCHECKED`,
               1 + T · `MOST_CODE`, rounded up, or `MOST_CODE` + 1 + the limit that refuses it
    source     (heights, motions, limits, scratch, counts, shape, unseen), see `robots.body.poses`
    address    of `check_run`
"""

import numpy as np
from numba.extending import overload

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.by_address import borrowed, call_at
from nnpp_edge.runtime.kernels.lanes import (
    LANES,
    chosen,
    fused,
    in_all,
    put_run,
    root,
    rounded_up,
    run_at,
)
from nnpp_edge.runtime.kernels.traversability import arc_tangent

RUN = LANES
"""Motions that are checked at once."""
AXES = 8
UNCHECKED = 0
MOST_CODE = 65520
FAILS = 65521
"""Codes from `FAILS` on are of motions that fail, by `REFUSALS`."""
REFUSALS = ("unknown", "tilt", "pitch", "roll", "step", "belly")
UNKNOWN, TILT, PITCH, ROLL, STEP, BELLY = range(6)
TILT_WEIGHT = 6
RISE_WEIGHT = 7
STEP_WEIGHT = 8
"""Of the limits: tilt in radians, the greatest slopes ahead and to the left, step and clearance
in metres; the weights of the terms of T."""
_1 = np.uint64(1)
_2 = np.uint64(2)
_3 = np.uint64(3)
_4 = np.uint64(4)
_REFUSED = np.float32(FAILS + UNKNOWN)
_PRICED = np.float32(FAILS - 0.5)
"""Of a run's poses, where unknown ground counts by its price: refused whatever lies there, and not
known, which a refusal outweighs and nothing else.
"""
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_HALF = np.float32(0.5)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_MOST = np.float32(MOST_CODE)


@helper
def motion_weight(code, unit):
    """Weight of a motion by its code: inf where it fails; 0, which none weighs less than, where
    unchecked.
    """
    weight = np.float32(max(np.int32(code), np.int32(1)) - np.int32(1)) * unit
    return _INF if code >= FAILS else weight


@kernel
def put_heights(heights, base, unknown, out, row, col):
    """Write heights, less `base`, into `out` from a place on; `unknown` where they are
    not finite.
    """
    for i in range(heights.shape[0]):
        line = heights[i]
        there = out[row + i, col : col + heights.shape[1]]
        for c in range(len(there)):
            h = line[c]
            there[c] = h - base if abs(h) < _INF else unknown


@helper
def _range(heights, first, group, samples, slopes):
    """Least and greatest height above a plane among a group of samples, see
    `robots.body.motions.Motions.groups`.

    The plane falls by these slopes from the body's middle. Unsigned indices need no look for
    negative ones.
    """
    low = in_all(_INF)
    high = in_all(-_INF)
    ahead, left, offsets, shares = samples
    sample = np.uint64(group[0])
    n = np.uint64(group[4])
    for k, many in ((1, _4), (2, _2), (3, _1)):
        while sample < np.uint64(group[k]):
            height = shares[n] * run_at(heights, first + offsets[n])
            for cell in range(n + _1, n + many):
                height = fused(shares[cell], run_at(heights, first + offsets[cell]), height)
            there = fused(ahead[sample], slopes[0], fused(left[sample], slopes[1], height))
            low = chosen(there < low, there, low)
            high = chosen(there > high, there, high)
            n += many
            sample += _1
    return low, high


@helper
def _slopes(heights, first, pose, fitted):
    """Slopes ahead and to the left of the plane through the heights under the wheels' middles, and
    whether that is known: 0 where it is not.
    """
    slopes_of, offsets, shares = fitted
    along = in_all(_ZERO)
    across = in_all(_ZERO)
    for n in range(slopes_of[pose], slopes_of[pose + 1]):
        there = run_at(heights, first + offsets[n])
        along = fused(shares[n, 0], there, along)
        across = fused(shares[n, 1], there, across)
    known = abs(along) + abs(across) < _INF
    return chosen(known, along, _ZERO), chosen(known, across, _ZERO), known


@helper
def _lift(heights, first, pose, tables, slopes, plane, halves):
    """How far the ground under the body comes above the lowest that the wheels' plane can be there.

    `plane` goes through the wheels' least heights: the lowest, wherever each wheel's height raises
    it. In a part of the belly where some wheels' heights lower it, their greatest heights count.
    """
    groups_of, groups, samples, _, (raised_of, raised), _, gradients, _ = tables
    rise = in_all(-_INF)
    for part in range(groups_of[pose] + gradients.shape[1], groups_of[pose + 1]):
        level, along, across = plane
        for n in range(raised_of[part], raised_of[part + 1]):
            w = raised[n]
            more = _TWO * run_at(halves, w * RUN)
            level += gradients[0, w] * more
            along += gradients[1, w] * more
            across += gradients[2, w] * more
        below = _ZERO - (along + slopes[0]), _ZERO - (across + slopes[1])
        above = _range(heights, first, groups[part], samples, below)[1] - level
        rise = chosen(above > rise, above, rise)
    return rise


@helper
def _codes(figures, limits):
    """Codes of a run's poses by their steepest tilt, pitch and roll (as slopes), step, and rise
    under the belly.
    """
    slope, pitch, roll, step, up = figures
    tilt = arc_tangent(slope)
    t = limits[TILT_WEIGHT] / limits[TILT] * tilt + limits[RISE_WEIGHT] / limits[BELLY] * up
    t += limits[STEP_WEIGHT] / limits[STEP] * step
    codes = rounded_up(t * _MOST) + _ONE
    codes = chosen(codes < _MOST, codes, _MOST)
    codes = chosen(up <= limits[BELLY], codes, np.float32(FAILS + BELLY))
    codes = chosen(step <= limits[STEP], codes, np.float32(FAILS + STEP))
    codes = chosen(roll <= limits[ROLL], codes, np.float32(FAILS + ROLL))
    codes = chosen(pitch <= limits[PITCH], codes, np.float32(FAILS + PITCH))
    codes = chosen(tilt <= limits[TILT], codes, np.float32(FAILS + TILT))
    return chosen(slope + step + up < _INF, codes, np.float32(FAILS + UNKNOWN))


@helper
def _highest(heights, first, pose, tables):
    """Greatest of the heights that a pose is checked by, those that are not known apart."""
    groups_of, groups, samples, _, _, _, _, _ = tables
    offsets = samples[2]
    last = groups[groups_of[pose + 1] - 1]
    end = last[4] + 4 * (last[1] - last[0]) + 2 * (last[2] - last[1]) + last[3] - last[2]
    high = in_all(-_INF)
    for n in range(groups[groups_of[pose], 4], end):
        there = run_at(heights, first + offsets[n])
        high = chosen(there > high, there, high)
    return high


@helper
def _wall_near(heights, first, width, margin):
    """Whether any motion of a run may meet a height that no body passes."""
    found = False
    for row in range(-margin, margin + 1):
        middle = first + row * width
        line = heights[middle - margin : middle + margin + RUN]
        for c in range(len(line)):
            found |= line[c] == _INF
    return found


@helper
def _figures(heights, first, pose, tables, halves):
    """Of a run's poses, of one place and heading: bounds of slope, pitch, roll (as slopes), step,
    and rise under the belly; their slopes ahead and to the left with the wheels in the middle of
    their ranges; and whether the heights under the wheels' middles are known.
    """
    groups_of, groups, samples, fitted, _, swept, gradients, carried = tables
    slopes = _slopes(heights, first, pose, fitted)
    level = in_all(_ZERO)
    along = in_all(_ZERO)
    across = in_all(_ZERO)
    step = in_all(_ZERO)
    mid_along = in_all(_ZERO)
    mid_across = in_all(_ZERO)
    more_along = in_all(_ZERO)
    more_across = in_all(_ZERO)
    for w in range(gradients.shape[1]):
        k = groups_of[pose] + w
        low, high = _range(
            heights, first, groups[k], samples, (_ZERO - slopes[0], _ZERO - slopes[1])
        )
        half = _HALF * (high - low)
        put_run(halves, w * RUN, half)
        level += gradients[0, w] * low
        along += gradients[1, w] * low
        across += gradients[2, w] * low
        mid_along += gradients[1, w] * (low + half)
        mid_across += gradients[2, w] * (low + half)
        more_along += gradients[3, w] * half
        more_across += gradients[4, w] * half
        step = chosen(half > step, half, step)
    rise = _lift(heights, first, pose, tables, slopes, (level, along, across), halves)
    # the steepest that the contacts depart from the plane: as they are, and with each carried along
    # its patch
    steep_along = abs(mid_along) + more_along
    steep_across = abs(mid_across) + more_across
    by_along = carried[0] * steep_along + carried[1] * steep_across
    by_across = carried[2] * steep_along + carried[3] * steep_across
    sunk = carried[4] * steep_along + carried[5] * steep_across
    more_along += by_along
    more_across += by_across
    steep_along += by_along
    steep_across += by_across
    ahead = swept[pose, 0]
    aside = swept[pose, 1]
    turn = swept[pose, 2]
    sunk += ahead * steep_along + aside * steep_across
    up = rise + sunk
    up = chosen(up > _ZERO, up, _ZERO)
    step = _TWO * step + (carried[6] * steep_along + carried[7] * steep_across)
    along = abs(slopes[0] + mid_along) + more_along
    across = abs(slopes[1] + mid_across) + more_across
    most_along = along + turn * steep_across
    most_across = across + turn * steep_along
    slope = root(most_along * most_along + most_across * most_across)
    pitch = along + turn * (abs(slopes[1]) + steep_across)
    roll = across + turn * (abs(slopes[0]) + steep_along)
    pitch = chosen(pitch < slope, pitch, slope)
    roll = chosen(roll < slope, roll, slope)
    return (
        (slope, pitch, roll, step, up),
        (slopes[0] + mid_along, slopes[1] + mid_across),
        slopes[2],
    )


@helper
def _given(poses):
    """All that the check reads, references to which are not counted: (heights, width, margin),
    tables, scratch.
    """
    source = poses[1]
    given = source[1]
    shape = source[5]
    samples = given[3]
    fitted = given[4]
    belly = given[5]
    tables = (
        borrowed(given[1]),
        borrowed(given[2]),
        (borrowed(samples[0]), borrowed(samples[1]), borrowed(samples[2]), borrowed(samples[3])),
        (borrowed(fitted[0]), borrowed(fitted[1]), borrowed(fitted[2])),
        (borrowed(belly[0]), borrowed(belly[1])),
        borrowed(given[6]),
        borrowed(given[7]),
        borrowed(given[8]),
    )
    return (
        (borrowed(source[0]), shape[2], shape[3]),
        borrowed(given[0]),
        tables,
        borrowed(source[3]),
    )


@kernel
def figures_of(poses, row, col, motion, out):
    """Figures of a motion's poses from a cell, as `_figures`, into `out` (P, 7)."""
    (heights, width, margin), poses_of, tables, scratch = _given(poses)
    first = (row + margin) * width + col + margin
    for n in range(poses_of[motion + 1] - poses_of[motion]):
        bounds, (along, across), _ = _figures(heights, first, poses_of[motion] + n, tables, scratch)
        figures = bounds[0], bounds[1], bounds[2], bounds[3], bounds[4], along, across
        for k in range(7):
            put_run(scratch, 0, figures[k])
            out[n, k] = scratch[0]


@kernel
def check_run(poses, row, col, motion):
    """Check a motion from all cells of the run that a cell lies in, and write what is found of it.

    What a motion comes to, one from M on of the body standing in a direction, is left in the
    scratch memory, too.
    """
    codes = borrowed(poses[0])
    source = poses[1]
    limits = borrowed(source[2])
    counts = borrowed(source[4])
    cols = source[5][1]
    side = source[5][4]
    unseen = borrowed(source[6])
    (heights, width, margin), poses_of, tables, scratch = _given(poses)
    col -= col % RUN
    first = (row + margin) * width + col + margin
    total = in_all(_ZERO)
    worst = in_all(_ZERO)
    wall = side > 0 and _wall_near(heights, first, width, margin)
    for pose in range(poses_of[motion], poses_of[motion + 1]):
        bounds, _, known = _figures(heights, first, pose, tables, scratch)
        code = _codes(bounds, limits)
        if side > 0:  # without the wheels' plane, what is known below refuses too much
            code = chosen(known, code, _PRICED)
        if wall:
            code = chosen(_highest(heights, first, pose, tables) < _INF, code, _REFUSED)
        total += code
        worst = chosen(code > worst, code, worst)
    mean = rounded_up(total * (_ONE / np.float32(poses_of[motion + 1] - poses_of[motion])))
    put_run(scratch, 0, chosen(worst <= _MOST, mean, worst))
    n = min(RUN, cols - col)
    node = (row + 1) * (cols + 2) + col + 1
    if side > 0:
        for c in range(n):
            if scratch[c] == _PRICED:
                price = unseen[row // side * (cols // side) + (col + c) // side]
                scratch[c] = _ONE + (_MOST - _ONE) * min(price, _ONE)
    if motion < codes.shape[1]:
        there = codes[node:, motion]
        for c in range(n):
            there[c] = np.uint16(scratch[c])
    counts[0] += n * (poses_of[motion + 1] - poses_of[motion])


def check_there(poses, row, col, motion):
    """`check_run`, for other kernels to call."""
    check_run(poses, row, col, motion)


@overload(check_there)
def _compiled_check_there(poses, row, col, motion):
    return lambda poses, row, col, motion: call_at(poses[2], (poses, row, col, motion))


@kernel
def standing_codes(poses, row, out):
    """Codes of the body standing on the cells of a row, in each direction, into `out` (8, W)."""
    scratch = poses[1][3]
    first = poses[0].shape[1]
    for k in range(AXES):
        for col in range(0, out.shape[1], RUN):
            check_run(poses, row, col, first + k)
            for c in range(min(RUN, out.shape[1] - col)):
                out[k, col + c] = np.uint16(scratch[c])


@kernel
def check_all(poses):
    """Check all motions that are not checked yet."""
    codes = poses[0]
    rows = poses[1][5][0]
    cols = poses[1][5][1]
    for row in range(rows):
        first = (row + 1) * (cols + 2) + 1
        for col in range(0, cols, RUN):
            for motion in range(codes.shape[1]):
                if codes[first + col, motion] == UNCHECKED:
                    check_run(poses, row, col, motion)


@kernel
def forget_poses(poses, area, reach):
    """Take motions within `reach`, (rows, columns), of an `area` of cells as unchecked."""
    codes = poses[0]
    rows = poses[1][5][0]
    cols = poses[1][5][1]
    row0 = max(area[0] - reach[0], 0)
    row1 = min(area[1] + reach[0], rows)
    col0 = max(area[2] - reach[1], 0)
    col1 = min(area[3] + reach[1], cols)
    col0 -= col0 % RUN
    col1 = min(col1 + (RUN - col1 % RUN) % RUN, cols)
    for row in range(row0, row1):
        first = (row + 1) * (cols + 2) + 1
        codes[first + col0 : first + col1] = UNCHECKED
