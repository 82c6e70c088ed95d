"""Corridors: what is searched on the next finer level, marked in a bitmap of numbers."""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import COL_STEP, OPEN_BIT, OPPOSITE, ROW_STEP, STAMP_SHIFT
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.tiles import open_there

_LOOK_EVERY = 256
"""Cells between two readings of the clock."""


@helper
def _mark(path, radius, stamp, bitmap):
    """Mark the quarters of a path's cells, and those within `radius` (as the king moves)
    of them.
    """
    rows, cols = bitmap.shape
    for n in range(len(path)):
        for i in range(max(2 * path[n, 0] - radius, 0), min(2 * path[n, 0] + 2 + radius, rows)):
            for j in range(max(2 * path[n, 1] - radius, 0), min(2 * path[n, 1] + 2 + radius, cols)):
                bitmap[i, j] = stamp


@helper
def _mark_cell(row, col, stamp, bitmap):
    """Mark the four quarters of a cell."""
    for i in range(2 * row, 2 * row + 2):
        for j in range(2 * col, 2 * col + 2):
            bitmap[i, j] = stamp


@helper
def _flood(grid, edges, links, start, found, limit, scratch, marks, until):
    """Mark the cells on paths from `start` that cost at most `limit`, and find what it costs to
    reach them.

    Once it is late nothing more is marked.

    What is left from a cell is g of an earlier search, which began at the other end. With that as a
    bound, few cells are expanded twice, so a plain queue serves.
    """
    weights, stride, steps, _, tiles = grid
    state, wanted, row_shift, col_shift, _, _ = tiles
    g, meta, search = found
    reached, queued, queue = scratch
    bitmap, stamp = marks
    length_s, length_d, weight_s, weight_d = steps
    mask = len(queue) - 1
    head = 0
    tail = 1
    ended = False
    queue[0] = start
    reached[start] = 0.0
    _mark_cell(start // stride - 1, start % stride - 1, stamp, bitmap)
    while head != tail:
        node = np.int64(queue[head & mask])
        head += 1
        queued[node] = 0
        if ended or (
            head % _LOOK_EVERY == 0 and late(until)
        ):  # the queue is emptied for the next flood
            ended = True
            continue
        i = (node // stride - 1) >> row_shift
        j = (node % stride - 1) >> col_shift
        if not state[i, j] & wanted:  # the search that came here did not leave from here
            open_there(tiles, i, j)
        for k in range(8):
            if not (links[node] >> k) & 1:
                continue
            there = node + ROW_STEP[k] * stride + COL_STEP[k]
            word = meta[2 * there + 1]
            if word >> STAMP_SHIFT != search or word & OPEN_BIT:
                continue
            if edges is None:
                length, weight = (length_s, weight_s) if k < 4 else (length_d, weight_d)
                cost = reached[node] + np.float32(
                    length + weight * (weights[node] + weights[there])
                )
            else:
                cost = reached[node] + edges[node, k]
            if cost + g[2 * there] > limit:
                continue
            row = there // stride - 1
            col = there % stride - 1
            if bitmap[2 * row, 2 * col] == stamp and cost >= reached[there]:
                continue
            _mark_cell(row, col, stamp, bitmap)
            reached[there] = cost
            if not queued[there]:
                queued[there] = 1
                queue[tail & mask] = there
                tail += 1


@helper
def _read_ahead(path, finer):
    """Read what the next finer search will, along a path of cells: in any order, memory answers
    many times as fast.

    Returns a number that means nothing, so that the compiler leaves the reading in.
    """
    weights, stride, rows, cols, meta = finer
    seen = np.int64(0)
    for n in range(len(path)):
        first = max(FACTOR * path[n, 1] - FACTOR // 2, 0)
        last = min(FACTOR * path[n, 1] + FACTOR + FACTOR // 2, cols) - 1
        for i in range(FACTOR * path[n, 0], min(FACTOR * path[n, 0] + FACTOR, rows)):
            row = (i + 1) * stride + 1
            seen += np.int64(weights[row + first] > weights[row + last])
            seen += meta[2 * (row + first)] ^ meta[2 * (row + last)]
    return seen


@kernel
def surround(grid, edges, links, start, found, scratch, path, width, marks, finer):
    """Mark what the next finer level is to search: what lies around a path, and on paths of nearly
    the same cost.

    Parameters
    ----------
    grid, edges, links
        The level that was searched, from the goal to `start`; `edges` of the steps that leave a
        node, see `expand`.
    start : int
        Node that the path starts from.
    found : (g, meta, stamp)
        What the search left in its memory.
    scratch : (reached, queued, queue)
        (nodes,) float32; (nodes,) uint8, all 0; a power of two of int32. Overwritten.
    path : (N, 2) int32
        Cells of the level.
    width : (radius, band, until)
        The quarters of cells within so many quarters of the path's are marked, as the king moves;
        and paths that cost at most 1 + `band` times as much are marked, too, as far as these are
        found by that reading of the clock, see `clock.late`.
    marks : (bitmap, stamp)
        (2 rows, 2 cols) int32 over the quarters of the level's cells, and the number to write.
    finer : (weights, stride, rows, cols, meta)
        The next finer level and its search memory, read ahead along the path.
    """
    g = found[0]
    radius, band, until = width
    bitmap, stamp = marks
    if band > 0.0 and len(path) > 1:
        _flood(grid, edges, links, start, found, (1.0 + band) * g[2 * start], scratch, marks, until)
    _mark(path, radius, stamp, bitmap)  # last: the flood goes by the numbers that it wrote
    return _read_ahead(path, finer)


@helper
def _was_reached(meta, stamp, shape, row, col):
    """Whether a search came to any cell of the finest level below a cell of the next."""
    rows, cols = shape
    for i in range(FACTOR * row, min(FACTOR * row + FACTOR, rows)):
        for j in range(FACTOR * col, min(FACTOR * col + FACTOR, cols)):
            if meta[2 * ((i + 1) * (cols + 2) + j + 1) + 1] >> STAMP_SHIFT == stamp:
                return True
    return False


@kernel
def close_dead_ends(links, marks, reached, came, closed):
    """Close the links between cells of a region that a search of the map came to and those that it
    did not: how many.

    Parameters
    ----------
    links : (nodes,) uint8
        Of the first coarse level; changed.
    marks : (bitmap, stamp)
        The region, in quarters of its cells: (2 rows, 2 cols) int32, and the number within it.
    reached : (meta, stamp, shape)
        What the search left, see `search.workspace`; its number; the map's rows and columns.
    came : (nodes,) uint8
        Scratch, all 0.
    closed : (nodes,) uint8
        The bits that were taken from `links` are added.
    """
    bitmap, mark = marks
    meta, stamp, shape = reached
    rows = bitmap.shape[0] // 2
    cols = bitmap.shape[1] // 2
    stride = cols + 2
    count = 0
    for i in range(rows):
        for j in range(cols):
            quarters = np.int64(bitmap[2 * i, 2 * j] == mark) + np.int64(
                bitmap[2 * i, 2 * j + 1] == mark
            )
            quarters += np.int64(bitmap[2 * i + 1, 2 * j] == mark) + np.int64(
                bitmap[2 * i + 1, 2 * j + 1] == mark
            )
            if quarters and _was_reached(meta, stamp, shape, i, j):
                came[(i + 1) * stride + j + 1] = 2
            elif quarters == 4:  # into the rest of another there may be a way
                came[(i + 1) * stride + j + 1] = 1
    for i in range(rows):
        for node in range((i + 1) * stride + 1, (i + 1) * stride + 1 + cols):
            if came[node] == 2:
                for k in range(8):
                    there = node + ROW_STEP[k] * stride + COL_STEP[k]
                    if came[there] == 1 and (links[node] >> k) & 1:
                        count += 1
                        for at, bit in (
                            (node, np.uint8(1 << k)),
                            (there, np.uint8(1 << OPPOSITE[k])),
                        ):
                            closed[at] |= links[at] & bit
                            links[at] &= ~bit
    came[:] = 0
    return count
