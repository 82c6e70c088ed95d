"""Inputs of the network: area averages of the map, and where start and goal lie. See
`network.encoding`.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel

GAUSSIAN_CHANNELS = 2
BETWEEN_CHANNELS = 3
END_CHANNELS = 6
ENDS_CHANNELS = 2 * END_CHANNELS + BETWEEN_CHANNELS


@helper
def cells_under(n, inner, cells):
    """First and one past the last map cell under network cell n."""
    first = n * cells // inner
    return first, max(-((-(n + 1) * cells) // inner), first + 1)


@kernel
def pool_planes(weights, stride, rows, cols, scale, offset, inner_rows, inner_cols, parts, planes):
    """Average what lies under these rectangles of the map, (N, 4) of row, col, rows and cols."""
    for n in range(len(parts)):
        row0 = parts[n, 0] * inner_rows // rows
        row1 = -(-(parts[n, 0] + parts[n, 2]) * inner_rows // rows)
        col0 = parts[n, 1] * inner_cols // cols
        col1 = -(-(parts[n, 1] + parts[n, 3]) * inner_cols // cols)
        for row in range(row0, min(row1, inner_rows)):
            top, bottom = cells_under(row, inner_rows, rows)
            for col in range(col0, min(col1, inner_cols)):
                left, right = cells_under(col, inner_cols, cols)
                total = 0.0
                blocked = 0
                for i in range(top, bottom):
                    for j in range(left, right):
                        w = weights[(i + 1) * stride + j + 1]
                        if w == np.inf:
                            blocked += 1
                        else:
                            total += min(max(w * scale + offset, 0.0), 1.0)
                cells = (bottom - top) * (right - left)
                planes[0, row, col] = (total + blocked) / cells
                planes[1, row, col] = blocked / cells


@helper
def _end(out, row, col, spacing, sigma):
    """Where one end lies: the share that each point has in it, and the way to it from each."""
    size = out.shape[1]
    offset = (spacing - 1.0) / 2.0
    side = size * spacing
    # in points
    y = (row - offset) / spacing
    x = (col - offset) / spacing
    y = min(max(y, 0.0), size - 1.0)
    x = min(max(x, 0.0), size - 1.0)
    wide = -0.5 / sigma**2
    sharp = -8.0 / sigma**2
    for i in range(size):
        over_rows = max(1.0 - abs(i - y), 0.0)
        down = row - (i * spacing + offset)
        for j in range(size):
            right = col - (j * spacing + offset)
            square = down * down + right * right
            out[0, i, j] = over_rows * max(1.0 - abs(j - x), 0.0)
            out[1, i, j] = down / side
            out[2, i, j] = right / side
            out[3, i, j] = math.sqrt(square) / side
            out[4, i, j] = math.exp(wide * square)
            out[5, i, j] = math.exp(sharp * square)


@helper
def _between(out, row_a, col_a, row_b, col_b, spacing):
    """How much of a detour each point is from the straight way between the two ends."""
    size = out.shape[1]
    offset = (spacing - 1.0) / 2.0
    side = size * spacing
    apart = max(math.hypot(row_a - row_b, col_a - col_b), spacing)
    for i in range(size):
        for j in range(size):
            row = i * spacing + offset
            col = j * spacing + offset
            detour = (
                math.hypot(row - row_a, col - col_a) + math.hypot(row - row_b, col - col_b) - apart
            )
            detour = max(detour, 0.0)
            out[0, i, j] = math.exp(-detour / (0.25 * apart))
            out[1, i, j] = detour / side
            out[2, i, j] = apart / side


@kernel
def fill_ends(out, row_a, col_a, row_b, col_b, spacing, sigma):
    """As `encode_ends`, for other kernels to call."""
    _end(out[:END_CHANNELS], row_a, col_a, spacing, sigma)
    _end(out[END_CHANNELS : 2 * END_CHANNELS], row_b, col_b, spacing, sigma)
    _between(out[2 * END_CHANNELS :], row_a, col_a, row_b, col_b, spacing)
