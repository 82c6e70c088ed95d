"""The search over a body's states: a cell and one of sixteen directions, in which the body stands there.

A state, node * 16 + direction (`map.motions`), leads along its direction to another cell (a leg), and to the two
directions beside it (turns on the spot). `kernels.poses` checks them where the search first asks: until then they
count as possible. What is left from a state is judged by a field, costs from cells to the goal that are found before.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.by_address import borrowed
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.expansion import (
    BASE,
    BEST_H,
    BEST_NODE,
    EXHAUSTED,
    EXPANSIONS,
    FOUND,
    FULL,
    INVERSE_WIDTH,
    PAUSED,
    REFUSED,
)
from nnpp_edge.runtime.kernels.nodes import DIRECTION_BITS, OPEN_BIT, STAMP_SHIFT
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
from nnpp_edge.runtime.kernels.poses import AXES, FAILS, UNCHECKED, check_there, motion_weight

DIRECTIONS, PER_NODE = 16, 4
"""Directions of a node, and binary digits of their number."""
ROWS = (1, 2, 1, 1, 0, -1, -1, -2, -1, -2, -1, -1, 0, 1, 1, 2)
COLS = (0, 1, 1, 2, 1, 2, 1, 1, 0, -1, -1, -2, -1, -2, -1, -1)
KNIGHT = math.sqrt(5.0) / (1.0 + math.sqrt(2.0))
"""A knight's leg over a straight and a diagonal one."""
LEG, LEFT, RIGHT, ORIGIN = 0, 1, 2, 3
"""How a state was come to."""
_MASK = DIRECTIONS - 1
LOOK_EVERY = 8
"""Expansions between two looks at the clock, as each may check poses."""


@helper
def left_over(rows, cols, prices):
    """Least cost of a way so many rows and columns on; `prices`, of straight, diagonal and knight's legs."""
    near, far = min(rows, cols), max(rows, cols)
    straight, diagonal, knight = prices
    if 2 * near <= far:
        return straight * (far - 2 * near) + knight * near
    return knight * (far - near) + diagonal * (2 * near - far)


@helper
def _left(place, judge):
    """A lower bound on what a way from a place costs: the field's where that is settled, else by distances."""
    (per_node, stride, goal_row, goal_col, best), (g, meta, stamp, start_row, start_col, floor, between) = judge
    node = place >> per_node
    row = node // stride
    col = node - row * stride
    left = left_over(abs(row - goal_row), abs(col - goal_col), best)
    if len(g):
        word = meta[np.uint64(2 * node + 1)]
        if word & ~DIRECTION_BITS == stamp << STAMP_SHIFT:
            left = np.float64(g[np.uint64(2 * node)])
            return left + between[place & _MASK, word & DIRECTION_BITS] if len(between) and left > 0.0 else left
        left = max(left, floor - left_over(abs(row - start_row), abs(col - start_col), best))
    return left


_refill = refill_by(_left)


@helper
def _outside(allowed, row, col):
    """Whether a region, as everywhere, lacks a cell, numbered within the border."""
    bitmap, row_block, col_block, stamp = allowed
    return bitmap[np.uint64(row_block[np.uint64(row - 1)]), np.uint64(col_block[np.uint64(col - 1)])] != stamp


@kernel
def trace_states(meta, state, stride, out):
    """Write the cells from a state back to the start into `out`, as far as it reaches; their number."""
    n = 0
    last = -1
    while True:
        node = state >> PER_NODE
        if node != last:
            if n < len(out):
                out[n, 0], out[n, 1] = node // stride - 1, node % stride - 1
            n, last = n + 1, node
        way, k = meta[2 * state + 1] & DIRECTION_BITS, state & _MASK
        if way == ORIGIN:
            return n
        if way == LEG:
            state -= (ROWS[k] * stride + COLS[k]) << PER_NODE
        else:
            state += ((k - 1 if way == LEFT else k + 1) & _MASK) - k


