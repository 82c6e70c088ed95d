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
from numpy import float32, float64, inf, nan, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.lanes import chosen
from nnpp_edge.runtime.kernels.nodes import rows_around
from nnpp_edge.runtime.kernels.records import Area, CostFactors, HeightsRecord, Spans, Terms

TERMS = len(Terms._fields)
PAPER_TERMS = 3
"""The first of them are the paper's: where all of these are full there is an obstacle."""
DY = 0
DX = 1
SCALE = 2
HARD_GRADIENT = 3
INVERSE_LIMITS = 4
WEIGHTS = INVERSE_LIMITS + TERMS
HARD_LIMITS = WEIGHTS + TERMS
RULE_SLOTS = HARD_LIMITS + TERMS
"""Slots of the array of floats that says how heights become costs: sides of a cell, weight of a
cost of 1, greatest rise of a step, and then three runs with a number for each of `Terms`.
"""

_ONE = float32(1.0)
_ZERO = float32(0.0)
_INF = float32(inf)
_NAN = float32(nan)
_1 = uint64(1)
_2 = uint64(2)
_QUARTER_TURN = float32(0.5 * math.pi)
MOST_COST = np.nextafter(_ONE, _ZERO)
"""The greatest cost below 1."""
_A0 = float32(0.9999961115277097)
_A1 = float32(-0.33317367990706626)
_A2 = float32(0.1980781503586841)
_A3 = float32(-0.1323334023607846)
_A4 = float32(0.07962364075672511)
_A5 = float32(-0.03360419486579314)
_A6 = float32(0.006811785276088361)
"""Of the odd polynomial of degree 13 that is nowhere in [0, 1] more than 2.5e-7 from the arc
tangent.
"""
_THIRD = float32(1 / 3)
_QUARTER = float32(1 / 4)
_SIXTH = float32(1 / 6)
_NINTH = float32(1 / 9)
_TWELFTH = float32(1 / 12)
_EIGHTEENTH = float32(1 / 18)
_THIRTY_SIXTH = float32(1 / 36)


# Terms


@inlined
def _height(ground, row, col):
    """Height of a cell; NaN where it is unknown, and off the map."""
    inside = 0 <= row < ground.rows and 0 <= col < ground.cols
    height = ground.heights[row * ground.cols + col] if inside else _NAN
    return height if abs(height) < _INF else _NAN


@inlined
def _three(ground, row, col):
    """Heights of a cell and of its neighbours in its row."""
    return _height(ground, row, col - 1), _height(ground, row, col), _height(ground, row, col + 1)


@helper
def _patch_at(ground, row, col):
    """The patch of a cell: three rows of three heights, NaN where unknown."""
    return _three(ground, row - 1, col), _three(ground, row, col), _three(ground, row + 1, col)


@inlined
def _sums(patch, dy, dx):
    """Number of the known cells of a patch, and sums over their places x and y, in metres from its
    middle, and heights z above it: of each, and of their products.
    """
    here = float64(patch[1][1])
    n = 0.0
    sx = sy = sz = sxx = sxy = syy = sxz = syz = szz = 0.0
    for i in range(3):
        for j in range(3):
            z = float64(patch[i][j]) - here
            if not math.isfinite(z):
                continue
            x = (j - 1) * dx
            y = (i - 1) * dy
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
    return n, sx, sy, sz, sxx, sxy, syy, sxz, syz, szz


@helper
def _moments_plane(patch, dy, dx):
    """Terms of a known cell, from the known cells of its patch."""
    n, sx, sy, sz, sxx, sxy, syy, sxz, syz, szz = _sums(patch, dy, dx)
    # moments about the patch's mean point
    sxx -= sx * sx / n
    sxy -= sx * sy / n
    syy -= sy * sy / n
    sxz -= sx * sz / n
    syz -= sy * sz / n
    szz -= sz * sz / n
    # gradients of the plane
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
    roughness = math.sqrt(residual / n) * upright
    return Terms(math.atan(steepness), roughness, abs(own) * upright)


@helper
def arc_tangent(x):
    """Of a float32 from 0 up, or of a run of them, within 2.5e-7."""
    steep = x > _ONE
    x = chosen(steep, _ONE / x, x)
    y = x * x
    inner = _A3 + y * (_A4 + y * (_A5 + y * _A6))
    angle = x * (_A0 + y * (_A1 + y * (_A2 + y * inner)))
    return chosen(steep, _QUARTER_TURN - angle, angle)


@helper
def _of_plane(a, b, variance, own):
    """Terms by a plane's gradients, all float32.

    `variance` is the mean square of the patch's vertical distances from it, `own` the cell's own.
    """
    square = a * a + b * b
    upright = _ONE / (_ONE + square)
    roughness = math.sqrt(variance * upright)
    return Terms(arc_tangent(math.sqrt(square)), roughness, abs(own) * math.sqrt(upright))


