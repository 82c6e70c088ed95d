"""The kernels of the search: expanding nodes in the order of f, and tracing a path back.

f = g + h, and h is the greatest of several lower bounds on the cost that is left: the octile
distance at the price of the map's cheapest cell and, where there are landmarks, |d(landmark, node)
- d(landmark, goal)| for each of them, by the triangle inequality.

Indices are cast to unsigned where they are used: numba would otherwise look at each whether it is
negative, as Python's indices may be, which took a tenth of a search's time.
"""

import numpy as np
from numpy import float32, float64, inf, int64, uint64
from numpy.typing import NDArray

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.by_address import blank
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import (
    COL_STEP,
    DIRECTION_BITS,
    EXHAUSTED,
    FOUND,
    FULL,
    OPEN_BIT,
    ORIGIN,
    PAUSED,
    ROW_STEP,
    beside_wall,
    fetch_around,
    g_of,
    lowest_bit,
    neighbour,
    octile,
    outside,
    put_word,
    step_cost,
    visit,
    word_of,
)
from nnpp_edge.runtime.kernels.open_list import (
    NOTHING,
    empty,
    known,
    push,
    refuse,
    resumed,
    stop_at,
    suspend,
    taking_by,
    wait,
)
from nnpp_edge.runtime.kernels.pooling import NO_LINKS as NO_LINKS
from nnpp_edge.runtime.kernels.records import (
    BEST_H,
    BEST_NODE,
    EXPANSIONS,
    Ends,
    GridRecord,
    Hints,
    Judge,
    Limits,
    Memory,
    RegionRecord,
    Rule,
    StepTerms,
    Task,
)
from nnpp_edge.runtime.kernels.tiles import open_at

MOST_LANDMARKS = 8
"""Landmarks that a node has room for."""
_LOOK_EVERY = 1024
"""Expansions between two readings of the clock."""
NO_HINTS = tuple(
    Hints(np.empty((0, MOST_LANDMARKS), float32), np.empty(MOST_LANDMARKS, float32), 0.0)
)
NO_REGION = tuple(blank(RegionRecord))
"""Of a search without these: a flag, where None would compile another search."""
BELOW = 1.0 - 1e-6
"""Nodes that promise an improvement smaller than g's rounding are left alone."""


def _successors(square: int) -> NDArray[np.int64]:
    """For each direction of arrival (and none, the start's) the directions worth leaving in, as
    bits: those to cells from which the square of the distance to the parent, which would reach them
    at no higher cost, is greater.
    """
    masks = np.full(ORIGIN + 1, 255, np.int64)
    for arrival in range(8):
        for k in range(8):
            down = ROW_STEP[arrival] + ROW_STEP[k]
            right = COL_STEP[arrival] + COL_STEP[k]
            if down**2 + right**2 <= square:
                masks[arrival] &= ~(1 << k)
    return masks


SUCCESSORS = tuple(map(_successors, range(3)))
"""0: all but the parent, where links decide which neighbours a cell has. 1: none a straight step
from the parent, for every step-cost model. 2: none a diagonal away either, where it is never
dearer than the two straight steps around its corner, and never forbidden where they are allowed."""


@inlined
def _distance(row, col, judge):
    """The octile distance to the goal."""
    return octile(row, col, judge.goal_row, judge.goal_col, judge.h_straight, judge.h_diagonal)


@inlined
def _apart(hints, node):
    """The greatest difference to the goal's costs from the landmarks."""
    furthest = float32(0.0)
    for lane in range(MOST_LANDMARKS):
        # inf where only one of the two is connected to the landmark; NaN, which is passed over,
        # where neither is
        field = hints.fields[uint64(node), uint64(lane)]
        apart = abs(field - hints.at_goal[uint64(lane)])
        furthest = apart if apart > furthest else furthest
    return furthest


