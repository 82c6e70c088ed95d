"""The check of a body at any place and heading, along the legs of a path freed from the grid. See `kernels.poses`.

A pose stands for those before and behind it, to the next poses of its leg: the heights under a wheel, and the ground
below the body, are those that they can touch anywhere there. So nothing between two poses is left out.

The kernels are given `body`, a tuple (poses, wheels, sizes):

    poses      as the kernels of `poses` take them
    wheels     (W, 2) float64, metres: middles of the contact patches, ahead of the body's middle and to its left
    sizes      (6,) float64, metres: half a contact patch's length and width, half the body's, a cell's height, width
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.by_address import borrowed
from nnpp_edge.runtime.kernels.pose_weights import body_weight_at, headings_of
from nnpp_edge.runtime.kernels.poses import (
    CLEARANCE,
    PITCH,
    RISE_WEIGHT,
    ROLL,
    STEP,
    STEP_WEIGHT,
    TILT,
    TILT_WEIGHT,
    weight_of_pose,
)

POSES_PER_CELL = 2.0
"""Poses that are checked for each cell's length of a leg."""
_ON_GRID = 1e-9
_INSIDE = 1e-9


@helper
def under_body(body):
    """All that the check reads, references to which are not counted: as a call with `body` would, for every pose."""
    poses, wheels, sizes = body
    source = poses[2]
    shape = source[8]
    return (
        (borrowed(source[0]), shape[0] + 2 * shape[3], shape[1] + 2 * shape[3], shape[2], shape[3]),
        (borrowed(source[4]), borrowed(source[5])),
        borrowed(wheels),
        (sizes[0], sizes[1], sizes[2], sizes[3]),
        (sizes[4], sizes[5]),
    )


@helper
def _rows_near(middle, ahead, half, sides):
    """The first row whose cells may lie near a rectangle, and the one after the last."""
    down = abs(ahead[0]) * half[0] + abs(ahead[1]) * half[1] + sides[0] * (1.0 - _INSIDE)
    row0, row1 = math.ceil((middle[0] - down) / sides[0]), math.floor((middle[0] + down) / sides[0]) + 1
    return np.int64(row0), np.int64(row1)


@helper
def _cols_near(down, middle, ahead, half, sides):
    """Of a row so far below a rectangle's middle: the first cell whose middle lies less than a cell from the
    rectangle, along rows and along columns, and the one after the last; see `terrain.vehicle`.
    """
    along = half[0] + abs(ahead[0]) * sides[0] + abs(ahead[1]) * sides[1] - _INSIDE * sides[0]
    across = half[1] + abs(ahead[1]) * sides[0] + abs(ahead[0]) * sides[1] - _INSIDE * sides[0]
    reach = abs(ahead[1]) * half[0] + abs(ahead[0]) * half[1] + sides[1] * (1.0 - _INSIDE)
    low, high = -reach, reach
    if abs(ahead[1]) > _INSIDE:
        first, last = (-along - down * ahead[0]) / ahead[1], (along - down * ahead[0]) / ahead[1]
        low, high = max(low, min(first, last)), min(high, max(first, last))
    if abs(ahead[0]) > _INSIDE:
        first, last = (-across + down * ahead[1]) / ahead[0], (across + down * ahead[1]) / ahead[0]
        low, high = max(low, min(first, last)), min(high, max(first, last))
    return np.int64(math.ceil((middle[1] + low) / sides[1])), np.int64(math.floor((middle[1] + high) / sides[1])) + 1


@helper
def _line_at(ground, row, col0, col1):
    """Where a row's cells lie among the heights; those outside the padded map are moved onto its rim, as unknown."""
    heights, high, wide, width, margin = ground
    first = min(max(row + margin, 0), high - 1) * width
    begin, end = min(max(col0 + margin, 0), wide - 1), min(max(col1 + margin, 1), wide)
    return first + begin, first + max(end, begin + 1)


