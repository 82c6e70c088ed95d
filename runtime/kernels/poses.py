"""The check of a body's motions: whether it can follow a leg or turn on a cell, what that costs,
and why it cannot.

Motions are checked a run at a time, `LANES` cells of a row, where a search first asks: a run takes
about as long as two or three motions would take one by one. docs/vehicle-check.md has the
definitions and proof, `robots.body.motions` the tables.

The kernels are given `PosesRecord`. Those that look call `check_run` by its address: numba would
else compile it anew into each of them.
"""

from numpy import float32, inf, int32, uint16, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.by_address import call_at
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
from nnpp_edge.runtime.kernels.records import (
    ACROSS,
    ALONG,
    CARRIED_ACROSS,
    CARRIED_ALONG,
    CARRIED_DOWN,
    CARRIED_STEP,
    FIRST_CELL,
    FIT_AHEAD,
    FIT_LEFT,
    LEVEL,
    MOST_ACROSS,
    MOST_ALONG,
    SAMPLES_END,
    SAMPLES_OF_FOUR,
    SAMPLES_OF_ONE,
    SAMPLES_OF_TWO,
    SWEPT_AHEAD,
    SWEPT_LEFT,
    SWEPT_TURN,
    Figures,
    Plane,
    PosesRecord,
)
from nnpp_edge.runtime.kernels.traversability import arc_tangent

AXIS_COUNT = 8
"""Directions in which a body stands otherwise: the other eight are their reverses."""
UNCHECKED = 0
MOST_CODE = 65520
FAILS = 65521
"""Codes from `FAILS` on are of motions that fail, by `REFUSALS`."""
REFUSALS = ("unknown", "tilt", "pitch", "roll", "step", "belly")
UNKNOWN, TILT, PITCH, ROLL, STEP, BELLY = range(6)
TILT_SHARE = 6
RISE_SHARE = 7
STEP_SHARE = 8
"""Of the limits: tilt in radians, the greatest slopes ahead and to the left, step and clearance
in metres; the weights of the terms of T."""
_1 = uint64(1)
_2 = uint64(2)
_4 = uint64(4)
_REFUSED = float32(FAILS + UNKNOWN)
_PRICED = float32(FAILS - 0.5)
"""Of a run's poses, where unknown ground counts by its price: refused whatever lies there, and not
known, which a refusal outweighs and nothing else.
"""
_ONE = float32(1.0)
_TWO = float32(2.0)
_HALF = float32(0.5)
_ZERO = float32(0.0)
_INF = float32(inf)
_MOST = float32(MOST_CODE)


@helper
def motion_weight(code, unit):
    """Weight of a motion by its code: inf where it fails; 0, which none weighs less than, where
    unchecked.
    """
    weight = float32(max(int32(code), int32(1)) - int32(1)) * unit
    return _INF if code >= FAILS else weight


# The ground under a pose


@helper
def _range(heights, first, group, tables, along, across):
    """Least and greatest height above a plane among a group of samples.

    The plane falls by these slopes from the body's middle. Unsigned indices need no look for
    negative ones.
    """
    offsets = tables.offsets
    shares = tables.shares
    low = in_all(_INF)
    high = in_all(-_INF)
    sample = uint64(group[SAMPLES_OF_FOUR])
    n = uint64(group[FIRST_CELL])
    for end, many in ((SAMPLES_OF_TWO, _4), (SAMPLES_OF_ONE, _2), (SAMPLES_END, _1)):
        while sample < uint64(group[end]):
            height = shares[n] * run_at(heights, first + offsets[n])
            for cell in range(n + _1, n + many):
                height = fused(shares[cell], run_at(heights, first + offsets[cell]), height)
            height = fused(tables.left[sample], across, height)
            there = fused(tables.ahead[sample], along, height)
            low = chosen(there < low, there, low)
            high = chosen(there > high, there, high)
            n += many
            sample += _1
    return low, high


