"""The adaptive threshold, and the blocks above it. See `region.learned`."""

import math

import numpy as np
from numpy import float32, inf, int8, int64, uint8

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import (
    COL,
    COL_STEP,
    ROW,
    ROW_STEP,
    STAMP_SHIFT,
    beside_wall,
    fetch_around,
    neighbour,
)
from nnpp_edge.runtime.kernels.records import (
    GridRecord,
    Lookup,
    Memory,
    RegionMarks,
    RegionQuery,
    ThresholdMemory,
)
from nnpp_edge.runtime.kernels.tiles import open_at

LEVELS = 256
"""Level n stands for the probability (n / 256)⁴. So what is unlikely has levels too: where slope
limits leave only a long way round, td is often below 1/1000."""
TOO_LATE = -2
_NONE = -1
_LOOK_EVERY = 1024
"""Cells between two readings of the clock."""


def _towards(n: int) -> list[int]:
    """The eight directions, those that lead most towards row n // 3 - 1 and column n % 3 - 1
    last.
    """
    down = n // 3 - 1
    right = n % 3 - 1
    return sorted(range(8), key=lambda k: ROW_STEP[k] * down + COL_STEP[k] * right)


TOWARDS = np.array([_towards(n) for n in range(9)], int8)
"""For each of nine ways ahead, the eight directions, those that lead most that way last."""


@kernel
def quantise(probability, levels):
    """Level ⌊256 p^(1/4)⌋ of each block, at most 255: (B, B) float32 in [0, 1] to (B, B) uint8."""
    for i in range(probability.shape[0]):
        for j in range(probability.shape[1]):
            root = math.sqrt(math.sqrt(max(probability[i, j], float32(0.0))))
            levels[i, j] = uint8(min(root * LEVELS, LEVELS - 1.0))


@kernel
def lowered(level, factor):
    """The level, at least 1, of a probability that is `factor` times another one's."""
    return max(int(level * math.sqrt(math.sqrt(factor))), 1)


@kernel
def adaptive_threshold(memory: ThresholdMemory, start, goal):
    """The largest level, in 0…255, at which two blocks, (row, col), are joined in
    {levels >= level}, eight-connected.
    """
    return _widest(memory, start, goal)


@helper
def _widest(memory, start, goal):
    """As `adaptive_threshold`, for other kernels to call."""
    heads = memory.heads
    rows, cols = memory.levels.shape
    heads[:] = _NONE
    memory.done[:] = 0
    last = goal[ROW] * cols + goal[COL]
    first = start[ROW] * cols + start[COL]
    width = int64(memory.levels[start[ROW], start[COL]])
    memory.done[first] = 1
    memory.following[first] = _NONE
    heads[width] = first
    while True:
        while heads[width] == _NONE:
            width -= 1
        block = heads[width]
        heads[width] = memory.following[block]
        if block == last:
            return width
        row = block // cols
        col = block % cols
        for i in range(max(row - 1, 0), min(row + 2, rows)):
            for j in range(max(col - 1, 0), min(col + 2, cols)):
                there = i * cols + j
                if not memory.done[there]:
                    memory.done[there] = 1
                    bucket = min(width, int64(memory.levels[i, j]))
                    memory.following[there] = heads[bucket]
                    heads[bucket] = there


@inlined
def _leads(grid, links, node, k, there):
    """Whether a step in direction k leads from a passable cell to another."""
    if len(links):
        return (links[node] >> k) & 1 != 0
    if grid.weights[there] == inf:
        return False
    if k < 4 or grid.corner_cutting:
        return True
    return not beside_wall(grid.weights, node, ROW_STEP[k] * grid.stride, COL_STEP[k])