@helper
def _stand_on_wheels(under, at, ahead, sweep, contacts):
    """Write the least and greatest height under each wheel; the greatest pitch and roll, as gradients, and step."""
    ground, (gradients, _), wheels, halves, sides = under
    heights = ground[0]
    half = halves[0] + sweep, halves[1]
    pitch, roll, more_pitch, more_roll, step = 0.0, 0.0, 0.0, 0.0, 0.0
    for w in range(len(wheels)):
        middle = (
            at[0] + wheels[w, 0] * ahead[0] - wheels[w, 1] * ahead[1],
            at[1] + wheels[w, 0] * ahead[1] + wheels[w, 1] * ahead[0],
        )
        low, high = np.float32(np.inf), np.float32(-np.inf)
        row0, row1 = _rows_near(middle, ahead, half, sides)
        for i in range(row0, row1):
            col0, col1 = _cols_near(i * sides[0] - middle[0], middle, ahead, half, sides)
            if col0 < col1:
                first, last = _line_at(ground, i, col0, col1)
                for n in range(first, last):
                    there = heights[np.uint64(n)]
                    low = there if there < low else low
                    high = there if there > high else high
        contacts[0, w], contacts[1, w] = low, high
        middle_height, spread = 0.5 * (np.float64(low) + high), 0.5 * (np.float64(high) - low)
        pitch += gradients[1, w] * middle_height
        roll += gradients[2, w] * middle_height
        more_pitch += gradients[3, w] * spread
        more_roll += gradients[4, w] * spread
        step = max(step, 2.0 * spread)
        if not 0.0 <= spread < np.inf:
            return np.inf, np.inf, np.inf
    return abs(pitch) + more_pitch, abs(roll) + more_roll, step


@helper
def _lift(under, at, ahead, sweep, contacts):
    """How far the ground under the body comes above the lowest that the wheels' plane can be there.

    At a place the plane's height is a sum of the wheels' heights, each with its share, which is linear in the place:
    at its least it is that of the middle heights less every spread times its share without sign.
    """
    ground, (gradients, _), wheels, halves, sides = under
    heights, margin = ground[0], ground[4]
    half = halves[2] + sweep, halves[3]
    level, along, across = 0.0, 0.0, 0.0
    for w in range(len(wheels)):
        middle_height = 0.5 * (contacts[0, w] + contacts[1, w])
        level += gradients[0, w] * middle_height
        along += gradients[1, w] * middle_height
        across += gradients[2, w] * middle_height
    rise = -np.inf
    row0, row1 = _rows_near(at, ahead, half, sides)
    for i in range(row0, row1):
        down = i * sides[0] - at[0]
        col0, col1 = _cols_near(down, at, ahead, half, sides)
        if col0 >= col1:
            continue
        first, last = _line_at(ground, i, col0, col1)
        shift = max(col0, -margin)
        for n in range(first, last):
            right = (shift + n - first) * sides[1] - at[1]
            ahead_m, left_m = down * ahead[0] + right * ahead[1], right * ahead[0] - down * ahead[1]
            plane = level + ahead_m * along + left_m * across
            for w in range(len(wheels)):
                share = gradients[0, w] + ahead_m * gradients[1, w] + left_m * gradients[2, w]
                plane -= abs(share) * 0.5 * (contacts[1, w] - contacts[0, w])
            above = heights[np.uint64(n)] - plane
            rise = above if above > rise else rise
    return rise


@helper
def pose_cost(under, row, col, ahead, sweep, contacts):
    """T of a pose at a place, with a heading (down, right) of length 1 in metres; inf where it fails.

    `sweep` is how far it stands for the ground before and behind it, in metres; `contacts` scratch, (2, W) float64.
    """
    limits, sides = under[1][1], under[4]
    at = row * sides[0], col * sides[1]
    pitch, roll, step = _stand_on_wheels(under, at, ahead, sweep, contacts)
    tilt = math.atan(math.sqrt(pitch * pitch + roll * roll))
    if not (pitch <= limits[PITCH] and roll <= limits[ROLL] and tilt <= limits[TILT] and step <= limits[STEP]):
        return np.inf
    rise = max(_lift(under, at, ahead, sweep, contacts) + sweep * pitch, 0.0)
    if not rise <= limits[CLEARANCE]:
        return np.inf
    cost = limits[TILT_WEIGHT] / limits[TILT] * tilt + limits[RISE_WEIGHT] / limits[CLEARANCE] * rise
    return min(cost + limits[STEP_WEIGHT] / limits[STEP] * step, 1.0)


@kernel
def stands_along(body, points):
    """(4, N) how a body stands at places (N, 2), each left for the next, the last as it is arrived at.

    Places lie as the check of their legs has them: each pose stands for half of the way to the next place.
    Gradients along and across of the plane of the wheels in the middle of their heights' ranges, nose and left side
    up positive; that of the greatest tilt; and the least clearance, all as for a leg's poses. NaN where unknown.
    """
    under, contacts, sides = under_body(body), np.empty((2, len(body[1]))), body[2][4:]
    gradients, limits = under[1]
    n, found = len(points), np.empty((4, len(points)))
    ahead, sweep = (1.0, 0.0), 0.0
    for k in range(n):
        if k < n - 1:
            rows, cols = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
            down, right = rows * sides[0], cols * sides[1]
            metres = math.sqrt(down * down + right * right)
            if metres > 0.0:
                ahead = down / metres, right / metres
                sweep = 0.5 * metres
        at = points[k, 0] * sides[0], points[k, 1] * sides[1]
        pitch, roll, _ = _stand_on_wheels(under, at, ahead, sweep, contacts)
        if pitch == np.inf:
            found[:, k] = np.nan
            continue
        along, across = 0.0, 0.0
        for w in range(contacts.shape[1]):
            middle = 0.5 * (contacts[0, w] + contacts[1, w])
            along += gradients[1, w] * middle
            across += gradients[2, w] * middle
        found[0, k], found[1, k], found[2, k] = along, across, math.sqrt(pitch * pitch + roll * roll)
        found[3, k] = limits[CLEARANCE] - max(_lift(under, at, ahead, sweep, contacts) + sweep * pitch, 0.0)
    return found


