"""The kernels of the search: expanding nodes in the order of f, and tracing a path back.

f = g + h, and h is the greatest of several lower bounds on the cost that is left: the octile
distance at the price of the map's cheapest cell and, where there are landmarks, |d(landmark, node)
- d(landmark, goal)| for each of them, by the triangle inequality.

Indices are cast to unsigned where they are used: numba would otherwise look at each whether it is
negative, as Python's indices may be, which took a tenth of a search's time.
"""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import (
    COL_STEP,
    DIRECTION_BITS,
    OPEN_BIT,
    ORIGIN,
    ROW_STEP,
    STAMP_SHIFT,
    lowest_bit,
    octile,
)
from nnpp_edge.runtime.kernels.open_list import (
    BLOCK,
    FINE,
    FINE_AT,
    FREE,
    LENGTH,
    NOTHING,
    SPAN,
    USED,
    bucket_of,
    clear,
    last_bucket_below,
    pop,
    push,
    refill_by,
)
from nnpp_edge.runtime.kernels.pooling import NO_LINKS as NO_LINKS
from nnpp_edge.runtime.kernels.tiles import open_there

FOUND = 0
EXHAUSTED = 1
PAUSED = 2
FULL = 3
# slots of the float64 array of results
BASE, INVERSE_WIDTH, REFUSED, BEST_H, BOUND = range(5)
# slots of the int64 array of results
EXPANSIONS, BEST_NODE, SETTLED = range(3)

LANES = 8
"""Landmarks that a node has room for."""
LOOK_EVERY = 1024
"""Expansions between two readings of the clock."""
NO_HINTS = np.empty((0, LANES), np.float32), np.empty(LANES, np.float32), 0.0
NO_REGION = np.empty((0, 0), np.int32), np.empty(0, np.int32), np.empty(0, np.int32), 0
"""Of a search without these: a flag, where None would compile another search."""
BELOW = 1.0 - 1e-6
"""Nodes that promise an improvement smaller than g's rounding are left alone."""


def _successors(square: int) -> NDArray[np.int64]:
    """For each direction of arrival (and none, the start's) the directions worth leaving in, as
    bits: those to cells from which the square of the distance to the parent, which would reach them
    at no higher cost, is greater.
    """
    masks = np.full(ORIGIN + 1, 255, np.int64)
    for arrival in range(ORIGIN):
        for k in range(8):
            if (ROW_STEP[arrival] + ROW_STEP[k]) ** 2 + (
                COL_STEP[arrival] + COL_STEP[k]
            ) ** 2 <= square:
                masks[arrival] &= ~(1 << k)
    return masks


SUCCESSORS = tuple(map(_successors, range(3)))
"""0: all but the parent, where links decide which neighbours a cell has. 1: none a straight step
from the parent, for every step-cost model. 2: none a diagonal away either, where it is never
dearer than the two straight steps around its corner, and never forbidden where they are allowed."""


@helper
def _apart(fields, at_goal, node):
    """The greatest difference to the goal's costs from the landmarks."""
    furthest = np.float32(0.0)
    for lane in range(LANES):
        # inf where only one of the two is connected to the landmark; NaN, which is passed over,
        # where neither is
        apart = abs(fields[np.uint64(node), np.uint64(lane)] - at_goal[np.uint64(lane)])
        furthest = apart if apart > furthest else furthest
    return furthest


