"""Corridors: what is searched on the next finer level, marked in a bitmap of numbers."""

from numpy import float32, int64, uint8

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import (
    COL,
    OPEN_BIT,
    OPPOSITE,
    ROW,
    STAMP_SHIFT,
    neighbour,
    prefetch,
    step_cost,
)
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.records import (
    FinerLevel,
    FloodMemory,
    GridRecord,
    Marks,
    Searched,
    Width,
)
from nnpp_edge.runtime.kernels.tiles import open_at

_LOOK_EVERY = 256
"""Cells between two readings of the clock."""
_APART = 1
_REACHED = 2
"""Of a cell of a region: a search did not come to it, and did."""


@helper
def _mark(row, col, radius, marks):
    """Mark the four quarters of a cell, and those within `radius` (as the king moves) of them."""
    rows, cols = marks.bitmap.shape
    top = 2 * row
    left = 2 * col
    for i in range(max(top - radius, 0), min(top + 2 + radius, rows)):
        for j in range(max(left - radius, 0), min(left + 2 + radius, cols)):
            marks.bitmap[i, j] = marks.stamp


@inlined
def _fetch_below(row, col, finer):
    """Fetch what the next finer search will read of the cells below one."""
    for below in range(FACTOR * row, min(FACTOR * row + FACTOR, finer.rows)):
        node = (below + 1) * finer.stride + FACTOR * col + 1
        prefetch(finer.weights, node)
        prefetch(finer.meta, 2 * node)


@helper
def _flood(grid, edges, links, start, found, limit, scratch, marks, until, finer):
    """Mark the cells on paths from `start` that cost at most `limit`, and find what it costs to
    reach them.

    Once it is late nothing more is marked.

    What is left from a cell is g of an earlier search, which began at the other end. With that as a
    bound, few cells are expanded twice, so a plain queue serves.
    """
    weights = grid.weights
    stride = grid.stride
    reached = scratch.reached
    queued = scratch.queued
    queue = scratch.queue
    mask = len(queue) - 1
    head = 0
    tail = 1
    ended = False
    queue[0] = start
    reached[start] = 0.0
    _mark(start // stride - 1, start % stride - 1, 0, marks)
    while head != tail:
        node = int64(queue[head & mask])
        head += 1
        queued[node] = 0
        ended = ended or (head % _LOOK_EVERY == 0 and late(until))
        if ended:  # the queue is emptied for the next flood
            continue
        # the search that came here may not have left from here
        open_at(grid.tiles, node // stride - 1, node % stride - 1)
        for k in range(8):
            if not (links[node] >> k) & 1:
                continue
            there = neighbour(node, k, stride)
            word = found.meta[2 * there + 1]
            if word >> STAMP_SHIFT != found.stamp or word & OPEN_BIT:
                continue
            if edges is None:
                step = float32(step_cost(k >= 4, weights[node] + weights[there], grid.steps))
            else:
                step = edges[node, k]
            cost = reached[node] + step
            if cost + found.g[2 * there] > limit:
                continue
            row = there // stride - 1
            col = there % stride - 1
            marked = marks.bitmap[2 * row, 2 * col] == marks.stamp
            if marked and cost >= reached[there]:
                continue
            if not marked:
                _mark(row, col, 0, marks)
                _fetch_below(row, col, finer)
            reached[there] = cost
            if not queued[there]:
                queued[there] = 1
                queue[tail & mask] = there
                tail += 1


@kernel
def surround(
    grid: GridRecord,
    edges,
    links,
    start,
    found: Searched,
    scratch: FloodMemory,
    path,
    width: Width,
    marks: Marks,
    finer: FinerLevel,
):
    """Mark what the next finer level is to search: what lies around a path, and on paths of nearly
    the same cost.

    Parameters
    ----------
    grid, edges, links
        The level that was searched, from the goal to `start`; `edges` of the steps that leave a
        node, see `expand`.
    start : int
        Node that the path starts from.
    found, scratch, width, marks, finer
        `Searched`, `FloodMemory`, `Width`, `Marks`, and `FinerLevel`, which is fetched for its
        search.
    path : (N, 2) int32
        Cells of the level.
    """
    if width.band > 0.0 and len(path) > 1:
        limit = (1.0 + width.band) * found.g[2 * start]
        _flood(grid, edges, links, start, found, limit, scratch, marks, width.until, finer)
    for n in range(len(path)):  # last: the flood goes by the numbers that it wrote
        _mark(path[n, ROW], path[n, COL], width.radius, marks)


@helper
def _was_reached(meta, stamp, states, rows, cols, row, col):
    """Whether a search came to any cell of the finest level below a cell of the next."""
    for i in range(FACTOR * row, min(FACTOR * row + FACTOR, rows)):
        for j in range(FACTOR * col, min(FACTOR * col + FACTOR, cols)):
            first = ((i + 1) * (cols + 2) + j + 1) * states
            for state in range(first, first + states):
                if meta[2 * state + 1] >> STAMP_SHIFT == stamp:
                    return True
    return False


@kernel
def close_dead_ends(links, marks: Marks, meta, stamp, states, shape, came, closed):
    """Close the links between cells of a region that a search of the map came to, until nothing was
    left, and those that it did not: how many.

    Parameters
    ----------
    links : (nodes,) uint8
        Of the first coarse level; changed.
    marks
        `Marks` of the region.
    meta, stamp, states : (2 · nodes · states,) int32, int, int
        What the search left, as in `Memory`, its number, and the states of a node.
    shape : (rows, cols)
        Of the map.
    came : (nodes,) uint8
        Scratch, all 0.
    closed : (nodes,) uint8
        The bits that were taken from `links` are added.
    """
    map_rows, map_cols = shape
    rows = marks.bitmap.shape[0] // 2
    cols = marks.bitmap.shape[1] // 2
    stride = cols + 2
    count = 0
    for row in range(rows):
        for col in range(cols):
            quarters = 0
            for i in range(2 * row, 2 * row + 2):
                for j in range(2 * col, 2 * col + 2):
                    quarters += int64(marks.bitmap[i, j] == marks.stamp)
            node = (row + 1) * stride + col + 1
            if quarters and _was_reached(meta, stamp, states, map_rows, map_cols, row, col):
                came[node] = _REACHED
            elif quarters == 4:  # into the rest of another there may be a way
                came[node] = _APART
    for row in range(rows):
        first = (row + 1) * stride + 1
        for node in range(first, first + cols):
            if came[node] != _REACHED:
                continue
            for k in range(8):
                there = neighbour(node, k, stride)
                if came[there] == _APART and (links[node] >> k) & 1:
                    count += 1
                    _close(links, closed, node, k)
                    _close(links, closed, there, OPPOSITE[k])
    came[:] = 0
    return count


@helper
def _close(links, closed, node, k):
    """Close a cell's link in direction k."""
    bit = uint8(1 << k)
    closed[node] |= links[node] & bit
    links[node] &= ~bit
