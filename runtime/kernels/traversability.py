"""Slope, roughness and elevation difference of each cell, and its cost. See
`terrain.traversability`.

Several ways lead to the same result. Where all nine cells of a patch are known, the plane has a
closed form, in float32 and without a branch, so that the compiler computes eight cells of a row at
once. Heights are taken relative to the patch's own middle, and the residual is the sum of the
squares of six contrasts in which no plane has a part: so no large numbers are subtracted, and a map
8,000 m up loses no digit. The six cells of a patch at a side of the map have such a form, too. All
other patches are fitted by their moments.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.lanes import chosen

RULE_SLOTS = 13
# slots of the array of floats that says how heights become costs
DY = 0
DX = 1
SLOPE_LIMIT = 2
ROUGHNESS_LIMIT = 3
STEP_LIMIT = 4
SLOPE_WEIGHT = 5
ROUGHNESS_WEIGHT = 6
STEP_WEIGHT = 7
HARD_SLOPE = 8
HARD_ROUGHNESS = 9
HARD_STEP = 10
SCALE = 11
HARD_GRADIENT = 12

_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_NAN = np.float32(np.nan)
_1 = np.uint64(1)
_2 = np.uint64(2)
_QUARTER_TURN = np.float32(0.5 * math.pi)
_MOST = np.nextafter(_ONE, _ZERO)
"""The greatest cost below 1."""
_A0, _A1, _A2, _A3, _A4, _A5, _A6 = (
    np.float32(coefficient)
    for coefficient in (
        0.9999961115277097,
        -0.33317367990706626,
        0.1980781503586841,
        -0.1323334023607846,
        0.07962364075672511,
        -0.03360419486579314,
        0.006811785276088361,
    )
)
"""Of the odd polynomial of degree 13 that is nowhere in [0, 1] more than 2.5e-7 from the arc
tangent.
"""
_THIRD = np.float32(1 / 3)
_QUARTER = np.float32(1 / 4)
_SIXTH = np.float32(1 / 6)
_NINTH = np.float32(1 / 9)
_TWELFTH = np.float32(1 / 12)
_EIGHTEENTH = np.float32(1 / 18)
_THIRTY_SIXTH = np.float32(1 / 36)


@helper
def _moments_plane(heights, rows, cols, row, col, dy, dx):
    """Slope (rad), roughness and elevation difference of one known cell, from the known cells of
    its patch.
    """
    here = np.float64(heights[row * cols + col])
    n = 0.0
    sx = sy = sz = sxx = sxy = syy = sxz = syz = szz = 0.0
    for i in range(max(row - 1, 0), min(row + 2, rows)):
        for j in range(max(col - 1, 0), min(col + 2, cols)):
            z = np.float64(heights[i * cols + j]) - here
            if not math.isfinite(z):
                continue
            x = (j - col) * dx
            y = (i - row) * dy
            n += 1.0
            sx += x
            sy += y
            sz += z
            sxx += x * x
            sxy += x * y
            syy += y * y
            sxz += x * z
            syz += y * z
            szz += z * z
    # moments about the patch's mean point
    sxx -= sx * sx / n
    sxy -= sx * sy / n
    syy -= sy * sy / n
    sxz -= sx * sz / n
    syz -= sy * sz / n
    szz -= sz * sz / n
    determinant = sxx * syy - sxy * sxy
    trace = sxx + syy
    if determinant > 1e-9 * trace * trace:
        a = (sxz * syy - syz * sxy) / determinant
        b = (syz * sxx - sxz * sxy) / determinant
    elif trace > 0.0:  # all points on one line: the gradient of least length, which runs along it
        a = sxz / trace
        b = syz / trace
    else:  # a single point
        a = b = 0.0
    steepness = math.sqrt(a * a + b * b)
    upright = 1.0 / math.sqrt(1.0 + steepness * steepness)
    residual = max(szz - a * sxz - b * syz, 0.0)
    own = (0.0 - sz / n) + a * sx / n + b * sy / n
    return math.atan(steepness), math.sqrt(residual / n) * upright, abs(own) * upright


@helper
def arc_tangent(x):
    """Of a float32 from 0 up, or of a run of them, within 2.5e-7."""
    steep = x > _ONE
    x = chosen(steep, _ONE / x, x)
    y = x * x
    angle = x * (_A0 + y * (_A1 + y * (_A2 + y * (_A3 + y * (_A4 + y * (_A5 + y * _A6))))))
    return chosen(steep, _QUARTER_TURN - angle, angle)


@helper
def _of_plane(a, b, variance, own):
    """Slope (rad), roughness and elevation difference by a plane's gradients, all float32.

    `variance` is the mean square of the patch's vertical distances from it, `own` the cell's own.
    """
    square = a * a + b * b
    upright = _ONE / (_ONE + square)
    return (
        arc_tangent(math.sqrt(square)),
        math.sqrt(variance * upright),
        abs(own) * math.sqrt(upright),
    )


@helper
def _whole_plane(top, middle, bottom, over_dx, over_dy):
    """Terms of a cell all of whose patch is known, three rows of three; not finite where it is not.

    `over_dx` and `over_dy` are 1 / (6 dx) and 1 / (6 dy). Each column's sum, difference of its ends
    and curvature (top - 2 middle + bottom), and then the same three of those along the row.
    """
    tl, tm, tr = top
    ml, mm, mr = middle
    bl, bm, br = bottom
    tl = tl - mm
    tm = tm - mm
    tr = tr - mm
    ml = ml - mm
    mr = mr - mm
    bl = bl - mm
    bm = bm - mm
    br = br - mm
    ends_l = tl + bl
    ends_m = tm + bm
    ends_r = tr + br
    sum_l = ends_l + ml
    sum_r = ends_r + mr
    # of the middle column both are `ends_m`
    bend_l = ends_l - (ml + ml)
    bend_r = ends_r - (mr + mr)
    rise_l = bl - tl
    rise_m = bm - tm
    rise_r = br - tr
    sums = sum_l + sum_r
    rises = rise_l + rise_r
    bends = bend_l + bend_r
    along = sums - (ends_m + ends_m)
    across = bends + ends_m
    twist = rise_r - rise_l
    fan = rises - (rise_m + rise_m)
    tent = bend_r - bend_l
    saddle = bends - (ends_m + ends_m)
    residual = (along * along + across * across) * _EIGHTEENTH + twist * twist * _QUARTER
    residual += (fan * fan + tent * tent) * _TWELFTH + saddle * saddle * _THIRTY_SIXTH
    return _of_plane(
        (sum_r - sum_l) * over_dx,
        (rises + rise_m) * over_dy,
        residual * _NINTH,
        (sums + ends_m) * _NINTH,
    )


@helper
def _side_plane(side, beside, over_along, over_across):
    """Terms of a cell at a side of the map, of whose patch there are the three cells of the side
    and three beside.

    `over_along` and `over_across` are 1 / (4 d) and 1 / (3 d) of the distances of cells along the
    side and across it. Each pair's sum and rise, and of those along the side their mean, difference
    of the ends and curvature.
    """
    ol, om, other = side
    xl, xm, xr = beside
    ol = ol - om
    other = other - om
    xl = xl - om
    xm = xm - om
    xr = xr - om
    rise_l = xl - ol
    rise_r = xr - other
    rises = rise_l + rise_r
    sum_l = ol + xl
    sum_r = other + xr
    curve = sum_l + sum_r - (xm + xm)
    twist = rise_r - rise_l
    fan = rises - (xm + xm)
    residual = (curve * curve + fan * fan) * _TWELFTH + twist * twist * _QUARTER
    own = (ol + other) * _THIRD
    return _of_plane(
        (sum_r - sum_l) * over_along, (rises + xm) * over_across, residual * _SIXTH, own
    )


@helper
def _constants(rule):
    """Constants of a rule, in float32: inverse limits, weights, hard limits, scale, and inverse
    distances.

    These are as `_whole_plane` takes them, then as `_side_plane` does along a row and along a
    column.
    """
    dy = rule[DY]
    dx = rule[DX]
    scale = np.float32(rule[SCALE])
    whole = np.float32(1.0 / (6.0 * dx)), np.float32(1.0 / (6.0 * dy))
    row = np.float32(0.25 / dx), np.float32(1.0 / (3.0 * dy))
    column = np.float32(0.25 / dy), np.float32(1.0 / (3.0 * dx))
    inverse = np.float32(1.0 / rule[SLOPE_LIMIT]), np.float32(1.0 / rule[ROUGHNESS_LIMIT])
    weights = (
        np.float32(rule[SLOPE_WEIGHT]),
        np.float32(rule[ROUGHNESS_WEIGHT]),
        np.float32(rule[STEP_WEIGHT]),
    )
    hard = (
        np.float32(rule[HARD_SLOPE]),
        np.float32(rule[HARD_ROUGHNESS]),
        np.float32(rule[HARD_STEP]),
    )
    return (
        (*inverse, np.float32(1.0 / rule[STEP_LIMIT])),
        weights,
        hard,
        scale,
        (whole, row, column),
    )


@helper
def _of_terms(slope, roughness, step, constants):
    """Weight of a cell by Eq. 1, inf where impassable; NaN where a term is not finite."""
    inverse, weights, hard, scale, _ = constants
    s = min(slope * inverse[0], _ONE)
    r = min(roughness * inverse[1], _ONE)
    f = min(step * inverse[2], _ONE)
    t = min(weights[0] * s + weights[1] * r + weights[2] * f, _MOST)
    beyond = (slope > hard[0]) | (roughness > hard[1]) | (step > hard[2])
    beyond |= (s >= _ONE) & (r >= _ONE) & (f >= _ONE)
    weight = _INF if beyond else t * scale
    terms = slope + roughness + step
    return weight if terms - terms == _ZERO else _NAN


@helper
def _fill_row(heights, first, cols, n, constants, out, at):
    """Weights of `n` cells of a row, neither the map's first nor its last, from index `first` on:
    NaN beside a hole.

    Returns whether there is a hole. Cells at the border are to be weighed anew.
    """
    # a slice for each row of neighbours: indices that begin at 0 need no look for negative ones
    above = heights[first - cols - 1 : first - cols + n + 1]
    below = heights[first + cols - 1 : first + cols + n + 1]
    over_dx, over_dy = constants[4][0]
    beside = heights[first - 1 : first + n + 1]
    row = out[at : at + n]
    for c in range(n):
        left = np.uint64(c)
        mid = np.uint64(c) + _1
        right = np.uint64(c) + _2
        top = (above[left], above[mid], above[right])
        middle = (beside[left], beside[mid], beside[right])
        bottom = below[left], below[mid], below[right]
        slope, roughness, step = _whole_plane(top, middle, bottom, over_dx, over_dy)
        row[left] = _of_terms(slope, roughness, step, constants)
    holes = False
    for c in range(n):
        holes |= row[c] != row[c]
    return holes


@helper
def _weight(heights, rows, cols, row, col, rule, constants):
    """Weight of one cell, from whatever is known around it."""
    if not math.isfinite(heights[row * cols + col]):
        return _INF
    slope, roughness, step = _moments_plane(heights, rows, cols, row, col, rule[DY], rule[DX])
    weight = _of_terms(np.float32(slope), np.float32(roughness), np.float32(step), constants)
    return _INF if math.isnan(weight) else weight


@helper
def _steps_steeply(heights, rows, cols, row, col, rule):
    """Whether a step from a cell's middle to that of a known neighbour is too steep."""
    here = heights[row * cols + col]
    for i in range(max(row - 1, 0), min(row + 2, rows)):
        for j in range(max(col - 1, 0), min(col + 2, cols)):
            apart = math.hypot((i - row) * rule[DY], (j - col) * rule[DX])
            rise = abs(heights[i * cols + j] - here)
            if rise > np.float32(rule[HARD_GRADIENT] * apart) and rise < _INF:
                return True
    return False