@helper
def _slopes(heights, first, pose, tables):
    """Slopes ahead and to the left of the plane through the heights under the wheels' middles, and
    whether that is known: 0 where it is not.
    """
    along = in_all(_ZERO)
    across = in_all(_ZERO)
    for n in range(tables.fit_of[pose], tables.fit_of[pose + 1]):
        there = run_at(heights, first + tables.fit_offsets[n])
        along = fused(tables.fit_shares[n, FIT_AHEAD], there, along)
        across = fused(tables.fit_shares[n, FIT_LEFT], there, across)
    known = abs(along) + abs(across) < _INF
    return chosen(known, along, _ZERO), chosen(known, across, _ZERO), known


@helper
def _lift(heights, first, pose, tables, fit, least, halves):
    """How far the ground under the body comes above the lowest that the wheels' plane can be there.

    `least` goes through the wheels' least heights above the plane `fit`: the lowest, wherever each
    wheel's height raises it. In a part of the belly where some wheels' heights lower it, their
    greatest heights count.
    """
    gradients = tables.gradients
    rise = in_all(-_INF)
    for part in range(tables.groups_of[pose] + gradients.shape[1], tables.groups_of[pose + 1]):
        level = least.level
        along = least.along
        across = least.across
        for n in range(tables.raised_of[part], tables.raised_of[part + 1]):
            w = tables.raised[n]
            more = _TWO * run_at(halves, w * LANES)
            level += gradients[LEVEL, w] * more
            along += gradients[ALONG, w] * more
            across += gradients[ACROSS, w] * more
        along = _ZERO - (along + fit.along)
        across = _ZERO - (across + fit.across)
        _, high = _range(heights, first, tables.groups[part], tables, along, across)
        above = high - level
        rise = chosen(above > rise, above, rise)
    return rise


@helper
def _highest(heights, first, pose, tables):
    """Greatest of the heights that a pose is checked by, those that are not known apart."""
    begin = tables.groups[tables.groups_of[pose], FIRST_CELL]
    end = tables.groups[tables.groups_of[pose + 1], FIRST_CELL]
    high = in_all(-_INF)
    for n in range(begin, end):
        there = run_at(heights, first + tables.offsets[n])
        high = chosen(there > high, there, high)
    return high


@helper
def _wall_near(heights, first, width, margin):
    """Whether any motion of a run may meet a height that no body passes."""
    found = False
    for row in range(-margin, margin + 1):
        middle = first + row * width
        line = heights[middle - margin : middle + margin + LANES]
        for c in range(len(line)):
            found |= line[c] == _INF
    return found


# Figures and codes


@inlined
def _carried(tables, pair, along, across):
    """What contacts that are carried along their patches may add, by their slopes."""
    return tables.carried[pair] * along + tables.carried[pair + 1] * across


@helper
def _wheels(heights, first, pose, tables, fit, halves):
    """Of a run's poses: the plane through the wheels' least heights above the plane `fit`, and how
    its slopes change with the wheels in the middle of their ranges; by how much these may change
    more; and half of the greatest range. Halves of all ranges are written.
    """
    gradients = tables.gradients
    level = in_all(_ZERO)
    along = in_all(_ZERO)
    across = in_all(_ZERO)
    step = in_all(_ZERO)
    mid_along = in_all(_ZERO)
    mid_across = in_all(_ZERO)
    more_along = in_all(_ZERO)
    more_across = in_all(_ZERO)
    for w in range(gradients.shape[1]):
        group = tables.groups[tables.groups_of[pose] + w]
        along_down = _ZERO - fit.along
        across_down = _ZERO - fit.across
        low, high = _range(heights, first, group, tables, along_down, across_down)
        half = _HALF * (high - low)
        put_run(halves, w * LANES, half)
        level += gradients[LEVEL, w] * low
        along += gradients[ALONG, w] * low
        across += gradients[ACROSS, w] * low
        mid_along += gradients[ALONG, w] * (low + half)
        mid_across += gradients[ACROSS, w] * (low + half)
        more_along += gradients[MOST_ALONG, w] * half
        more_across += gradients[MOST_ACROSS, w] * half
        step = chosen(half > step, half, step)
    least = Plane(level, along, across)
    return least, (mid_along, mid_across), (more_along, more_across), step