@helper
def _steps_of_grid(row, col, to_row, to_col):
    """How many steps of the grid a leg consists of; 0 where it is another."""
    rows, cols = to_row - row, to_col - col
    whole = abs(row - round(row)) < _ON_GRID and abs(col - round(col)) < _ON_GRID
    whole = whole and abs(to_row - round(to_row)) < _ON_GRID and abs(to_col - round(to_col)) < _ON_GRID
    straight = abs(rows) < _ON_GRID or abs(cols) < _ON_GRID or abs(abs(rows) - abs(cols)) < _ON_GRID
    return np.int64(max(abs(rows), abs(cols)) + 0.5) if whole and straight else 0


@helper
def _stands_on_grid(poses, stride, row, col, to_row, to_col, count):
    """Whether the poses that the search goes by pass on all cells of a leg of whole steps."""
    up, left = np.int64(round((to_row - row) / count)), np.int64(round((to_col - col) / count))
    heading = 0 if left == 0 else (2 if up == 0 else (1 if up == left else 3))
    first = (np.int64(round(row)) + 1) * stride + np.int64(round(col)) + 1
    for k in range(count + 1):
        if weight_of_pose(poses, first + k * (up * stride + left), stride, heading) == np.inf:
            return False
    return True


@helper
def stands_on_leg(under, contacts, body, stride, ends):
    """Whether the body can follow a leg (row, col, row, col).

    A leg of whole steps of the grid passes where the poses do that the search goes by; any other is checked at its
    own places and heading. `under` is `under_body`'s, `contacts` scratch, (2, W) float64.
    """
    row, col, to_row, to_col = ends
    rows, cols = to_row - row, to_col - col
    count = _steps_of_grid(row, col, to_row, to_col)
    if count > 0:
        return _stands_on_grid(body[0], stride, row, col, to_row, to_col, count)
    down, right = rows * under[4][0], cols * under[4][1]
    metres, count = math.sqrt(down * down + right * right), _poses_along(rows, cols)
    ahead = down / metres, right / metres
    for k in range(count + 1):
        at = row + k / count * rows, col + k / count * cols
        if pose_cost(under, at[0], at[1], ahead, 0.5 * metres / count, contacts) == np.inf:
            return False
    return True


@helper
def _poses_along(rows, cols):
    return np.int64(math.ceil(POSES_PER_CELL * math.sqrt(rows * rows + cols * cols)))


@kernel
def places_on_leg(row, col, to_row, to_col):
    """Into how many equal parts the check of a leg divides it: it stands at their ends."""
    count = _steps_of_grid(row, col, to_row, to_col)
    return count if count > 0 else max(_poses_along(to_row - row, to_col - col), 1)


@helper
def body_leg_price(poses, grid, ends):
    """The line integral along a leg (row, col, row, col), by the weights at its poses, whether or not they pass."""
    row, col, to_row, to_col = ends
    steps, rows, cols = grid[2], to_row - row, to_col - col
    count, headings, total = _steps_of_grid(row, col, to_row, to_col), headings_of(rows, cols), 0.0
    count = count if count > 0 else _poses_along(rows, cols)
    for k in range(count + 1):
        weight = body_weight_at(poses, grid[1], row + k / count * rows, col + k / count * cols, headings)
        total += 0.5 * weight if k in (0, count) else weight
    return math.sqrt(rows * rows + cols * cols) * (steps[0] + 2.0 * steps[2] * total / count)


@helper
def body_leg_cost(body, grid, row, col, to_row, to_col):
    """The line integral along a leg, by the weights at its poses; inf where one of them fails."""
    if row == to_row and col == to_col:
        return 0.0
    ends = row, col, to_row, to_col
    if not stands_on_leg(under_body(body), np.empty((2, len(body[1]))), body, grid[1], ends):
        return np.inf
    return body_leg_price(body[0], grid, ends)


@kernel
def body_line_cost(body, grid, points):
    """As `kernels.any_angle.line_cost`, of a body."""
    total = 0.0
    for k in range(len(points) - 1):
        total += body_leg_cost(body, grid, points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1])
        if total == np.inf:
            break
    return total
