"""Exact A* on an eight-connected grid, over the whole map or inside a region.

The heuristic is the octile distance at the price of the map's cheapest cell: with n_d diagonal and n_s
straight steps on an empty map it is n_d·step(diagonal, 2·w_min) + n_s·step(straight, 2·w_min). It never
overestimates and is consistent.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime._jit import kernel
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.grid import Grid, StepCost
from nnpp_edge.runtime.planning.open_list import (
    BLOCK,
    COARSE,
    FINE,
    FINE_AT,
    FREE,
    LENGTH,
    NOTHING,
    USED,
    clear,
    next_block,
    pop,
    push,
)
from nnpp_edge.runtime.planning.workspace import OPEN_BIT, ORIGIN, STAMP_SHIFT, Workspace

_FOUND, _EXHAUSTED, _PAUSED, _FULL = 0, 1, 2, 3
_DIRECTION = 15
ROW_STEP = (-1, 1, 0, 0, -1, -1, 1, 1)
COL_STEP = (0, 0, -1, 1, -1, 1, -1, 1)
DIRECTION = (4, 0, 5, 2, -1, 3, 6, 1, 7)
"""Direction of the neighbour (row, col) = (i // 3 - 1, i % 3 - 1); -1 for the cell itself."""


def _successors(free_diagonals: bool) -> NDArray[np.int64]:
    """For each direction of arrival (and none, the start's) the directions worth leaving in, as bits.

    Not worth it is a cell next to the parent that the parent reaches at no higher cost. For every step-cost
    model that is the parent itself and, of its neighbours, those a straight step away from it; where a
    diagonal is never dearer than the two straight steps around its corner, and never forbidden where they
    are allowed, those a diagonal away as well.
    """
    masks = np.full(ORIGIN + 1, 255, np.int64)
    for arrival in range(ORIGIN):
        for k in range(8):
            rows, cols = abs(ROW_STEP[arrival] + ROW_STEP[k]), abs(COL_STEP[arrival] + COL_STEP[k])
            if max(rows, cols) <= 1 if free_diagonals else rows + cols <= 1:
                masks[arrival] &= ~(1 << k)
    return masks


_SUCCESSORS = {free: _successors(free) for free in (False, True)}

# slots of the float64 array of results
_F_START, _REFUSED, _BEST_H = 0, 1, 2
# slots of the int64 array of results
_EXPANSIONS, _BEST_NODE = 0, 1

_EXPANSIONS_BETWEEN_CHECKS = 100_000
_BELOW = 1.0 - 1e-6
"""Nodes that promise an improvement smaller than g's rounding are left alone."""


@dataclass(frozen=True)
class Region:
    """Where a search may go: a small bitmap over the map, read in place.

    A cell (row, col) is inside when ``bitmap[row_block[row], col_block[col]] == stamp``. Bitmaps are
    numbered rather than cleared.
    """

    bitmap: NDArray[np.int32]
    row_block: NDArray[np.int32]
    """(H,) row of the bitmap for each row of the map."""
    col_block: NDArray[np.int32]
    """(W,) column of the bitmap for each column of the map."""
    stamp: int = 1

    def holds(self, row: int, col: int) -> bool:
        """Whether a cell is inside."""
        return bool(self.bitmap[self.row_block[row], self.col_block[col]] == self.stamp)

    def mask(self) -> NDArray[np.bool_]:
        """(H, W) bool, the region at the map's own size (for pictures and figures, not for planning)."""
        return (self.bitmap == self.stamp)[np.ix_(self.row_block, self.col_block)]

    def area(self) -> int:
        """Number of the map's cells inside."""
        heights = np.bincount(self.row_block, minlength=self.bitmap.shape[0])
        widths = np.bincount(self.col_block, minlength=self.bitmap.shape[1])
        return int(heights @ (self.bitmap == self.stamp) @ widths)


@dataclass(frozen=True)
class Search:
    """What a search came to."""

    status: Status
    path: NDArray[np.int32]
    """(N, 2) cells (row, col) from start to goal; on TIMEOUT to the expanded cell nearest the goal."""
    expansions: int
    refused_f: float
    """Least f of a cell that was refused for lying outside the region; inf if none was."""


@kernel
def _estimate(row, col, goal_row, goal_col, h_straight, h_diagonal):
    dr, dc = abs(row - goal_row), abs(col - goal_col)
    near, far = min(dr, dc), max(dr, dc)
    return h_diagonal * near + h_straight * (far - near)


@kernel
def _begin(g, meta, stamp, fine, coarse, entry_node, entry_next, control, start, h_start, reals, counts):
    clear(fine, coarse, control)
    reals[_F_START] = h_start
    reals[_REFUSED] = np.inf
    reals[_BEST_H] = h_start
    counts[_EXPANSIONS] = 0
    counts[_BEST_NODE] = start
    g[2 * start] = 0.0
    meta[2 * start + 1] = (stamp << STAMP_SHIFT) | OPEN_BIT | ORIGIN
    control[FREE], control[USED] = push(fine, coarse, entry_node, entry_next, 0, start, 0, 0, NOTHING, 0)
    control[LENGTH] = 1


@kernel
def _deal_out(
    chain, block, stride, goal_row, goal_col, h_straight, h_diagonal, inverse_width, f_start,
    g, meta, fine, entry_node, entry_next, free,
):  # fmt: skip
    """Put a coarse bucket's entries into the fine buckets, dropping those no longer open; free, how many dropped."""
    dropped = 0
    while chain != NOTHING:
        following = np.int64(entry_next[chain])
        node = np.int64(entry_node[chain])
        slot = np.int64(FINE)
        if meta[2 * node + 1] & OPEN_BIT:
            h = _estimate(node // stride, node % stride, goal_row, goal_col, h_straight, h_diagonal)
            slot = max(np.int64((g[2 * node] + h - f_start) * inverse_width) - block * FINE, np.int64(0))
        if slot < FINE:
            entry_next[chain] = fine[slot]
            fine[slot] = chain
        else:
            entry_next[chain] = free
            free = chain
            dropped += 1
        chain = following
    return free, dropped


@kernel
def _expand(
    weights, links, stride, goal, steps, successors, corner_cutting, bitmap, row_block, col_block, region_stamp,
    g, meta, stamp, fine, coarse, entry_node, entry_next, control, reals, counts, most,
):  # fmt: skip
    """Expand until the goal is settled, nothing is left, `most` expansions are done or the list is full.

    Once the goal has been reached, its g bounds the optimum: nodes whose f is not lower by more than g's
    rounding are left out, and the search ends when the buckets up to the goal's own are empty.
    """
    length_s, length_d = np.float32(steps[0]), np.float32(steps[1])
    weight_s, weight_d = np.float32(steps[2]), np.float32(steps[3])
    h_straight, h_diagonal, inverse_width = steps[4], steps[5], steps[6]
    goal_row, goal_col = goal // stride, goal % stride
    inverse_stride = 1.0 / stride
    row_steps = (-stride, stride, 0, 0, -stride, -stride, stride, stride)
    f_start, refused, best_h = reals[_F_START], reals[_REFUSED], reals[_BEST_H]
    free, used, fine_at = control[FREE], control[USED], control[FINE_AT]
    block, length = control[BLOCK], control[LENGTH]
    room = np.int64(len(entry_node)) - 8
    bound, last_bucket = np.inf, np.int64(1) << 60
    if meta[2 * goal + 1] >> STAMP_SHIFT == stamp:
        bound = np.float64(g[2 * goal]) * _BELOW
        last_bucket = np.int64((bound - f_start) * inverse_width)
    expansions = counts[_EXPANSIONS]
    last = expansions + most
    code = _PAUSED
    while expansions < last:
        if length > room:
            code = _FULL
            break
        node, fine_at, free = pop(fine, entry_node, entry_next, fine_at, free)
        if block * FINE + fine_at > last_bucket:
            code = _FOUND
            break
        if node == NOTHING:
            if length == 0:
                code = _FOUND if bound < np.inf else _EXHAUSTED
                break
            block, chain = next_block(coarse, block)
            fine_at = np.int64(0)
            free, dropped = _deal_out(
                chain, block, stride, goal_row, goal_col, h_straight, h_diagonal, inverse_width, f_start,
                g, meta, fine, entry_node, entry_next, free,
            )  # fmt: skip
            length -= dropped
            continue
        length -= 1
        word = meta[2 * node + 1]
        if not word & OPEN_BIT:
            continue
        meta[2 * node + 1] = word & ~OPEN_BIT
        row = np.int64((node + 0.5) * inverse_stride)
        col = node - row * stride
        h = _estimate(row, col, goal_row, goal_col, h_straight, h_diagonal)
        own, g_node = weights[node], g[2 * node]
        if g_node + h >= bound:
            continue
        expansions += 1
        if h < best_h:
            best_h = h
            counts[_BEST_NODE] = node
        worthwhile = successors[word & _DIRECTION]
        for k in range(8):  # unrolled by the compiler
            if not (worthwhile >> k) & 1:
                continue
            if links is not None:  # noqa: SIM102  (numba drops the branch when there are none)
                if not (links[node] >> k) & 1:
                    continue
            there = node + row_steps[k] + COL_STEP[k]
            w = weights[there]
            if w == np.inf:
                continue
            if k < 4:
                reached = g_node + (length_s + weight_s * (own + w))
            else:
                if not corner_cutting and (
                    weights[node + row_steps[k]] == np.inf or weights[node + COL_STEP[k]] == np.inf
                ):
                    continue
                reached = g_node + (length_d + weight_d * (own + w))
            old = meta[2 * there + 1]
            if old >> STAMP_SHIFT == stamp and reached >= g[2 * there]:
                continue
            i, j = row + ROW_STEP[k], col + COL_STEP[k]
            f = reached + _estimate(i, j, goal_row, goal_col, h_straight, h_diagonal)
            if f >= bound:
                continue
            if bitmap is not None:  # noqa: SIM102  (numba drops the branch when there is no region)
                if bitmap[row_block[i - 1], col_block[j - 1]] != region_stamp and there != goal:
                    refused = min(refused, f)
                    continue
            g[2 * there] = reached
            meta[2 * there + 1] = (stamp << STAMP_SHIFT) | OPEN_BIT | k
            bucket = np.int64(max((f - f_start) * inverse_width, 0.0))
            if there == goal:
                bound, last_bucket = f * _BELOW, bucket
                meta[2 * there + 1] ^= OPEN_BIT  # never expanded, so never put on the open list
            else:
                free, used = push(fine, coarse, entry_node, entry_next, bucket, there, block, fine_at, free, used)
                length += 1
    control[FREE], control[USED], control[FINE_AT] = free, used, fine_at
    control[BLOCK], control[LENGTH] = block, length
    reals[_REFUSED] = refused
    reals[_BEST_H] = best_h
    counts[_EXPANSIONS] = expansions
    return code


@kernel
def _trace(meta, node, stride, out):
    """Write the cells from `node` back to the start into `out`, as far as it reaches; their number."""
    n = 0
    while True:
        if n < len(out):
            out[n, 0], out[n, 1] = node // stride - 1, node % stride - 1
        n += 1
        k = meta[2 * node + 1] & _DIRECTION
        if k == ORIGIN:
            return n
        node -= ROW_STEP[k] * stride + COL_STEP[k]


def _bucket_width(grid: Grid, straight: float) -> float:
    """Width δ of a bucket: a quarter of the cheapest step, or what lets every f ahead fit into the ring."""
    furthest = 2.0 * grid.model.step(1, 2.0 * max(grid.greatest, 0.0))
    return max(0.25 * straight, 1.01 * furthest / (FINE * (COARSE - 2)), 1e-30)


def astar(
    grid: Grid,
    start: tuple[int, int],
    goal: tuple[int, int],
    workspace: Workspace,
    *,
    region: Region | None = None,
    links: NDArray[np.uint8] | None = None,
    corner_cutting: bool = True,
    deadline: float = math.inf,
    cancelled: Callable[[], bool] | None = None,
) -> Search:
    """Cheapest path between two passable cells of a grid.

    Parameters
    ----------
    grid : Grid
        The map.
    start, goal : (row, col)
        Passable cells; with a region, cells inside it.
    workspace : Workspace
        Scratch memory of the grid's size.
    region : Region
        Search only there.
    links : (nodes,) uint8
        The directions in which each cell may be left, as bits; by default all.
    corner_cutting : bool
        Whether a diagonal step may pass an impassable cell on either side of it.
    deadline : float
        Reading of `time.monotonic` at which to give up with TIMEOUT.
    cancelled : callable
        Asked now and then; True ends the search with TIMEOUT.

    Returns
    -------
    Search
        OK, NO_PATH or TIMEOUT.

    Notes
    -----
    NNPP (arXiv 2308.04792v3), Eq. 2-4; the octile distance stands in for the paper's Euclidean one, which
    it exceeds without ever overestimating. g is kept in float32.
    """
    step = grid.model.step
    straight = step(0, 2.0 * grid.least)
    diagonal = min(step(1, 2.0 * grid.least), 2.0 * straight)
    steps = (*grid.model.length_term, *grid.model.weight_term, straight, diagonal,
             1.0 / _bucket_width(grid, straight))  # fmt: skip
    first, last = grid.node(*start), grid.node(*goal)
    if first == last:
        return Search(Status.OK, np.array([start], np.int32), 0, math.inf)
    ws, stamp = workspace, workspace.next_stamp()
    reals, counts = np.zeros(3), np.zeros(2, np.int64)
    h_start = _estimate.py_func(start[0], start[1], goal[0], goal[1], straight, diagonal)
    _begin(ws.g, ws.meta, stamp, ws.fine, ws.coarse, ws.entry_node, ws.entry_next, ws.control, first,
           h_start, reals, counts)  # fmt: skip
    where = (None, None, None, 0) if region is None else (
        region.bitmap, region.row_block, region.col_block, region.stamp)  # fmt: skip
    successors = _SUCCESSORS[corner_cutting and links is None and grid.model.kind is StepCost.PAPER]
    timed = deadline < math.inf or cancelled is not None
    while True:
        code = _expand(
            grid.weights, links, grid.stride, last, steps, successors, corner_cutting, *where, ws.g, ws.meta, stamp,
            ws.fine, ws.coarse, ws.entry_node, ws.entry_next, ws.control, reals, counts,
            _EXPANSIONS_BETWEEN_CHECKS if timed else np.iinfo(np.int64).max >> 1,
        )  # fmt: skip
        if code == _FULL:
            ws.grow()
        elif code != _PAUSED:
            break
        if timed and (time.monotonic() > deadline or (cancelled is not None and cancelled())):
            break
    expansions, refused = int(counts[_EXPANSIONS]), float(reals[_REFUSED])
    if code == _EXHAUSTED:
        return Search(Status.NO_PATH, np.empty((0, 2), np.int32), expansions, refused)
    end = last if code == _FOUND else int(counts[_BEST_NODE])
    path = np.empty((256, 2), np.int32)
    length = _trace(ws.meta, end, grid.stride, path)
    if length > len(path):
        path = np.empty((length, 2), np.int32)
        _trace(ws.meta, end, grid.stride, path)
    status = Status.OK if code == _FOUND else Status.TIMEOUT
    return Search(status, np.ascontiguousarray(path[:length][::-1]), expansions, refused)


@kernel
def _read_field(g, meta, stamp, stride, field):
    rows, cols = field.shape
    for row in range(rows):
        for col in range(cols):
            node = (row + 1) * stride + col + 1
            field[row, col] = g[2 * node] if meta[2 * node + 1] >> STAMP_SHIFT == stamp else np.inf


def cost_field(
    grid: Grid, source: tuple[int, int], workspace: Workspace, *, corner_cutting: bool = True
) -> NDArray[np.float32]:
    """Cost of the cheapest path from a passable cell to every other: (H, W) float32, inf where there is none."""
    ws, stamp = workspace, workspace.next_stamp()
    reals, counts = np.zeros(3), np.zeros(2, np.int64)
    straight = grid.model.step(0, 2.0 * grid.least)
    steps = (*grid.model.length_term, *grid.model.weight_term, 0.0, 0.0, 1.0 / _bucket_width(grid, straight))
    _begin(ws.g, ws.meta, stamp, ws.fine, ws.coarse, ws.entry_node, ws.entry_next, ws.control,
           grid.node(*source), 0.0, reals, counts)  # fmt: skip
    successors = _SUCCESSORS[corner_cutting and grid.model.kind is StepCost.PAPER]
    corner_of_border = 0  # impassable, so never reached: the search runs until nothing is left
    while _expand(
        grid.weights, None, grid.stride, corner_of_border, steps, successors, corner_cutting, None, None, None, 0,
        ws.g, ws.meta, stamp, ws.fine, ws.coarse, ws.entry_node, ws.entry_next, ws.control, reals, counts,
        np.iinfo(np.int64).max >> 1,
    ) == _FULL:  # fmt: skip
        ws.grow()
    field = np.empty((grid.rows, grid.cols), np.float32)
    _read_field(ws.g, ws.meta, stamp, grid.stride, field)
    return field