@helper
def _whole_plane(top, middle, bottom, over):
    """Terms of a cell all of whose patch is known, three rows of three; not finite where it is not.

    `over` are 1 / (6 dx) and 1 / (6 dy). Each column's sum, difference of its ends and curvature
    (top - 2 middle + bottom), and then the same three of those along the row.
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
    by_x = (sum_r - sum_l) * over.along
    by_y = (rises + rise_m) * over.across
    return _of_plane(by_x, by_y, residual * _NINTH, (sums + ends_m) * _NINTH)


@helper
def _side_plane(side, beside, over):
    """Terms of a cell at a side of the map, of whose patch there are the three cells of the side
    and three beside.

    `over` are 1 / (4 d) and 1 / (3 d) of the distances of cells along the side and across it. Each
    pair's sum and rise, and of those along the side their mean, difference of the ends and
    curvature.
    """
    side_l, side_m, side_r = side
    beside_l, beside_m, beside_r = beside
    side_l = side_l - side_m
    side_r = side_r - side_m
    beside_l = beside_l - side_m
    beside_m = beside_m - side_m
    beside_r = beside_r - side_m
    rise_l = beside_l - side_l
    rise_r = beside_r - side_r
    rises = rise_l + rise_r
    sum_l = side_l + beside_l
    sum_r = side_r + beside_r
    curve = sum_l + sum_r - (beside_m + beside_m)
    twist = rise_r - rise_l
    fan = rises - (beside_m + beside_m)
    residual = (curve * curve + fan * fan) * _TWELFTH + twist * twist * _QUARTER
    own = (side_l + side_r) * _THIRD
    along = (sum_r - sum_l) * over.along
    return _of_plane(along, (rises + beside_m) * over.across, residual * _SIXTH, own)


# Weights


@helper
def _of_rule(rule, first):
    """A run of a rule's slots, from `first` on."""
    return Terms(float32(rule[first]), float32(rule[first + 1]), float32(rule[first + 2]))


@helper
def _factors(rule):
    """`CostFactors` of a rule."""
    dy = rule[DY]
    dx = rule[DX]
    inverse = _of_rule(rule, INVERSE_LIMITS)
    weights = _of_rule(rule, WEIGHTS)
    hard = _of_rule(rule, HARD_LIMITS)
    whole = Spans(float32(1.0 / (6.0 * dx)), float32(1.0 / (6.0 * dy)))
    by_row = Spans(float32(0.25 / dx), float32(1.0 / (3.0 * dy)))
    by_col = Spans(float32(0.25 / dy), float32(1.0 / (3.0 * dx)))
    return CostFactors(inverse, weights, hard, float32(rule[SCALE]), whole, by_row, by_col)


@helper
def _of_terms(terms, factors):
    """Weight of a cell by Eq. 1, inf where impassable; NaN where a term is not finite."""
    t = total = _ZERO
    beyond = False
    full = True
    for n in range(TERMS):
        term = float32(terms[n])
        share = min(term * factors.inverse[n], _ONE)
        t += factors.weights[n] * share
        total += term
        beyond |= term > factors.hard[n]
        full &= share >= _ONE or n >= PAPER_TERMS
    t = min(t, MOST_COST)
    weight = _INF if beyond | full else t * factors.scale
    return weight if total - total == _ZERO else _NAN


@helper
def _fill_row(heights, first, cols, n, factors, out):
    """Weights of `n` cells of a row, neither the map's first nor its last, from index `first` on:
    NaN beside a hole.

    Returns whether there is a hole. Cells at the border are to be weighed anew.
    """
    above, beside, below = rows_around(heights, first, cols, n)
    for c in range(n):
        left = uint64(c)
        mid = left + _1
        right = left + _2
        top = (above[left], above[mid], above[right])
        middle = (beside[left], beside[mid], beside[right])
        bottom = (below[left], below[mid], below[right])
        out[left] = _of_terms(_whole_plane(top, middle, bottom, factors.whole), factors)
    holes = False
    for c in range(n):
        holes |= out[c] != out[c]
    return holes


@helper
def _weight(patch, rule, factors):
    """Weight of the middle of a patch, from whatever is known of that."""
    if not math.isfinite(patch[1][1]):
        return _INF
    weight = _of_terms(_moments_plane(patch, rule[DY], rule[DX]), factors)
    return _INF if math.isnan(weight) else weight


@helper
def _steps_steeply(ground, row, col, rule):
    """Whether a step from a cell's middle to that of a known neighbour is too steep."""
    here = ground.heights[row * ground.cols + col]
    for i in range(max(row - 1, 0), min(row + 2, ground.rows)):
        for j in range(max(col - 1, 0), min(col + 2, ground.cols)):
            apart = math.hypot((i - row) * rule[DY], (j - col) * rule[DX])
            rise = abs(ground.heights[i * ground.cols + j] - here)
            if rise > float32(rule[HARD_GRADIENT] * apart) and rise < _INF:
                return True
    return False


