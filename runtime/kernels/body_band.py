"""What the poses of the grid weigh between cells and headings, and near a path. See `kernels.any_heading`."""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.poses import FAILS, MOST_CODE, UNCHECKED, check_there, pose_weight


@kernel
def _headings_of(rows, cols):
    """Numbers of the straight and the diagonal heading beside a direction, and the diagonal one's share."""
    straight = 0 if abs(rows) >= abs(cols) else 2
    diagonal = 1 if (rows > 0.0) == (cols > 0.0) else 3
    return straight, diagonal, min(abs(rows), abs(cols)) / max(abs(rows), abs(cols))


@kernel
def _mean_of_cells(poses, stride, row, col, heading):
    """Mean weight in a heading of the cells around a place, but those where it fails; -1 where it does in all."""
    codes, unit, source, _ = poses
    i, j = np.int64(math.floor(row)), np.int64(math.floor(col))
    total, shares = 0.0, 0.0
    for k in range(4):
        down, right = k >> 1, k & 1
        share = (row - i if down else 1.0 - row + i) * (col - j if right else 1.0 - col + j)
        if share <= 1e-9:
            continue
        node = (i + down + 1) * stride + j + right + 1
        if codes[node, heading] == UNCHECKED:
            check_there(poses, i + down, j + right, heading)
        if codes[node, heading] != FAILS:
            total += share * pose_weight(codes[node, heading], unit)
            shares += share
    return total / shares if shares > 0.0 else -1.0


@kernel
def body_weight_at(poses, stride, row, col, rows, cols):
    """Weight at a place in the direction (rows, cols): the mean of the grid's poses around it and of two headings.

    Poses that fail are left out; where all do, as if T were 1.
    """
    straight, diagonal, share = _headings_of(rows, cols)
    one = _mean_of_cells(poses, stride, row, col, straight) if share < 1.0 else -1.0
    other = _mean_of_cells(poses, stride, row, col, diagonal) if share > 0.0 else -1.0
    if one < 0.0 and other < 0.0:
        return MOST_CODE * np.float64(poses[1])
    if one < 0.0 or other < 0.0:
        return max(one, other)
    return (1.0 - share) * one + share * other


@kernel
def weigh_band(body, stride, path, radius, every, weights):
    """Write what cells near a path weigh in the direction in which it leads there; inf where poses fail."""
    codes, unit, source, _ = body[0]
    last_row, last_col = source[8][0], source[8][1]
    for k in range(0, len(path), every):
        a, b = max(k - every, 0), min(k + every, len(path) - 1)
        straight, diagonal, share = _headings_of(float(path[b, 0] - path[a, 0]), float(path[b, 1] - path[a, 1]))
        nearer = diagonal if share > 0.5 else straight
        for i in range(max(path[k, 0] - radius, 0), min(path[k, 0] + radius + 1, last_row)):
            for j in range(max(path[k, 1] - radius, 0), min(path[k, 1] + radius + 1, last_col)):
                node = (i + 1) * stride + j + 1
                for heading in (straight, diagonal):
                    if codes[node, heading] == UNCHECKED:
                        check_there(body[0], i, j, heading)
                one, other = pose_weight(codes[node, straight], unit), pose_weight(codes[node, diagonal], unit)
                weight = pose_weight(codes[node, nearer], unit)
                if one < np.inf and other < np.inf:
                    weight = np.float32((1.0 - share) * one + share * other)
                weights[node] = min(weights[node], weight)


@kernel
def clear_band(stride, path, radius, every, shape, weights):
    """Undo `weigh_band`."""
    for k in range(0, len(path), every):
        for i in range(max(path[k, 0] - radius, 0), min(path[k, 0] + radius + 1, shape[0])):
            for j in range(max(path[k, 1] - radius, 0), min(path[k, 1] + radius + 1, shape[1])):
                weights[(i + 1) * stride + j + 1] = np.inf