@helper
def _figures(heights, first, pose, tables, halves):
    """`Figures` of a run's poses, of one place and heading; and whether the heights under the
    wheels' middles are known.
    """
    fit_along, fit_across, known = _slopes(heights, first, pose, tables)
    fit = Plane(in_all(_ZERO), fit_along, fit_across)
    least, middle, more, half_step = _wheels(heights, first, pose, tables, fit, halves)
    mid_along, mid_across = middle
    more_along, more_across = more
    rise = _lift(heights, first, pose, tables, fit, least, halves)
    # the steepest that the contacts depart from the plane: as they are, and with each carried along
    # its patch
    steep_along = abs(mid_along) + more_along
    steep_across = abs(mid_across) + more_across
    by_along = _carried(tables, CARRIED_ALONG, steep_along, steep_across)
    by_across = _carried(tables, CARRIED_ACROSS, steep_along, steep_across)
    sunk = _carried(tables, CARRIED_DOWN, steep_along, steep_across)
    more_along += by_along
    more_across += by_across
    steep_along += by_along
    steep_across += by_across
    # under the belly, and under a wheel
    ahead = tables.swept[pose, SWEPT_AHEAD]
    aside = tables.swept[pose, SWEPT_LEFT]
    sunk += ahead * steep_along + aside * steep_across
    rise = rise + sunk
    rise = chosen(rise > _ZERO, rise, _ZERO)
    step = _TWO * half_step + _carried(tables, CARRIED_STEP, steep_along, steep_across)
    # slopes, at all headings for which the pose stands
    turn = tables.swept[pose, SWEPT_TURN]
    along = abs(fit_along + mid_along) + more_along
    across = abs(fit_across + mid_across) + more_across
    most_along = along + turn * steep_across
    most_across = across + turn * steep_along
    slope = root(most_along * most_along + most_across * most_across)
    pitch = along + turn * (abs(fit_across) + steep_across)
    roll = across + turn * (abs(fit_along) + steep_along)
    pitch = chosen(pitch < slope, pitch, slope)
    roll = chosen(roll < slope, roll, slope)
    mid_along = fit_along + mid_along
    mid_across = fit_across + mid_across
    return Figures(slope, pitch, roll, step, rise, mid_along, mid_across), known


@helper
def _added(added, first, pose, tables):
    """Mean of what layers add to T under the wheels' middles."""
    total = in_all(_ZERO)
    begin = tables.fit_of[pose]
    end = tables.fit_of[pose + 1]
    if len(added):
        for n in range(begin, end):
            total += run_at(added, first + tables.fit_offsets[n])
    return total * (_ONE / float32(end - begin))


@helper
def _codes(figures, added, limits):
    """Codes of a run's poses; `added` to T."""
    step = figures.step
    rise = figures.rise
    tilt = arc_tangent(figures.slope)
    t = limits[TILT_SHARE] / limits[TILT] * tilt + limits[RISE_SHARE] / limits[BELLY] * rise
    t += limits[STEP_SHARE] / limits[STEP] * step
    t += added
    codes = rounded_up(t * _MOST) + _ONE
    codes = chosen(codes < _MOST, codes, _MOST)
    codes = chosen(rise <= limits[BELLY], codes, float32(FAILS + BELLY))
    codes = chosen(step <= limits[STEP], codes, float32(FAILS + STEP))
    codes = chosen(figures.roll <= limits[ROLL], codes, float32(FAILS + ROLL))
    codes = chosen(figures.pitch <= limits[PITCH], codes, float32(FAILS + PITCH))
    codes = chosen(tilt <= limits[TILT], codes, float32(FAILS + TILT))
    return chosen(figures.slope + step + rise < _INF, codes, _REFUSED)


