"""Slope, roughness and elevation difference of each cell, and its cost. See `terrain.traversability`.

Two ways lead to the same result. Where all nine cells of a patch are known, the plane has a closed form, in float32
and without a branch, so that the compiler computes eight cells of a row at once. Heights are taken relative to the
patch's own middle, and the residual is the sum of the squares of six contrasts in which no plane has a part: so no
large numbers are subtracted, and a map 8,000 m up loses no digit. All other patches are fitted by their moments.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel

RULE_SLOTS = 12
# slots of the array of floats that says how heights become costs
DY, DX, SLOPE_LIMIT, ROUGHNESS_LIMIT, STEP_LIMIT = 0, 1, 2, 3, 4
SLOPE_WEIGHT, ROUGHNESS_WEIGHT, STEP_WEIGHT = 5, 6, 7
HARD_SLOPE, HARD_ROUGHNESS, HARD_STEP, SCALE = 8, 9, 10, 11

_ONE, _ZERO, _INF, _NAN = np.float32(1.0), np.float32(0.0), np.float32(np.inf), np.float32(np.nan)
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
"""Of the odd polynomial of degree 13 that is nowhere in [0, 1] more than 2.5e-7 from the arc tangent."""
_NINTH, _QUARTER, _TWELFTH = np.float32(1 / 9), np.float32(1 / 4), np.float32(1 / 12)
_EIGHTEENTH, _THIRTY_SIXTH = np.float32(1 / 18), np.float32(1 / 36)


@kernel
def _moments_plane(heights, rows, cols, row, col, dy, dx):
    """Slope (rad), roughness and elevation difference of one known cell, from the known cells of its patch."""
    here = np.float64(heights[row * cols + col])
    n = 0.0
    sx = sy = sz = sxx = sxy = syy = sxz = syz = szz = 0.0
    for i in range(max(row - 1, 0), min(row + 2, rows)):
        for j in range(max(col - 1, 0), min(col + 2, cols)):
            z = np.float64(heights[i * cols + j]) - here
            if not math.isfinite(z):
                continue
            x, y = (j - col) * dx, (i - row) * dy
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
        a, b = sxz / trace, syz / trace
    else:  # a single point
        a = b = 0.0
    steepness = math.sqrt(a * a + b * b)
    upright = 1.0 / math.sqrt(1.0 + steepness * steepness)
    residual = max(szz - a * sxz - b * syz, 0.0)
    own = (0.0 - sz / n) + a * sx / n + b * sy / n
    return math.atan(steepness), math.sqrt(residual / n) * upright, abs(own) * upright


@kernel
def _whole_plane(top, middle, bottom, over_dx, over_dy):
    """The same of a cell all of whose patch is known, three rows of three; not finite where it is not. All float32.

    `over_dx` and `over_dy` are 1 / (6 dx) and 1 / (6 dy). Each column's sum, difference of its ends and curvature
    (top - 2 middle + bottom), and then the same three of those along the row.
    """
    (tl, tm, tr), (ml, mm, mr), (bl, bm, br) = top, middle, bottom
    tl, tm, tr, ml, mr, bl, bm, br = tl - mm, tm - mm, tr - mm, ml - mm, mr - mm, bl - mm, bm - mm, br - mm
    ends_l, ends_m, ends_r = tl + bl, tm + bm, tr + br
    sum_l, sum_r = ends_l + ml, ends_r + mr
    bend_l, bend_r = ends_l - (ml + ml), ends_r - (mr + mr)  # of the middle column both are `ends_m`
    rise_l, rise_m, rise_r = bl - tl, bm - tm, br - tr
    sums, rises, bends = sum_l + sum_r, rise_l + rise_r, bend_l + bend_r
    along, across = sums - (ends_m + ends_m), bends + ends_m
    twist, fan, tent = rise_r - rise_l, rises - (rise_m + rise_m), bend_r - bend_l
    saddle = bends - (ends_m + ends_m)
    residual = (along * along + across * across) * _EIGHTEENTH + twist * twist * _QUARTER
    residual += (fan * fan + tent * tent) * _TWELFTH + saddle * saddle * _THIRTY_SIXTH
    a, b = (sum_r - sum_l) * over_dx, (rises + rise_m) * over_dy
    square = a * a + b * b
    steepness = math.sqrt(square)
    steep = steepness > _ONE
    x = _ONE / steepness if steep else steepness
    y = x * x
    angle = x * (_A0 + y * (_A1 + y * (_A2 + y * (_A3 + y * (_A4 + y * (_A5 + y * _A6))))))
    slope = _QUARTER_TURN - angle if steep else angle
    upright = _ONE / (_ONE + square)
    own = (sums + ends_m) * _NINTH
    return slope, math.sqrt(residual * upright * _NINTH), abs(own) * math.sqrt(upright)


@kernel
def _fill_row(heights, first, cols, n, rule, out, at):
    """Weights of `n` cells of a row, none at the border, from index `first` on: NaN where a patch has a hole.

    Returns whether one has.
    """
    over_dx, over_dy = np.float32(1.0 / (6.0 * rule[DX])), np.float32(1.0 / (6.0 * rule[DY]))
    over_slope, over_roughness = np.float32(1.0 / rule[SLOPE_LIMIT]), np.float32(1.0 / rule[ROUGHNESS_LIMIT])
    over_step, scale = np.float32(1.0 / rule[STEP_LIMIT]), np.float32(rule[SCALE])
    slope_weight, roughness_weight = np.float32(rule[SLOPE_WEIGHT]), np.float32(rule[ROUGHNESS_WEIGHT])
    step_weight, hard_slope = np.float32(rule[STEP_WEIGHT]), np.float32(rule[HARD_SLOPE])
    hard_roughness, hard_step = np.float32(rule[HARD_ROUGHNESS]), np.float32(rule[HARD_STEP])
    top, bottom = first - cols, first + cols
    # a slice for each of the nine neighbours: indices that begin at 0 need no look for negative ones
    t0, t1, t2 = heights[top - 1 : top - 1 + n], heights[top : top + n], heights[top + 1 : top + 1 + n]
    m0, m1, m2 = heights[first - 1 : first - 1 + n], heights[first : first + n], heights[first + 1 : first + 1 + n]
    b0, b1, b2 = (
        heights[bottom - 1 : bottom - 1 + n],
        heights[bottom : bottom + n],
        heights[bottom + 1 : bottom + 1 + n],
    )
    row = out[at : at + n]
    for c in range(n):
        above, beside, below = (t0[c], t1[c], t2[c]), (m0[c], m1[c], m2[c]), (b0[c], b1[c], b2[c])
        slope, roughness, step = _whole_plane(above, beside, below, over_dx, over_dy)
        s, r, f = min(slope * over_slope, _ONE), min(roughness * over_roughness, _ONE), min(step * over_step, _ONE)
        t = min(slope_weight * s + roughness_weight * r + step_weight * f, _MOST)
        beyond = (slope > hard_slope) | (roughness > hard_roughness) | (step > hard_step)
        beyond |= (s >= _ONE) & (r >= _ONE) & (f >= _ONE)
        weight, terms = _INF if beyond else t * scale, slope + roughness + step
        row[c] = weight if terms - terms == _ZERO else _NAN
    holes = False
    for c in range(n):
        holes |= row[c] != row[c]
    return holes


@kernel
def _weight(heights, rows, cols, row, col, rule):
    """Weight of one cell, from whatever is known around it."""
    if not math.isfinite(heights[row * cols + col]):
        return np.float32(np.inf)
    slope, roughness, step = _moments_plane(heights, rows, cols, row, col, rule[DY], rule[DX])
    s, r = min(slope / rule[SLOPE_LIMIT], 1.0), min(roughness / rule[ROUGHNESS_LIMIT], 1.0)
    f = min(step / rule[STEP_LIMIT], 1.0)
    if slope > rule[HARD_SLOPE] or roughness > rule[HARD_ROUGHNESS] or step > rule[HARD_STEP]:
        return np.float32(np.inf)
    if s >= 1.0 and r >= 1.0 and f >= 1.0:
        return np.float32(np.inf)
    t = min(np.float32(rule[SLOPE_WEIGHT] * s + rule[ROUGHNESS_WEIGHT] * r + rule[STEP_WEIGHT] * f), _MOST)
    return t * np.float32(rule[SCALE])


@kernel
def fill_weights(heights, rows, cols, rule, area, out, first, stride):
    """Weights of a rectangle of cells, inf where impassable.

    Parameters
    ----------
    heights : (rows · cols,) float32
        Metres, row by row; NaN or infinite where unknown.
    rows, cols : int
        Of the map.
    rule : (RULE_SLOTS,) float64
        Sides of a cell, limits (the slope's in radians), weights, hard limits, and the weight of a cost of 1.
    area : (row0, row1, col0, col1)
        Of the map.
    out : (…,) float32
        Written: cell (row, col) at first + row · stride + col.
    first, stride : int
        See `out`.
    """
    row0, row1, col0, col1 = area
    inner0, inner1 = max(col0, 1), min(col1, cols - 1)
    for row in range(row0, row1):
        at = first + row * stride
        if row == 0 or row == rows - 1 or inner0 >= inner1:
            for col in range(col0, col1):
                out[at + col] = _weight(heights, rows, cols, row, col, rule)
            continue
        if col0 == 0:
            out[at] = _weight(heights, rows, cols, row, 0, rule)
        if col1 == cols:
            out[at + cols - 1] = _weight(heights, rows, cols, row, cols - 1, rule)
        if _fill_row(heights, row * cols + inner0, cols, inner1 - inner0, rule, out, at + inner0):
            for col in range(inner0, inner1):
                if math.isnan(out[at + col]):
                    out[at + col] = _weight(heights, rows, cols, row, col, rule)


@kernel
def count_saturated(heights, rows, cols, rule, first, step, counts):
    """Count, in every `step`-th row from `first` on, the known cells and those at the limit of each of the terms."""
    for row in range(first, rows, step):
        for col in range(cols):
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
