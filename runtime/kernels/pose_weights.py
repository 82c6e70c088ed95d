"""Weights of the grid's poses between cells and headings. See `kernels.any_heading`."""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper
from nnpp_edge.runtime.kernels.poses import FAILS, MOST_CODE, UNCHECKED, check_there

_NO_SHARE = 1e-9


@helper
def headings_of(rows, cols):
    """Numbers of the straight and the diagonal heading beside a direction, and the diagonal one's share."""
    straight = 0 if abs(rows) >= abs(cols) else 2
    diagonal = 1 if (rows > 0.0) == (cols > 0.0) else 3
    return straight, diagonal, min(abs(rows), abs(cols)) / max(abs(rows), abs(cols))


@helper
def known_weight(codes, unit, stride, row, col, headings):
    """Weight at a place, as `body_weight_at`; -1 where a pose around it is unchecked."""
    i, j = np.int64(row), np.int64(col)
    down, right, first = row - i, col - j, (i + 1) * stride + j + 1
    straight, diagonal, share_of_diagonal = headings
    ones, one_shares, others, other_shares = 0.0, 0.0, 0.0, 0.0
    for k in range(4):
        share = (down if k >> 1 else 1.0 - down) * (right if k & 1 else 1.0 - right)
        if share <= _NO_SHARE:
            continue
        node = np.uint64(first + (k >> 1) * stride + (k & 1))
        one, other = codes[node, np.uint64(straight)], codes[node, np.uint64(diagonal)]
        if one == UNCHECKED or other == UNCHECKED:
            return -1.0
        if one != FAILS:
            ones, one_shares = ones + share * (one - 1.0), one_shares + share
        if other != FAILS:
            others, other_shares = others + share * (other - 1.0), other_shares + share
    one_known, other_known = one_shares > 0.0, other_shares > 0.0
    if one_known and other_known:
        mean = (1.0 - share_of_diagonal) * ones / one_shares + share_of_diagonal * others / other_shares
    elif one_known and share_of_diagonal < 1.0:
        mean = ones / one_shares
    elif other_known and share_of_diagonal > 0.0:
        mean = others / other_shares
    else:
        mean = np.float64(MOST_CODE)
    return mean * np.float64(unit)


@helper
def body_weight_at(poses, stride, row, col, headings):
    """Weight at a place in a direction (`headings_of`): the mean of the grid's poses around it and of two headings.

    Poses that fail are left out; where all do, as if T were 1.
    """
    codes, unit, _, _ = poses
    weight = known_weight(codes, unit, stride, row, col, headings)
    if weight >= 0.0:
        return weight
    i, j = np.int64(row), np.int64(col)
    for k in range(4):
        down, right = k >> 1, k & 1
        if (row - i if down else 1.0 - row + i) * (col - j if right else 1.0 - col + j) > _NO_SHARE:
            node = (i + down + 1) * stride + j + right + 1
            for heading in headings[:2]:
                if codes[node, heading] == UNCHECKED:
                    check_there(poses, i + down, j + right, heading)
    return known_weight(codes, unit, stride, row, col, headings)
