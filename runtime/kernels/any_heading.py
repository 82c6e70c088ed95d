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

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.poses import (
    CLEARANCE,
    MOST_CODE,
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


@kernel
def _height(source, row, col):
    """Height of a cell; as an unknown one's where it lies outside the map."""
    heights, shape = source[0], source[8]
    width, margin = shape[2], shape[3]
    i = min(max(row + margin, 0), shape[0] + 2 * margin - 1)
    j = min(max(col + margin, 0), shape[1] + margin)  # one beyond the last column is outside
    return np.float64(heights[i * width + j])


@kernel
def _cells_near(middle, ahead, half, sides):
    """Rows and columns that may lie near a rectangle, from the first up to but not including the second, in cells."""
    down = abs(ahead[0]) * half[0] + abs(ahead[1]) * half[1] + sides[0]
    right = abs(ahead[1]) * half[0] + abs(ahead[0]) * half[1] + sides[1]
    row0, row1 = math.ceil((middle[0] - down) / sides[0]), math.floor((middle[0] + down) / sides[0]) + 1
    col0, col1 = math.ceil((middle[1] - right) / sides[1]), math.floor((middle[1] + right) / sides[1]) + 1
    return np.int64(row0), np.int64(row1), np.int64(col0), np.int64(col1)


@kernel
def _lies_near(down, right, ahead, half, sides):
    """Whether a cell's middle, so far from a rectangle's, lies less than a cell from it, as `vehicle.footprint`."""
    along = abs(ahead[0]) * sides[0] + abs(ahead[1]) * sides[1]
    across = abs(ahead[1]) * sides[0] + abs(ahead[0]) * sides[1]
    inside = abs(down * ahead[0] + right * ahead[1]) < half[0] + along - _INSIDE * sides[0]
    return inside and abs(right * ahead[0] - down * ahead[1]) < half[1] + across - _INSIDE * sides[0]


@kernel
def pose_cost(body, row, col, ahead, sweep):
    """T of a pose at a place, with a heading (down, right) of length 1 in metres; inf where it fails.

    `sweep` is how far it stands for the ground before and behind it, in metres.
    """
    poses, wheels, sizes = body
    source = poses[2]
    gradients, limits = source[4], source[5]
    sides = sizes[4], sizes[5]
    at = row * sides[0], col * sides[1]
    count = len(wheels)
    lows, highs = np.empty(count), np.empty(count)
    pitch, roll, step = 0.0, 0.0, 0.0
    more_pitch, more_roll = 0.0, 0.0
    half = sizes[0] + sweep, sizes[1]
    for w in range(count):
        middle = (
            at[0] + wheels[w, 0] * ahead[0] - wheels[w, 1] * ahead[1],
            at[1] + wheels[w, 0] * ahead[1] + wheels[w, 1] * ahead[0],
        )
        low, high = np.inf, -np.inf
        row0, row1, col0, col1 = _cells_near(middle, ahead, half, sides)
        for i in range(row0, row1):
            for j in range(col0, col1):
                if _lies_near(i * sides[0] - middle[0], j * sides[1] - middle[1], ahead, half, sides):
                    there = _height(source, i, j)
                    low, high = min(low, there) if there == there else low, max(high, there) if there == there else high
        if not abs(low) < np.inf or not abs(high) < np.inf:
            return np.inf
        lows[w], highs[w] = low, high
        middle_height, spread = 0.5 * (low + high), 0.5 * (high - low)
        pitch += gradients[1, w] * middle_height
        roll += gradients[2, w] * middle_height
        more_pitch += gradients[3, w] * spread
        more_roll += gradients[4, w] * spread
        step = max(step, high - low)
    pitch, roll = abs(pitch) + more_pitch, abs(roll) + more_roll
    tilt = math.atan(math.sqrt(pitch * pitch + roll * roll))
    if pitch > limits[PITCH] or roll > limits[ROLL] or tilt > limits[TILT] or step > limits[STEP]:
        return np.inf
    rise = _lift(body, at, ahead, sweep, lows, highs) + sweep * pitch
    rise = max(rise, 0.0)
    if not rise <= limits[CLEARANCE]:
        return np.inf
    cost = limits[TILT_WEIGHT] / limits[TILT] * tilt + limits[RISE_WEIGHT] / limits[CLEARANCE] * rise
    return min(cost + limits[STEP_WEIGHT] / limits[STEP] * step, 1.0)


@kernel
def _lift(body, at, ahead, sweep, lows, highs):
    """How far the ground under the body comes above the lowest that the wheels' plane can be there."""
    poses, _, sizes = body
    source, sides = poses[2], (sizes[4], sizes[5])
    gradients = source[4]
    half = sizes[2] + sweep, sizes[3]
    rise = -np.inf
    row0, row1, col0, col1 = _cells_near(at, ahead, half, sides)
    for i in range(row0, row1):
        for j in range(col0, col1):
            down, right = i * sides[0] - at[0], j * sides[1] - at[1]
            if not _lies_near(down, right, ahead, half, sides):
                continue
            there = _height(source, i, j)
            if there != there:
                continue
            along, across = down * ahead[0] + right * ahead[1], right * ahead[0] - down * ahead[1]
            plane = 0.0
            for w in range(len(lows)):
                share = gradients[0, w] + along * gradients[1, w] + across * gradients[2, w]
                plane += share * (lows[w] if share > 0.0 else highs[w])
            rise = max(rise, there - plane)
    return rise


@kernel
def _grid_leg(body, stride, row, col, to_row, to_col):
    """Mean weight along a leg of whole steps of the grid, by the poses that its search goes by; -1 if it is none."""
    rows, cols = to_row - row, to_col - col
    count = np.int64(max(abs(rows), abs(cols)) + 0.5)
    whole = abs(row - round(row)) < _ON_GRID and abs(col - round(col)) < _ON_GRID
    whole = whole and abs(to_row - round(to_row)) < _ON_GRID and abs(to_col - round(to_col)) < _ON_GRID
    straight = abs(rows) < _ON_GRID or abs(cols) < _ON_GRID or abs(abs(rows) - abs(cols)) < _ON_GRID
    if count == 0 or not whole or not straight:
        return -1.0
    up, left = np.int64(round(rows / count)), np.int64(round(cols / count))
    heading = 0 if left == 0 else (2 if up == 0 else (1 if up == left else 3))
    first = (np.int64(round(row)) + 1) * stride + np.int64(round(col)) + 1
    total = 0.0
    for k in range(count + 1):
        node = first + k * (up * stride + left)
        weight = np.float64(weight_of_pose(body[0], node, stride, heading))
        total += 0.5 * weight if k in (0, count) else weight
    return total / count


@kernel
def body_leg_cost(body, grid, row, col, to_row, to_col):
    """The line integral along a leg whose poses all stand, by the mean of what they cost; inf where one fails."""
    stride, steps = grid[1], grid[2]
    rows, cols = to_row - row, to_col - col
    length = math.sqrt(rows * rows + cols * cols)
    weight = _grid_leg(body, stride, row, col, to_row, to_col)
    if weight >= 0.0:
        return length * (steps[0] + 2.0 * steps[2] * weight)
    if length == 0.0:
        return 0.0
    sizes, unit = body[2], np.float64(body[0][1])
    down, right = rows * sizes[4], cols * sizes[5]
    metres = math.sqrt(down * down + right * right)
    poses = np.int64(math.ceil(POSES_PER_CELL * length)) + 1
    sweep, total = 0.5 * metres / (poses - 1), 0.0
    for k in range(poses):
        share = k / (poses - 1)
        cost = pose_cost(body, row + share * rows, col + share * cols, (down / metres, right / metres), sweep)
        if cost == np.inf:
            return np.inf
        total += 0.5 * cost if k in (0, poses - 1) else cost
    return length * (steps[0] + 2.0 * steps[2] * (total / (poses - 1) * MOST_CODE * unit))


@kernel
def body_line_cost(body, grid, points):
    """As `kernels.any_angle.line_cost`, of a body."""
    total = 0.0
    for k in range(len(points) - 1):
        total += body_leg_cost(body, grid, points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1])
        if total == np.inf:
            break
    return total