@inlined
def _first_height(poses, row, col):
    """Place of a cell's height."""
    return (row + poses.margin) * poses.width + col + poses.margin


@kernel
def figures_of(poses: PosesRecord, row, col, motion, out):
    """Figures of a motion's poses from a cell, and their slopes, into `out` (P, 7)."""
    tables = poses.tables
    scratch = poses.scratch
    first = _first_height(poses, row, col)
    begin = tables.poses_of[motion]
    for n in range(tables.poses_of[motion + 1] - begin):
        figures, _ = _figures(poses.heights, first, begin + n, tables, scratch)
        for k in range(len(figures)):
            put_run(scratch, 0, figures[k])
            out[n, k] = scratch[0]


@kernel
def check_run(poses: PosesRecord, row, col, motion):
    """Check a motion from all cells of the run that a cell lies in, and write what is found of it.

    What a motion comes to, one from M on of the body standing in a direction, is left in the
    scratch memory, too.
    """
    tables = poses.tables
    heights = poses.heights
    scratch = poses.scratch
    side = poses.block_side
    cols = poses.cols
    col -= col % LANES
    first = _first_height(poses, row, col)
    begin = tables.poses_of[motion]
    end = tables.poses_of[motion + 1]
    total = in_all(_ZERO)
    worst = in_all(_ZERO)
    wall = side > 0 and _wall_near(heights, first, poses.width, poses.margin)
    for pose in range(begin, end):
        bounds, known = _figures(heights, first, pose, tables, scratch)
        added = _added(poses.added, first, pose, tables)
        code = _codes(bounds, added, poses.limits)
        if side > 0:  # without the wheels' plane, what is known below refuses too much
            code = chosen(known, code, _PRICED)
        if wall:
            code = chosen(_highest(heights, first, pose, tables) < _INF, code, _REFUSED)
        total += code
        worst = chosen(code > worst, code, worst)
    mean = rounded_up(total * (_ONE / float32(end - begin)))
    put_run(scratch, 0, chosen(worst <= _MOST, mean, worst))
    n = min(LANES, cols - col)
    if side > 0:
        for c in range(n):
            if scratch[c] == _PRICED:
                price = poses.block_prices[row // side * (cols // side) + (col + c) // side]
                scratch[c] = _ONE + (_MOST - _ONE) * min(price, _ONE)
    if motion < poses.codes.shape[1]:
        node = (row + 1) * (cols + 2) + col + 1
        there = poses.codes[node:, motion]
        for c in range(n):
            there[c] = uint16(scratch[c])
    poses.counts[0] += n * (end - begin)


@inlined
def check_there(poses, row, col, motion):
    """`check_run`, for other kernels to call."""
    call_at(check_run, poses.check_run, (poses, row, col, motion), None)


@kernel
def standing_codes(poses: PosesRecord, row, out):
    """Codes of the body standing on the cells of a row, in each direction, into `out` (8, W)."""
    first = poses.codes.shape[1]
    for k in range(AXIS_COUNT):
        for col in range(0, out.shape[1], LANES):
            check_there(poses, row, col, first + k)
            for c in range(min(LANES, out.shape[1] - col)):
                out[k, col + c] = uint16(poses.scratch[c])


@kernel
def check_all(poses: PosesRecord):
    """Check all motions that are not checked yet."""
    codes = poses.codes
    for row in range(poses.rows):
        first = (row + 1) * (poses.cols + 2) + 1
        for col in range(0, poses.cols, LANES):
            for motion in range(codes.shape[1]):
                if codes[first + col, motion] == UNCHECKED:
                    check_there(poses, row, col, motion)
