"""The adaptive threshold, and the blocks above it. See `region.learned`."""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP, STAMP_SHIFT
from nnpp_edge.runtime.kernels.tiles import open_there

LEVELS = 256
"""Level n stands for the probability (n / 256)⁴. So what is unlikely has levels too: where slope
limits leave only a long way round, td is often below 1/1000."""
TOO_LATE = -2
_LOOK_EVERY = 1024
"""Cells between two readings of the clock."""
TOWARDS = np.array(
    [
        sorted(range(8), key=lambda k: ROW_STEP[k] * (n // 3 - 1) + COL_STEP[k] * (n % 3 - 1))
        for n in range(9)
    ],
    np.int8,
)
"""The eight directions, those that lead most towards row n // 3 - 1 and column n % 3 - 1 last."""


@kernel
def quantise(probability, levels):
    """Level ⌊256 p^(1/4)⌋ of each block, at most 255: (B, B) float32 in [0, 1] to (B, B) uint8."""
    for i in range(probability.shape[0]):
        for j in range(probability.shape[1]):
            root = math.sqrt(math.sqrt(max(probability[i, j], np.float32(0.0))))
            levels[i, j] = np.uint8(min(root * LEVELS, LEVELS - 1.0))


@kernel
def lowered(level, factor):
    """The level, at least 1, of a probability that is `factor` times another one's."""
    return max(int(level * math.sqrt(math.sqrt(factor))), 1)


@kernel
def adaptive_threshold(levels, start_row, start_col, goal_row, goal_col, heads, following, done):
    """The largest level, in 0…255, at which two blocks are joined in {levels >= level},
    eight-connected.

    `levels` are (B, C) uint8, 0 in the last row and column; scratch are `heads`, (256,) int32,
    `following`, (B·C,) int32, and `done`, (B·C,) uint8.
    """
    rows, cols = levels.shape
    heads[:] = -1
    done[:] = 0
    goal = goal_row * cols + goal_col
    first = start_row * cols + start_col
    width = np.int64(levels[start_row, start_col])
    done[first] = 1
    following[first] = -1
    heads[width] = first
    while True:
        while heads[width] == -1:
            width -= 1
        block = heads[width]
        heads[width] = following[block]
        if block == goal:
            return width
        row = block // cols
        col = block % cols
        for i in range(max(row - 1, 0), min(row + 2, rows)):
            for j in range(max(col - 1, 0), min(col + 2, cols)):
                there = i * cols + j
                if not done[there]:
                    done[there] = 1
                    bucket = min(width, np.int64(levels[i, j]))
                    following[there] = heads[bucket]
                    heads[bucket] = there


@helper
def linked(weights, links, node, k, stride, corner_cutting):
    """Whether a step in direction k leads from a passable cell to another."""
    if links is not None:
        return (links[node] >> k) & 1 != 0
    there = node + ROW_STEP[k] * stride + COL_STEP[k]
    if weights[there] == np.inf:
        return False
    if k < 4 or corner_cutting:
        return True
    return weights[node + ROW_STEP[k] * stride] != np.inf and weights[node + COL_STEP[k]] != np.inf


@helper
def walkable_threshold(levels, lookup, grid, links, start, goal, most, heads, search, until):
    """The largest level at which two nodes of a grid are joined by steps through cells whose blocks
    reach it.

    Among cells that serve alike, those towards the goal come first: where the way is free, few
    others are looked at. In 0…255; -1 where no steps lead from one to the other; `TOO_LATE`.

    Parameters
    ----------
    lookup : (row_blocks, col_blocks)
        (H,) and (W,) int32, row and column of the block that a row and a column of the grid lie in.
    most : int
        A level that the result is known not to exceed; the nearer to it, the less is looked at.
    heads : (256,) int32
        Scratch.
    search : (state, stamp)
        A workspace's memory, (2 · nodes,) int32, which the search that follows will touch too, and
        the number of a new search in it.
    """
    row_blocks, col_blocks = lookup
    weights, stride, _, corner_cutting, tiles = grid
    tile_state, wanted, row_shift, col_shift, _, _ = tiles
    state, stamp = search
    heads[:] = -1
    goal_row = goal // stride
    goal_col = goal % stride
    width = min(
        most, np.int64(levels[row_blocks[start // stride - 1], col_blocks[start % stride - 1]])
    )
    width = min(width, np.int64(levels[row_blocks[goal_row - 1], col_blocks[goal_col - 1]]))
    seen = stamp << STAMP_SHIFT
    state[2 * start] = -1
    state[2 * start + 1] = seen
    looked = 0
    heads[width] = start
    while True:
        while heads[width] == -1:
            width -= 1
            if width < 0:
                return -1
        node = np.int64(heads[width])
        heads[width] = state[2 * node]
        if node == goal:
            return width
        row = node // stride
        col = node % stride
        i = (row - 1) >> row_shift
        j = (col - 1) >> col_shift
        if not tile_state[i, j] & wanted:
            open_there(tiles, i, j)
            looked = 0
        if looked % _LOOK_EVERY == 0 and late(until):
            return TOO_LATE
        looked += 1
        ahead = 3 * ((goal_row > row) - (goal_row < row)) + (goal_col > col) - (goal_col < col) + 4
        for nth in range(8):
            k = TOWARDS[ahead, nth]
            there = node + ROW_STEP[k] * stride + COL_STEP[k]
            if state[2 * there + 1] != seen and linked(
                weights, links, node, k, stride, corner_cutting
            ):
                level = np.int64(
                    levels[row_blocks[there // stride - 1], col_blocks[there % stride - 1]]
                )
                bucket = min(width, level)
                state[2 * there] = heads[bucket]
                state[2 * there + 1] = seen
                heads[bucket] = there


@kernel
def fill_region(levels, threshold, start_row, start_col, goal_row, goal_col, stamp, radius, bitmap):
    """Number the blocks of {levels >= threshold}, and those within `radius` of them; start and goal
    always.

    The last row and column of `levels` are left out.
    """
    rows = levels.shape[0] - 1
    cols = levels.shape[1] - 1
    for row in range(rows):
        for col in range(cols):
            ends = (row == start_row and col == start_col) or (row == goal_row and col == goal_col)
            if levels[row, col] >= threshold or ends:
                for i in range(max(row - radius, 0), min(row + radius + 1, rows)):
                    for j in range(max(col - radius, 0), min(col + radius + 1, cols)):
                        bitmap[i, j] = stamp


@kernel
def first_regions(probability, lookup, grid, links, ends, rule, scratch, search, marks, until):
    """All that a plan needs of a network's answer, in one call: td, and the blocks at it and at a
    share of it.

    td is a level; -1 where no steps lead from start to goal; `TOO_LATE`.

    Parameters
    ----------
    lookup, grid, links, search, until
        As for `walkable_threshold`.
    ends : (start, goal, start_row, start_col, goal_row, goal_col)
        Nodes, and the blocks that belong to any region.
    rule : (touching, factor)
        Whether each step of the grid leads to the same block or one that touches it: then blocks
        joined bound what cells are. And the share of td, in (0, 1], down to which the second region
        goes.
    scratch : (levels, heads, following, done)
        Of a `RegionFinder`.
    marks : (stamp, at_td, bitmap)
        The number to write, and where: the region at td, and the second one.
    """
    start, goal, start_row, start_col, goal_row, goal_col = ends
    touching, factor = rule
    levels, heads, following, done = scratch
    stamp, at_td, bitmap = marks
    row_blocks, col_blocks = lookup
    stride = grid[1]
    quantise(probability, levels)
    most = LEVELS - 1
    if touching:  # by the cells' own blocks: those of `ends` may be their neighbours
        from_row = row_blocks[start // stride - 1]
        from_col = col_blocks[start % stride - 1]
        to_row = row_blocks[goal // stride - 1]
        to_col = col_blocks[goal % stride - 1]
        most = adaptive_threshold(
            levels, from_row, from_col, to_row, to_col, heads, following, done
        )
    td = walkable_threshold(levels, lookup, grid, links, start, goal, most, heads, search, until)
    fill_region(levels, max(td, 0), start_row, start_col, goal_row, goal_col, stamp, 0, at_td)
    if td > 0:
        fill_region(
            levels, lowered(td, factor), start_row, start_col, goal_row, goal_col, stamp, 0, bitmap
        )
    return td