@kernel
def weigh_band(body, stride, path, radius, every, weights):
    """Write the weights of poses near a path, in the heading in which it leads there; the rest stays as it is."""
    source = body[0][2]
    last_row, last_col = source[8][0], source[8][1]
    for k in range(0, len(path), every):
        a, b = max(k - every, 0), min(k + every, len(path) - 1)
        up, left = path[b, 0] - path[a, 0], path[b, 1] - path[a, 1]
        if abs(up) > 2.4 * abs(left):
            heading = 0
        elif abs(left) > 2.4 * abs(up):
            heading = 2
        else:
            heading = 1 if (up > 0) == (left > 0) else 3
        for i in range(max(path[k, 0] - radius, 0), min(path[k, 0] + radius + 1, last_row)):
            for j in range(max(path[k, 1] - radius, 0), min(path[k, 1] + radius + 1, last_col)):
                node = (i + 1) * stride + j + 1
                if weights[node] == np.inf:
                    weights[node] = weight_of_pose(body[0], node, stride, heading)


@kernel
def clear_band(stride, path, radius, every, shape, weights):
    """Undo `weigh_band`."""
    for k in range(0, len(path), every):
        for i in range(max(path[k, 0] - radius, 0), min(path[k, 0] + radius + 1, shape[0])):
            for j in range(max(path[k, 1] - radius, 0), min(path[k, 1] + radius + 1, shape[1])):
                weights[(i + 1) * stride + j + 1] = np.inf