@helper
def _border_weight(ground, row, col, rule, factors):
    """Weight of a cell at the border, faster where its patch has no hole."""
    heights = ground.heights
    rows = ground.rows
    cols = ground.cols
    if rule[HARD_GRADIENT] < inf and _steps_steeply(ground, row, col, rule):
        return _INF
    at = row * cols + col
    if 0 < col < cols - 1 and rows > 1:
        along = 1
        across = cols if row == 0 else -cols
        over = factors.by_row
    elif 0 < row < rows - 1 and cols > 1:
        along = cols
        across = 1 if col == 0 else -1
        over = factors.by_col
    else:
        return _weight(_patch_at(ground, row, col), rule, factors)
    side = (heights[at - along], heights[at], heights[at + along])
    other = at + across
    beside = (heights[other - along], heights[other], heights[other + along])
    weight = _of_terms(_side_plane(side, beside, over), factors)
    return _weight(_patch_at(ground, row, col), rule, factors) if math.isnan(weight) else weight


@helper
def _too_high(rise, highest):
    """Whether a rise, or each of a run of them, is known and too high."""
    return (abs(rise) > highest) & (abs(rise) < _INF)


@helper
def _shut_steep_steps(heights, first, cols, n, rule, weights):
    """Shut those of `n` cells of a row, from index `first` on, from which a step is too steep.

    Neither the row nor any of the cells lies at the map's border.
    """
    above, beside, below = rows_around(heights, first, cols, n)
    along = float32(rule[HARD_GRADIENT] * rule[DX])
    across = float32(rule[HARD_GRADIENT] * rule[DY])
    diagonal = float32(rule[HARD_GRADIENT] * math.hypot(rule[DY], rule[DX]))
    for c in range(n):
        left = uint64(c)
        mid = left + _1
        right = left + _2
        here = beside[mid]
        steep = _too_high(beside[left] - here, along) | _too_high(beside[right] - here, along)
        steep |= _too_high(above[mid] - here, across) | _too_high(below[mid] - here, across)
        steep |= _too_high(above[left] - here, diagonal) | _too_high(above[right] - here, diagonal)
        steep |= _too_high(below[left] - here, diagonal) | _too_high(below[right] - here, diagonal)
        weights[left] = _INF if steep else weights[left]


@kernel
def fill_weights(heights, rows, cols, rule, area: Area, out, first, stride):
    """Weights of a rectangle of cells, inf where impassable.

    Parameters
    ----------
    heights, rows, cols
        `HeightsRecord`.
    rule : (RULE_SLOTS,) float64
        `Traversability.rule`.
    area
        `Area`.
    out : (…,) float32
        Written: cell (row, col) at `first` + row · `stride` + col.
    """
    ground = HeightsRecord(heights, rows, cols)
    col0 = area.col0
    col1 = area.col1
    inner0 = max(col0, 1)
    inner1 = min(col1, cols - 1)
    factors = _factors(rule)
    for row in range(area.row0, area.row1):
        at = first + row * stride
        if row == 0 or row == rows - 1 or inner0 >= inner1:
            for col in range(col0, col1):
                out[at + col] = _border_weight(ground, row, col, rule, factors)
            continue
        # with the cells at the border, where their neighbours' places are in memory: whole rows of
        # tiles are quicker
        begin = inner0 if row == 1 else col0
        end = inner1 if row == rows - 2 else col1
        line = out[at + begin : at + end]
        if _fill_row(heights, row * cols + begin, cols, end - begin, factors, line):
            for col in range(inner0, inner1):
                if math.isnan(out[at + col]):
                    out[at + col] = _weight(_patch_at(ground, row, col), rule, factors)
        if rule[HARD_GRADIENT] < inf:
            line = out[at + inner0 : at + inner1]
            n = inner1 - inner0
            _shut_steep_steps(heights, row * cols + inner0, cols, n, rule, line)
        if col0 == 0:
            out[at] = _border_weight(ground, row, 0, rule, factors)
        if col1 == cols:
            out[at + cols - 1] = _border_weight(ground, row, cols - 1, rule, factors)


@kernel
def fill_terms(heights, rows, cols, dy, dx, apart, out):
    """`Terms` of cells into `out` (N, h, w) float64, NaN where unknown; of each, or of a sample.

    `apart` are the rows and the columns from one cell of the sample to the next.
    """
    ground = HeightsRecord(heights, rows, cols)
    rows_apart, cols_apart = apart
    for i in range(out.shape[1]):
        for j in range(out.shape[2]):
            row = rows_apart // 2 + i * rows_apart
            patch = _patch_at(ground, row, cols_apart // 2 + j * cols_apart)
            if not math.isfinite(patch[1][1]):
                out[:, i, j] = nan
                continue
            terms = _moments_plane(patch, dy, dx)
            for n in range(TERMS):
                out[n, i, j] = terms[n]