@inlined
def _block_at(lookup, node, stride):
    """The block that a node lies in."""
    return lookup.row_block[node // stride - 1], lookup.col_block[node % stride - 1]


@inlined
def _level_at(levels, lookup, node, stride):
    """Level of the block that a node lies in."""
    row, col = _block_at(lookup, node, stride)
    return int64(levels[row, col])


@inlined
def _walkable_threshold(levels, lookup, grid, links, query, most, heads, walk, until):
    """The largest level at which start and goal are joined by steps through cells whose blocks
    reach it.

    Among cells that serve alike, those towards the goal come first: where the way is free, few
    others are looked at. In 0…255; -1 where no steps lead from one to the other; `TOO_LATE`. `most`
    is a level that the result is known not to exceed; the nearer to it, the less is looked at.
    """
    stride = grid.stride
    waiting = walk.meta
    heads[:] = _NONE
    goal_row = query.goal // stride
    goal_col = query.goal % stride
    width = min(most, _level_at(levels, lookup, query.start, stride))
    width = min(width, _level_at(levels, lookup, query.goal, stride))
    seen = walk.stamp << STAMP_SHIFT
    waiting[2 * query.start] = _NONE
    waiting[2 * query.start + 1] = seen
    looked = 0
    heads[width] = query.start
    while True:
        # the newest node that waits at the highest level
        while heads[width] == _NONE:
            width -= 1
            if width < 0:
                return -1
        node = int64(heads[width])
        heads[width] = waiting[2 * node]
        if node == query.goal:
            return width
        row = node // stride
        col = node % stride
        if open_at(grid.tiles, row - 1, col - 1):
            looked = 0
        if looked % _LOOK_EVERY == 0 and late(until):
            return TOO_LATE
        looked += 1
        # its neighbours wait at their own levels, or at this one where that is lower
        rows_on = (goal_row > row) - (goal_row < row)
        cols_on = (goal_col > col) - (goal_col < col)
        ahead = 3 * rows_on + cols_on + 4
        for nth in range(8):
            k = TOWARDS[ahead, nth]
            there = neighbour(node, k, stride)
            if waiting[2 * there + 1] != seen and _leads(grid, links, node, k, there):
                bucket = min(width, _level_at(levels, lookup, there, stride))
                waiting[2 * there] = heads[bucket]
                waiting[2 * there + 1] = seen
                heads[bucket] = there
                fetch_around(waiting, 2, there, stride)


@kernel
def fill_region(levels, threshold, start, goal, stamp, radius, bitmap):
    """Number the blocks of {levels >= threshold}, and those within `radius` of them; start and goal
    always.

    The last row and column of `levels` are left out.
    """
    rows = levels.shape[0] - 1
    cols = levels.shape[1] - 1
    for row in range(rows):
        for col in range(cols):
            at_end = (row, col) == start or (row, col) == goal
            if levels[row, col] >= threshold or at_end:
                for i in range(max(row - radius, 0), min(row + radius + 1, rows)):
                    for j in range(max(col - radius, 0), min(col + radius + 1, cols)):
                        bitmap[i, j] = stamp


@kernel
def first_regions(
    probability,
    lookup: Lookup,
    grid: GridRecord,
    links,
    query: RegionQuery,
    memory: ThresholdMemory,
    walk: Memory,
    marks: RegionMarks,
    until,
):
    """All that a plan needs of a network's answer, in one call: td, and the blocks at it and at a
    share of it.

    td is a level; -1 where no steps lead from start to goal; `TOO_LATE`.

    Parameters
    ----------
    probability : (B, B) float32
        In [0, 1].
    lookup, grid, query, memory, walk, marks
        `Lookup`, `GridRecord`, `RegionQuery`, `ThresholdMemory`, `Memory` with the number of
        a new search, and `RegionMarks`.
    links : (nodes,) uint8
        As for `expand`.
    """
    levels = memory.levels
    stride = grid.stride
    quantise(probability, levels)
    most = LEVELS - 1
    if query.touching:  # by the cells' own blocks: those of `query` may be their neighbours
        start = _block_at(lookup, query.start, stride)
        most = _widest(memory, start, _block_at(lookup, query.goal, stride))
    td = _walkable_threshold(levels, lookup, grid, links, query, most, memory.heads, walk, until)
    fill_region(levels, max(td, 0), *query.blocks, marks.stamp, 0, marks.at_td)
    if td > 0:
        second = lowered(td, query.factor)
        fill_region(levels, second, *query.blocks, marks.stamp, 0, marks.bitmap)
    return td