@helper
def _left(node, judge):
    """A lower bound on what a way from a node costs."""
    hints = judge.hints
    h = _distance(node // judge.stride, node % judge.stride, judge)
    return max(h, _apart(hints, node) - hints.slack) if len(hints.fields) else h


_take = taking_by(_left)


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
        node -= neighbour(0, k, stride)


@inlined
def _in_float32(steps):
    """`StepTerms` in the numbers that g is summed up in."""
    return StepTerms(
        float32(steps.length_straight),
        float32(steps.length_diagonal),
        float32(steps.weight_straight),
        float32(steps.weight_diagonal),
    )


@inlined
def _improved(node, g_node, task):
    """The neighbours, as bits, that are reached at a lower g than before by way of a node."""
    weights = task.grid.weights
    edges = task.grid.edges
    own = weights[uint64(node)]
    better = int64(0)
    for k in range(8):  # unrolled by the compiler
        there = neighbour(node, k, task.grid.stride)
        if len(edges):
            step = edges[uint64(node), uint64(k)]
        else:  # inf where impassable
            step = step_cost(k >= 4, own + weights[uint64(there)], task.terms)
        better |= int64(g_node + step < known(task.memory, there)) << k
    return better


@inlined
def _relax(node, row, col, k, g_node, own, task, front):
    """Relax the step in direction k from a node, which comes to a lower g there than before."""
    weights = task.grid.weights
    edges = task.grid.edges
    hints = task.judge.hints
    goal = task.judge.goal
    down = int64(ROW_STEP[k])
    right = int64(COL_STEP[k])
    down_nodes = down * task.grid.stride
    there = int64(node + down_nodes + right)
    if len(edges):
        reached = g_node + edges[uint64(node), uint64(k)]
    else:
        checked = k >= 4 and not task.grid.corner_cutting
        if checked and beside_wall(weights, node, down_nodes, right):
            return front
        reached = g_node + step_cost(k >= 4, own + weights[uint64(there)], task.terms)
    h = _distance(row + down, col + right, task.judge)
    if len(hints.fields):
        h = max(h, _apart(hints, there) - hints.slack)
    f = reached + h
    if f >= front.bound:
        return front
    in_region = len(task.region.bitmap) == 0 or there == goal
    if not in_region and outside(task.region, row + down, col + right):
        return refuse(front, f)
    if there == goal:  # never expanded, so never put on the open list
        visit(task.memory, there, reached, k)
        return stop_at(front, f * task.beyond)
    visit(task.memory, there, reached, OPEN_BIT | k)
    fetch_around(weights, 1, there, task.grid.stride)
    fetch_around(task.memory.meta, 2, there, task.grid.stride)
    if len(hints.fields):
        fetch_around(hints.fields, MOST_LANDMARKS, there, task.grid.stride)
    return wait(task.memory, front, f, there)


@inlined
def _set_out(start, h, width, memory):
    """Begin a search: the start alone is on the open list."""
    queue = push(memory, empty(memory, h, width), int64(0), start)
    suspend(memory, queue, inf, 0)
    visit(memory, start, 0.0, OPEN_BIT | ORIGIN)
    memory.reals[BEST_H] = inf
    memory.control[BEST_NODE] = start


@kernel
def expand(
    grid: GridRecord,
    links,
    region: RegionRecord,
    hints: Hints,
    beyond,
    ends: Ends,
    rule: Rule,
    memory: Memory,
    limits: Limits,
):
    """Search until the goal is settled, nothing is left, `most` expansions are done, it is late or
    the list is full.

    Begins at the start, or goes on where the last call stopped if that is negative. Once the goal
    has been reached, `beyond` times its g bounds what is looked at: nodes whose f is not lower are
    left out, and the search ends when the buckets up to the bound's own are empty. `BELOW` gives
    the optimum; with more than 1, every node on a path that costs less than `beyond` times the
    optimum is settled.

    Parameters
    ----------
    grid, region, hints, ends, rule, memory, limits
        Records, see `kernels.records`.
    links : (nodes,) uint8
        The directions in which each cell may be left, as bits; `NO_LINKS` where passability
        decides.

    Returns
    -------
    tuple
        What it came to; the number of cells, start and goal included, of the path to the goal or,
        when it is not found, to the expanded node nearest it, of which as many as there is room for
        are in `path`, goal first; the expansions so far; and the least f of a node that the region
        refused.
    """
    stride = grid.stride
    goal = ends.goal
    place = (stride, goal, goal // stride, goal % stride)
    judge = Judge(*place, rule.h_straight, rule.h_diagonal, hints)
    task = Task(grid, _in_float32(grid.steps), region, judge, beyond, memory)
    if ends.start >= 0:
        h = _left(ends.start, judge)
        _set_out(ends.start, h, rule.width, memory)
        if h == inf:  # a landmark is connected to only one of the two
            return EXHAUSTED, 0, 0, inf
    front = resumed(memory, float64(known(memory, goal)) * beyond)
    best_h = memory.reals[BEST_H]
    room = int64(len(memory.entries)) // 2 - 8
    inverse_stride = 1.0 / stride
    expansions = memory.control[EXPANSIONS]
    last = expansions + limits.most
    look_at = expansions + _LOOK_EVERY
    code = PAUSED
    while expansions < last:
        if expansions >= look_at:
            look_at = expansions + _LOOK_EVERY
            if late(limits.until):
                break
        if front.queue.length > room:
            code = FULL
            break
        # take an open node of the least f, and close it
        node, front = _take(memory, judge, front)
        if node == NOTHING:
            code = FOUND if front.bound < inf else EXHAUSTED
            break
        word = word_of(memory.meta, node)
        put_word(memory.meta, node, word & ~OPEN_BIT)
        row = int64((node + 0.5) * inverse_stride)
        col = node - row * stride
        h = _distance(row, col, judge)
        g_node = g_of(memory.g, node)
        if g_node + h >= front.bound:
            continue
        # expand it: the neighbours that are reached at a lower g than before, without a branch, and
        # then the steps to these alone
        if open_at(grid.tiles, row - 1, col - 1):
            look_at = expansions
        expansions += 1
        if h < best_h:
            best_h = h
            memory.control[BEST_NODE] = node
        better = _improved(node, g_node, task)
        better &= rule.successors[uint64(word & DIRECTION_BITS)]
        if len(links) > 0:
            better &= int64(links[uint64(node)])
        own = grid.weights[uint64(node)]
        while better:
            k = lowest_bit(better)
            better &= better - 1
            front = _relax(node, row, col, k, g_node, own, task, front)
    suspend(memory, front.queue, front.refused, expansions)
    memory.reals[BEST_H] = best_h
    if code == FOUND:
        memory.control[BEST_NODE] = goal
    cells = trace(memory.meta, memory.control[BEST_NODE], stride, memory.path)
    return code, cells, expansions, front.refused