@helper
def _border_weight(heights, rows, cols, row, col, rule, constants):
    """Weight of a cell at the border, faster where its patch has no hole."""
    if rule[HARD_GRADIENT] < np.inf and _steps_steeply(heights, rows, cols, row, col, rule):
        return _INF
    at = row * cols + col
    if 0 < col < cols - 1 and rows > 1:
        along = 1
        across = cols if row == 0 else -cols
        over = constants[4][1]
    elif 0 < row < rows - 1 and cols > 1:
        along = cols
        across = 1 if col == 0 else -1
        over = constants[4][2]
    else:
        return _weight(heights, rows, cols, row, col, rule, constants)
    side = (heights[at - along], heights[at], heights[at + along])
    other = at + across
    beside = heights[other - along], heights[other], heights[other + along]
    terms = _side_plane(side, beside, over[0], over[1])
    weight = _of_terms(terms[0], terms[1], terms[2], constants)
    return _weight(heights, rows, cols, row, col, rule, constants) if math.isnan(weight) else weight


@helper
def _too_high(rise, highest):
    """Whether a rise, or each of a run of them, is known and too high."""
    return (abs(rise) > highest) & (abs(rise) < _INF)


@helper
def _shut_steep_steps(heights, first, cols, n, rule, out, at):
    """Shut those of `n` cells of a row, from index `first` on, from which a step is too steep.

    Neither the row nor any of the cells lies at the map's border.
    """
    above = heights[first - cols - 1 : first - cols + n + 1]
    below = heights[first + cols - 1 : first + cols + n + 1]
    beside = heights[first - 1 : first + n + 1]
    weights = out[at : at + n]
    along = np.float32(rule[HARD_GRADIENT] * rule[DX])
    across = np.float32(rule[HARD_GRADIENT] * rule[DY])
    diagonal = np.float32(rule[HARD_GRADIENT] * math.hypot(rule[DY], rule[DX]))
    for c in range(n):
        left = np.uint64(c)
        mid = np.uint64(c) + _1
        right = np.uint64(c) + _2
        here = beside[mid]
        steep = _too_high(beside[left] - here, along) | _too_high(beside[right] - here, along)
        steep |= _too_high(above[mid] - here, across) | _too_high(below[mid] - here, across)
        steep |= _too_high(above[left] - here, diagonal) | _too_high(above[right] - here, diagonal)
        steep |= _too_high(below[left] - here, diagonal) | _too_high(below[right] - here, diagonal)
        weights[left] = _INF if steep else weights[left]