@kernel
def fill_field(grid, poses, edges, prices, region, ends, rule, memory, limits):
    """Costs to the goal of the cells from which a way to it may be part of the best one.

    Arguments as for `expand_states`, but for memory, which is that of nodes, `ends`, (goal, start, goal), the first
    -1 to go on, and `rule`, (towards, width, between). Searches from the goal until the start is settled; each leg is
    that of the way back. Without `between` turns are free, and no way costs less. With the costs of turns `between`
    directions, (16, 16) float32, each cell's cost is that of a way with its turns: as the cell's best way on is what
    counts for all that come to it, nearly the least. Returns the code, the expansions, and the least f of a node that
    the region refused.
    """
    _, stride, _, _, _ = grid
    goal, start, goal_node = ends
    lengths, unit, turn_prices, _ = prices
    best, width, between = rule
    between = borrowed(between)
    most, until = limits
    legs, rows, cols = borrowed(poses[0]), poses[2][5][0], poses[2][5][1]
    g, meta, stamp, heads, entries, control, reals, counts, _ = memory
    g, meta, heads, entries = borrowed(g), borrowed(meta), borrowed(heads), borrowed(entries)
    allowed = borrowed(region[0]), borrowed(region[1]), borrowed(region[2]), region[3]
    edges, lengths = borrowed(edges), borrowed(lengths)
    regional, by_edges = len(region[0]) > 0, len(edges) > 0
    start_row, start_col = start // stride, start % stride
    judge = (0, stride, start_row, start_col, best), (g[:0], meta[:0], 0, 0, 0, 0.0, between[:0])
    if goal >= 0:
        clear(heads, control)
        control[FREE], control[USED] = push(heads, entries, 0, goal, 0, 0, NOTHING, 0)
        control[LENGTH] = 1
        g[2 * goal] = 0.0
        meta[2 * goal + 1] = (stamp << STAMP_SHIFT) | OPEN_BIT
        reals[BASE], reals[INVERSE_WIDTH] = _left(goal, judge), 1.0 / width
        reals[REFUSED] = np.inf
        counts[EXPANSIONS] = 0
    order, refused = (reals[BASE], reals[INVERSE_WIDTH]), reals[REFUSED]
    free, used, fine_at = control[FREE], control[USED], control[FINE_AT]
    block, waiting = control[BLOCK], control[LENGTH]
    room = np.int64(len(entries)) // 2 - DIRECTIONS - 1
    bound, last_bucket = np.inf, np.int64(SPAN)
    if meta[2 * start + 1] >> STAMP_SHIFT == stamp:
        bound = np.float64(g[2 * start])
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
            rest = _refill(judge, bound, block, order, g, meta, heads, entries, free, waiting)
            block, fine_at, order, free, waiting, last_bucket = rest
            continue
        waiting -= 1
        word = meta[np.uint64(2 * node + 1)]
        if not word & OPEN_BIT:
            continue
        g_node = g[np.uint64(2 * node)]
        row = node // stride
        col = node - row * stride
        if g_node + left_over(abs(row - start_row), abs(col - start_col), best) >= bound:
            continue  # and stays open: what it costs may not be the least
        meta[np.uint64(2 * node + 1)] = word & ~OPEN_BIT
        onwards = word & DIRECTION_BITS
        expansions += 1
        for k in range(DIRECTIONS):
            i, j = row - ROWS[k], col - COLS[k]
            if not (1 <= i <= rows and 1 <= j <= cols):
                continue
            there, axis = i * stride + j, k & 7
            at = there if k < AXES else node
            found = np.int64(legs[np.uint64(at), np.uint64(axis)])
            if found >= FAILS:
                continue
            if by_edges:
                step = edges[np.uint64(there), np.uint64(k)]
            else:
                step = lengths[axis] * (np.float32(1.0) + motion_weight(found, unit))
            known = np.float32(np.inf)
            if meta[np.uint64(2 * there + 1)] >> STAMP_SHIFT == stamp:
                known = g[np.uint64(2 * there)]
            turned = between[k, onwards] if len(between) and node != goal_node else np.float32(0.0)
            reached = g_node + (step + turned)
            if not reached < known:
                continue
            left = left_over(abs(i - start_row), abs(j - start_col), best)
            if reached + left >= bound:
                continue
            if regional and there != start and _outside(allowed, i, j):
                refused = min(refused, reached + left)
                continue
            if found == UNCHECKED:
                check_there(poses, at // stride - 1, at % stride - 1, axis)
                found = np.int64(legs[np.uint64(at), np.uint64(axis)])
                if found >= FAILS:
                    continue
                if not by_edges:
                    step = lengths[axis] * (np.float32(1.0) + motion_weight(found, unit))
            reached = g_node + np.float32(step + turned)
            if not reached < known or reached + left >= bound:
                continue
            g[np.uint64(2 * there)] = reached
            meta[np.uint64(2 * there + 1)] = (stamp << STAMP_SHIFT) | OPEN_BIT | k
            if there == start:
                bound = np.float64(reached)
                last_bucket = last_bucket_below(bound, *order)
            else:
                bucket = bucket_of(reached + left, *order)
                free, used = push(heads, entries, bucket, there, block, fine_at, free, used)
                waiting += 1
    control[FREE], control[USED], control[FINE_AT] = free, used, fine_at
    control[BLOCK], control[LENGTH] = block, waiting
    reals[BASE], reals[INVERSE_WIDTH], reals[REFUSED] = order[0], order[1], refused
    counts[EXPANSIONS] = expansions
    return code, expansions, refused


@kernel
def expand_states(grid, poses, edges, prices, field, region, ends, rule, memory, limits):
    """As `kernels.expansion.expand`, over a body's states.

    Parameters
    ----------
    grid : tuple
        As everywhere.
    poses : tuple
        Of the body, see `kernels.poses`. What a leg or a turn needs of them is checked.
    edges : (nodes, 16) float32
        What the leg that leaves a node in each direction costs, inf where there is none; without any, legs cost by
        what they are checked to be.
    prices : (lengths, unit, turns)
        (8,) float32 what a leg of each axis costs on the best ground; by how much each step of its code makes it
        dearer, as a share; (8,) float32 what a turn from each direction to the next costs.
    field : (g, meta, stamp, row, col, floor, between)
        What `fill_field` left, the number of that search, the start, and what it costs from there; no g without one.
        With costs of turns `between` directions, (16, 16) float32, if it was filled by these.
    region, memory, limits
        As there; memory is that of the states.
    ends : (start, goal, first)
        Nodes, and the direction at the start; -1 where any will do.
    rule : (towards, width, beyond)
        Costs of straight, diagonal and knight's legs by which what is left is judged; else as there.

    Returns
    -------
    tuple
        As there; once the goal is found, `counts` has its state in the place of the nearest one's.
    """
    _, stride, _, _, _ = grid
    start, goal, first = ends
    lengths, unit, turn_prices, _ = prices
    best, width, beyond = rule
    most, until = limits
    legs, turns, rows, cols = borrowed(poses[0]), borrowed(poses[1]), poses[2][5][0], poses[2][5][1]
    g, meta, stamp, heads, entries, control, reals, counts, path = memory
    g, meta, heads, entries = borrowed(g), borrowed(meta), borrowed(heads), borrowed(entries)
    allowed = borrowed(region[0]), borrowed(region[1]), borrowed(region[2]), region[3]
    edges, lengths, turn_prices = borrowed(edges), borrowed(lengths), borrowed(turn_prices)
    regional, by_edges = len(region[0]) > 0, len(edges) > 0
    goal_row, goal_col = goal // stride, goal % stride
    field = borrowed(field[0]), borrowed(field[1]), field[2], field[3], field[4], field[5], borrowed(field[6])
    judge = (PER_NODE, stride, goal_row, goal_col, best), field
    if start >= 0:
        h = _left(start << PER_NODE, judge)
        clear(heads, control)
        free, used, waiting = np.int64(NOTHING), np.int64(0), 0
        for k in range(DIRECTIONS):
            if first < 0 or first == k:
                state = start * DIRECTIONS + k
                free, used = push(heads, entries, 0, state, 0, 0, free, used)
                g[2 * state] = 0.0
                meta[2 * state + 1] = (stamp << STAMP_SHIFT) | OPEN_BIT | ORIGIN
                waiting += 1
        control[FREE], control[USED], control[LENGTH] = free, used, waiting
        reals[BASE], reals[INVERSE_WIDTH], reals[REFUSED], reals[BEST_H] = h, 1.0 / width, np.inf, np.inf
        counts[EXPANSIONS], counts[BEST_NODE] = 0, start * DIRECTIONS + max(first, 0)
    order, refused, best_h = (reals[BASE], reals[INVERSE_WIDTH]), reals[REFUSED], reals[BEST_H]
    free, used, fine_at = control[FREE], control[USED], control[FINE_AT]
    block, waiting = control[BLOCK], control[LENGTH]
    room = np.int64(len(entries)) // 2 - DIRECTIONS - 3
    bound, last_bucket, settled = np.inf, np.int64(SPAN), np.int64(-1)
    for k in range(DIRECTIONS):
        state = goal * DIRECTIONS + k
        found_before = start < 0 and meta[2 * state + 1] >> STAMP_SHIFT == stamp
        if found_before and g[2 * state] * beyond < bound:
            bound, settled = np.float64(g[2 * state]) * beyond, state
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
        state, fine_at, free = pop(heads, entries, fine_at, free)
        if block * FINE + fine_at > last_bucket:
            code = FOUND
            break
        if state == NOTHING:
            if waiting == 0:
                code = FOUND if settled >= 0 else EXHAUSTED
                break
            rest = _refill(judge, bound, block, order, g, meta, heads, entries, free, waiting)
            block, fine_at, order, free, waiting, last_bucket = rest
            continue
        waiting -= 1
        word = meta[np.uint64(2 * state + 1)]
        if not word & OPEN_BIT:
            continue
        meta[np.uint64(2 * state + 1)] = word & ~OPEN_BIT
        node, k = state >> PER_NODE, state & _MASK
        row = node // stride
        col = node - row * stride
        h = _left(state, judge)
        g_state = g[np.uint64(2 * state)]
        if g_state + h >= bound:
            continue
        expansions += 1
        if h < best_h:
            best_h = h
            counts[BEST_NODE] = state
        for way in range(3):
            i, j, across, to = row, col, node, k
            at, axis, motion = node, k & 7, k & 7
            if way == LEG:
                i, j = row + ROWS[k], col + COLS[k]
                if not (1 <= i <= rows and 1 <= j <= cols):
                    continue
                across = i * stride + j
                at = node if k < AXES else across
                found = np.int64(legs[np.uint64(at), np.uint64(axis)])
                if found >= FAILS:
                    continue
                checked = found != UNCHECKED
                if by_edges:
                    step = edges[np.uint64(node), np.uint64(k)]
                else:
                    step = lengths[axis] * (np.float32(1.0) + motion_weight(found, unit))
            else:
                if word & DIRECTION_BITS == LEFT + RIGHT - way:
                    continue
                to = (k + 1) & _MASK if way == LEFT else (k - 1) & _MASK
                axis = k & 7 if way == LEFT else to & 7
                bits = np.int64(turns[np.uint64(node)]) >> axis
                checked = bits & 1 != 0
                if checked and not bits >> AXES & 1:
                    continue
                motion, step = AXES + axis, turn_prices[axis]
            there = across * DIRECTIONS + to
            known = np.float32(np.inf)
            if meta[np.uint64(2 * there + 1)] >> STAMP_SHIFT == stamp:
                known = g[np.uint64(2 * there)]
            reached, left = g_state + step, _left(there, judge)
            f = reached + left
            if not reached < known or f >= bound:
                continue
            if regional and way == LEG and across != goal and _outside(allowed, i, j):
                refused = min(refused, f)
                continue
            if not checked:
                check_there(poses, at // stride - 1, at % stride - 1, motion)
                if way == LEG:
                    found = np.int64(legs[np.uint64(at), np.uint64(axis)])
                    if found >= FAILS:
                        continue
                    if not by_edges:
                        reached = g_state + lengths[axis] * (np.float32(1.0) + motion_weight(found, unit))
                        f = reached + left
                        if not reached < known or f >= bound:
                            continue
                elif not np.int64(turns[np.uint64(node)]) >> (AXES + axis) & 1:
                    continue
            g[np.uint64(2 * there)] = reached
            come = np.int64((stamp << STAMP_SHIFT) | OPEN_BIT | way)
            if across == goal:
                come ^= OPEN_BIT  # never expanded, so never put on the open list
                bound, settled = f * beyond, there
                last_bucket = last_bucket_below(bound, *order)
            else:
                free, used = push(heads, entries, bucket_of(f, *order), there, block, fine_at, free, used)
                waiting += 1
            meta[np.uint64(2 * there + 1)] = come
    control[FREE], control[USED], control[FINE_AT] = free, used, fine_at
    control[BLOCK], control[LENGTH] = block, waiting
    reals[BASE], reals[INVERSE_WIDTH], reals[REFUSED], reals[BEST_H] = order[0], order[1], refused, best_h
    counts[EXPANSIONS] = expansions
    if code == FOUND:
        counts[BEST_NODE] = settled
    cells = 0
    if code != FULL:
        cells = trace_states(meta, counts[BEST_NODE], stride, path)
    return code, cells, expansions, refused


@kernel
def walk_states(poses, edges, prices, stride, path, first, costs):
    """Write what a body's path (N, 2) costs from its cell `first` to each later one into `costs` (N,).

    Returns the number of the first cell that a failing leg or turn leads to, from `first` on; -1 if all pass. The
    turn at `first` must pass, too, but is not counted.
    """
    lengths, unit, turn_prices, _ = prices
    legs = poses[0]
    total, before = 0.0, -1
    if first == 0:
        costs[:1] = 0.0
    for n in range(max(first, 1), len(path)):
        k = direction_of(path[n, 0] - path[n - 1, 0], path[n, 1] - path[n - 1, 1])
        node = (path[n - 1, 0] + 1) * stride + path[n - 1, 1] + 1
        if n == first:  # the leg before: only its direction counts
            before, costs[n] = k, 0.0
            continue
        if before >= 0 and before != k:
            price = turn_price(poses, turn_prices, stride, node, before, k)
            if price == np.inf:
                return n
            total += price if n > first + 1 else 0.0
        axis = k & 7
        at = node if k < AXES else (path[n, 0] + 1) * stride + path[n, 1] + 1
        if legs[at, axis] == UNCHECKED:
            check_there(poses, at // stride - 1, at % stride - 1, axis)
        if legs[at, axis] >= FAILS:
            return n
        if len(edges):
            total += edges[node, k]
        else:
            total += lengths[axis] * (1.0 + motion_weight(legs[at, axis], unit))
        costs[n], before = total, k
    return -1


@helper
def direction_of(rows, cols):
    """Number of the direction of a leg; -1 where it is none."""
    for k in range(DIRECTIONS):
        if ROWS[k] == rows and COLS[k] == cols:
            return k
    return -1


@helper
def turn_price(poses, turn_prices, stride, node, before, after):
    """Cost of turning on a node to another direction, the shorter way; inf where impossible (both ways are)."""
    left = (after - before) & _MASK <= DIRECTIONS // 2
    total, k = 0.0, before
    while k != after and total < np.inf:
        axis = k & 7 if left else (k - 1) & 7
        if not poses[1][node] >> axis & 1:
            check_there(poses, node // stride - 1, node % stride - 1, AXES + axis)
        total = total + turn_prices[axis] if poses[1][node] >> (AXES + axis) & 1 else np.inf
        k = (k + 1 if left else k - 1) & _MASK
    return total
