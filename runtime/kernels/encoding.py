"""Inputs of the network: area averages of the map, and where start and goal lie. See
`network.encoding`.
"""

import math

import numpy as np
from numpy import float32, inf, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.records import Area

BETWEEN_CHANNELS = 3
END_CHANNELS = 6
ENDS_CHANNELS = 2 * END_CHANNELS + BETWEEN_CHANNELS


@helper
def cells_under(n, inner, cells):
    """First and one past the last map cell under network cell n."""
    first = n * cells // inner
    return first, max(-((-(n + 1) * cells) // inner), first + 1)


@inlined
def cells_of_part(part, shape, inner):
    """The network's cells, `inner` rows and columns of them, over a `Rectangle`, (4,) int64, of a
    window of this shape.
    """
    rows, cols = shape
    inner_rows, inner_cols = inner
    row, col, part_rows, part_cols = part
    row1 = min(-(-(row + part_rows) * inner_rows // rows), inner_rows)
    col1 = min(-(-(col + part_cols) * inner_cols // cols), inner_cols)
    return Area(row * inner_rows // rows, row1, col * inner_cols // cols, col1)


@kernel
def pool_planes(weights, stride, shape, scale, offset, inner, parts, planes):
    """Average what lies under these parts, (N, 4) int64 `Rectangle`s, of a window of this shape.

    `weights` begin at the window's first cell; `scale` and `offset` turn them into costs. The
    window lies under `inner` rows and columns of the network's cells. Written to `planes`,
    (2, S, S) float32.
    """
    rows, cols = shape
    inner_rows, inner_cols = inner
    sums = np.empty(cols, float32)
    walls = np.empty(cols, float32)
    for n in range(len(parts)):
        part = cells_of_part(parts[n], shape, inner)
        if part.row0 >= part.row1 or part.col0 >= part.col1:
            continue
        begin, _ = cells_under(part.col0, inner_cols, cols)
        _, end = cells_under(part.col1 - 1, inner_cols, cols)
        for i in range(part.row0, part.row1):
            top, bottom = cells_under(i, inner_rows, rows)
            sums[begin:end] = 0.0
            walls[begin:end] = 0.0
            for row in range(top, bottom):
                first = (row + 1) * stride + 1
                line = weights[first + begin : first + end]
                add_costs(line, scale, offset, sums[begin:end], walls[begin:end])
            put_means(planes, i, part, inner_cols, bottom - top, sums, walls)


@helper
def add_costs(line, scale, offset, sums, walls):
    """Add weights as costs to sums, impassable cells as 1, and count those in `walls`. All (n,)
    float32.
    """
    for c in range(len(line)):
        wall = line[c] == inf
        cost = min(max(line[c] * scale + offset, float32(0.0)), float32(1.0))
        sums[c] += float32(1.0) if wall else cost
        walls[c] += float32(1.0) if wall else float32(0.0)


@helper
def put_means(planes, i, part, inner_cols, lines, sums, walls):
    """Write the part's row i of network cells, from the sums of each column over so many lines."""
    wide = 0
    per_cell = float32(0.0)
    for j in range(part.col0, part.col1):
        left, right = cells_under(j, inner_cols, len(sums))
        total = float32(0.0)
        blocked = float32(0.0)
        for col in range(left, right):
            total += sums[uint64(col)]
            blocked += walls[uint64(col)]
        if right - left != wide:  # to divide takes as long as to sum up
            wide = right - left
            per_cell = float32(1.0 / (lines * wide))
        planes[0, i, j] = total * per_cell
        planes[1, i, j] = blocked * per_cell


@helper
def _end(out, row, col, spacing, sigma):
    """Where one end lies: the share that each point has in it, and the way to it from each."""
    size = out.shape[1]
    offset = (spacing - 1.0) / 2.0
    side = size * spacing
    # in points
    y = min(max((row - offset) / spacing, 0.0), size - 1.0)
    x = min(max((col - offset) / spacing, 0.0), size - 1.0)
    wide = -0.5 / sigma**2
    sharp = -8.0 / sigma**2
    for i in range(size):
        over_rows = max(1.0 - abs(i - y), 0.0)
        down = row - (i * spacing + offset)
        for j in range(size):
            over_cols = max(1.0 - abs(j - x), 0.0)
            right = col - (j * spacing + offset)
            square = down * down + right * right
            out[0, i, j] = over_rows * over_cols
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
        row = i * spacing + offset
        for j in range(size):
            col = j * spacing + offset
            to_a = math.hypot(row - row_a, col - col_a)
            to_b = math.hypot(row - row_b, col - col_b)
            detour = max(to_a + to_b - apart, 0.0)
            out[0, i, j] = math.exp(-detour / (0.25 * apart))
            out[1, i, j] = detour / side
            out[2, i, j] = apart / side


@helper
def fill_ends(out, row_a, col_a, row_b, col_b, spacing, sigma):
    """Start and goal, each by the way to it, for a network that looks at the map before it knows
    the two.

    Written to `out`, (15, S/8, S/8) float32, for points `spacing` cells apart. Six planes for the
    start, then six for the goal: the weights of the bilinear interpolation that reads a value there
    off the points, rows and columns from a point to it and the distance, as shares of S, and two
    Gaussians around it, of `sigma` network cells and of a quarter of it. Then three for both:
    exp(-(a + b - d) / (0.25 d)) for distances a and b to the two, which lie d apart, and a + b - d
    and d as shares of S.
    """
    _end(out[:END_CHANNELS], row_a, col_a, spacing, sigma)
    _end(out[END_CHANNELS : 2 * END_CHANNELS], row_b, col_b, spacing, sigma)
    _between(out[2 * END_CHANNELS :], row_a, col_a, row_b, col_b, spacing)