@helper
def _left(node, judge):
    """A lower bound on what a way from a node costs."""
    (stride, goal_row, goal_col, h_straight, h_diagonal), (fields, at_goal, slack) = judge
    h = octile(node // stride, node % stride, goal_row, goal_col, h_straight, h_diagonal)
    return max(h, _apart(fields, at_goal, node) - slack) if len(fields) else h


_refill = refill_by(_left)


@kernel
def trace(meta, node, stride, out):
    """Write the cells from `node` back to the start into `out`, as far as it reaches;
    their number.
    """
    n = 0
    while True:
        if n < len(out):
            out[n, 0] = node // stride - 1
            out[n, 1] = node % stride - 1
        n += 1
        k = meta[2 * node + 1] & DIRECTION_BITS
        if k == ORIGIN:
            return n
        node -= ROW_STEP[k] * stride + COL_STEP[k]


@kernel
def expand(grid, edges, links, region, hints, ends, rule, memory, limits):
    """Search until the goal is settled, nothing is left, `most` expansions are done, it is late or
    the list is full.

    Begins at `start`, or goes on where the last call stopped if that is negative. Once the goal has
    been reached, `beyond` times its g bounds what is looked at: nodes whose f is not lower are left
    out, and the search ends when the buckets up to the bound's own are empty. `BELOW` gives the
    optimum; with more than 1, every node on a path that costs less than `beyond` times the optimum
    is settled.

    Parameters
    ----------
    grid, region
        As everywhere; `NO_REGION` for the whole map.
    edges : (nodes, 8) float32 or None
        What the step that leaves a node in each direction costs, inf where there is none. None
        where steps cost by the weights of their ends.
    links : (nodes,) uint8
        The directions in which each cell may be left, as bits; `NO_LINKS` where passability
        decides.
    hints : (fields, at_goal, slack)
        Of the landmarks; `NO_HINTS` without any.
    ends : (start, goal)
        Nodes.
    rule : (h_straight, h_diagonal, width, successors, beyond)
        Prices of the octile distance, the width of a bucket at first, the grid's of the
        `SUCCESSORS`; and, as said above, how far beyond the goal to look.
    memory : (g, meta, stamp, heads, entries, control, reals, counts, path)
        Of a `Workspace`, and the number of this search.
    limits : (most, until)
        Expansions in this call, and a reading of the clock.

    Returns
    -------
    tuple
        What it came to; the number of cells, start and goal included, of the path to the goal or,
        when it is not found, to the expanded node nearest it, of which as many as there is room for
        are in `path`, goal first; the expansions so far; and the least f of a node that the region
        refused.
    """
    weights, stride, steps, corner_cutting, tiles = grid
    start, goal = ends
    tile_state, wanted, row_shift, col_shift, _, _ = tiles
    h_straight, h_diagonal, width, successors, beyond = rule
    most, until = limits
    g, meta, stamp, heads, entries, control, reals, counts, path = memory
    bitmap, row_block, col_block, region_stamp = region
    fields, at_goal, slack = hints
    linked = len(links) > 0
    regional = len(bitmap) > 0
    hinted = len(fields) > 0
    length_s = np.float32(steps[0])
    length_d = np.float32(steps[1])
    weight_s = np.float32(steps[2])
    weight_d = np.float32(steps[3])
    goal_row = goal // stride
    goal_col = goal % stride
    judge = (stride, goal_row, goal_col, h_straight, h_diagonal), hints
    inverse_stride = 1.0 / stride
    row_steps = (-stride, stride, 0, 0, -stride, -stride, stride, stride)
    if start >= 0:
        h = _left(start, judge)
        clear(heads, control)
        control[FREE], control[USED] = push(heads, entries, 0, start, 0, 0, NOTHING, 0)
        control[LENGTH] = 1
        g[2 * start] = 0.0
        meta[2 * start + 1] = (stamp << STAMP_SHIFT) | OPEN_BIT | ORIGIN
        reals[BASE] = h
        reals[INVERSE_WIDTH] = 1.0 / width
        reals[REFUSED] = np.inf
        reals[BEST_H] = np.inf
        counts[EXPANSIONS] = 0
        counts[BEST_NODE] = start
        if h == np.inf:  # a landmark is connected to only one of the two
            return EXHAUSTED, 0, 0, np.inf
    order = (reals[BASE], reals[INVERSE_WIDTH])
    refused = reals[REFUSED]
    best_h = reals[BEST_H]
    free = control[FREE]
    used = control[USED]
    fine_at = control[FINE_AT]
    block = control[BLOCK]
    waiting = control[LENGTH]
    room = np.int64(len(entries)) // 2 - 8
    bound = np.inf
    last_bucket = np.int64(SPAN)
    if meta[2 * goal + 1] >> STAMP_SHIFT == stamp:
        bound = np.float64(g[2 * goal]) * beyond
        last_bucket = last_bucket_below(bound, *order)
    expansions = counts[EXPANSIONS]
    last = expansions + most
    look_at = expansions + LOOK_EVERY
    code = PAUSED
    while expansions < last:
        if expansions >= look_at:
            look_at = expansions + LOOK_EVERY
            if late(until):
                break
        if waiting > room:
            code = FULL
            break
        node, fine_at, free = pop(heads, entries, fine_at, free)
        if block * FINE + fine_at > last_bucket:
            code = FOUND
            break
        if node == NOTHING:
            if waiting == 0:
                code = FOUND if bound < np.inf else EXHAUSTED
                break
            found = _refill(judge, bound, block, order, g, meta, heads, entries, free, waiting)
            block, fine_at, order, free, waiting, last_bucket = found
            continue
        waiting -= 1
        word = meta[np.uint64(2 * node + 1)]
        if not word & OPEN_BIT:
            continue
        meta[np.uint64(2 * node + 1)] = word & ~OPEN_BIT
        row = np.int64((node + 0.5) * inverse_stride)
        col = node - row * stride
        h = octile(row, col, goal_row, goal_col, h_straight, h_diagonal)
        g_node = g[np.uint64(2 * node)]
        if g_node + h >= bound:
            continue
        i = np.uint64((row - 1) >> row_shift)
        j = np.uint64((col - 1) >> col_shift)
        if not tile_state[i, j] & wanted:
            open_there(tiles, np.int64(i), np.int64(j))
            look_at = expansions
        own = weights[np.uint64(node)]
        expansions += 1
        if h < best_h:
            best_h = h
            counts[BEST_NODE] = node
        # First, without a branch, which neighbours are reached at a lower g than before; then only
        # those.
        better = np.int64(0)
        for k in range(8):  # unrolled by the compiler
            there = np.uint64(node + row_steps[k] + COL_STEP[k])
            length, weight = (length_s, weight_s) if k < 4 else (length_d, weight_d)
            if edges is None:
                reached = g_node + (
                    length + weight * (own + weights[there])
                )  # inf where impassable
            else:
                reached = g_node + edges[np.uint64(node), np.uint64(k)]
            visited = meta[there * np.uint64(2) + np.uint64(1)] >> STAMP_SHIFT == stamp
            known = g[there * np.uint64(2)] if visited else np.float32(np.inf)
            better |= np.int64(reached < known) << k
        better &= successors[np.uint64(word & DIRECTION_BITS)]
        if linked:
            better &= np.int64(links[np.uint64(node)])
        while better:
            k = lowest_bit(better)
            better &= better - 1
            up = np.int64(ROW_STEP[k])
            left = np.int64(COL_STEP[k])
            across = np.int64(node + up * stride + left)
            there = np.uint64(across)
            if edges is not None:
                reached = g_node + edges[np.uint64(node), np.uint64(k)]
            elif k < 4:
                reached = g_node + (length_s + weight_s * (own + weights[there]))
            else:
                if not corner_cutting and (
                    weights[np.uint64(node + up * stride)] == np.inf
                    or weights[np.uint64(node + left)] == np.inf
                ):
                    continue
                reached = g_node + (length_d + weight_d * (own + weights[there]))
            i = row + up
            j = col + left
            h = octile(i, j, goal_row, goal_col, h_straight, h_diagonal)
            if hinted:
                h = max(h, _apart(fields, at_goal, across) - slack)
            f = reached + h
            if f >= bound:
                continue
            if regional:  # noqa: SIM102
                if (
                    bitmap[
                        np.uint64(row_block[np.uint64(i - 1)]),
                        np.uint64(col_block[np.uint64(j - 1)]),
                    ]
                    != region_stamp
                    and across != goal
                ):
                    refused = min(refused, f)
                    continue
            g[there * np.uint64(2)] = reached
            word = np.int64((stamp << STAMP_SHIFT) | OPEN_BIT | k)
            if across == goal:
                word ^= OPEN_BIT  # never expanded, so never put on the open list
                bound = f * beyond
                last_bucket = last_bucket_below(bound, *order)
            else:
                bucket = bucket_of(f, *order)
                free, used = push(heads, entries, bucket, across, block, fine_at, free, used)
                waiting += 1
            meta[there * np.uint64(2) + np.uint64(1)] = word
    control[FREE] = free
    control[USED] = used
    control[FINE_AT] = fine_at
    control[BLOCK] = block
    control[LENGTH] = waiting
    reals[BASE] = order[0]
    reals[INVERSE_WIDTH] = order[1]
    reals[REFUSED] = refused
    reals[BEST_H] = best_h
    counts[EXPANSIONS] = expansions
    cells = 0
    if code != FULL:
        cells = trace(meta, goal if code == FOUND else counts[BEST_NODE], stride, path)
    return code, cells, expansions, refused