@kernel
def fill_weights(heights, rows, cols, rule, area, out, first, stride):
    """Weights of a rectangle of cells, inf where impassable.

    Parameters
    ----------
    heights : (rows · cols,) float32
        Metres of the map's cells, row by row; NaN or infinite where unknown.
    rule : (RULE_SLOTS,) float64
        Sides of a cell, limits (the slope's in radians), weights, hard limits, the weight of a
        cost of 1, and the greatest rise of a step, metres a metre.
    area : (row0, row1, col0, col1)
    out : (…,) float32
        Written: cell (row, col) at `first` + row · `stride` + col.
    """
    row0, row1, col0, col1 = area
    inner0 = max(col0, 1)
    inner1 = min(col1, cols - 1)
    constants = _constants(rule)
    for row in range(row0, row1):
        at = first + row * stride
        if row == 0 or row == rows - 1 or inner0 >= inner1:
            for col in range(col0, col1):
                out[at + col] = _border_weight(heights, rows, cols, row, col, rule, constants)
        else:
            # with the cells at the border, where their neighbours' places are in memory: whole
            # rows of tiles are quicker
            begin = inner0 if row == 1 else col0
            end = inner1 if row == rows - 2 else col1
            if _fill_row(
                heights, row * cols + begin, cols, end - begin, constants, out, at + begin
            ):
                for col in range(inner0, inner1):
                    if math.isnan(out[at + col]):
                        out[at + col] = _weight(heights, rows, cols, row, col, rule, constants)
            if rule[HARD_GRADIENT] < np.inf and inner0 < inner1:
                begin = row * cols + inner0
                n = inner1 - inner0
                _shut_steep_steps(heights, begin, cols, n, rule, out, at + inner0)
            if col0 == 0:
                out[at] = _border_weight(heights, rows, cols, row, 0, rule, constants)
            if col1 == cols:
                out[at + cols - 1] = _border_weight(
                    heights, rows, cols, row, cols - 1, rule, constants
                )


@kernel
def count_saturated(heights, rows, cols, rule, steps, counts):
    """Count, in a sample of the cells, the known ones and those at the limit of each of the terms.

    `steps` are the rows and the columns from one cell of the sample to the next.
    """
    for row in range(steps[0] // 2, rows, steps[0]):
        for col in range(steps[1] // 2, cols, steps[1]):
            if math.isfinite(heights[row * cols + col]):
                terms = _moments_plane(heights, rows, cols, row, col, rule[DY], rule[DX])
                counts[0] += 1
                for n in range(3):
                    counts[n + 1] += terms[n] >= rule[SLOPE_LIMIT + n]


@kernel
def fill_terms(heights, rows, cols, dy, dx, out):
    """Slope, roughness and elevation difference of each cell into `out`; NaN where unknown."""
    for row in range(rows):
        for col in range(cols):
            if math.isfinite(heights[row * cols + col]):
                terms = _moments_plane(heights, rows, cols, row, col, dy, dx)
                out[0, row, col], out[1, row, col], out[2, row, col] = terms
            else:
                out[:, row, col] = np.nan
