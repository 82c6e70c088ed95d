"""The search over a body's states: a cell, one of sixteen directions in which the body stands
there, and its gear.

A state is left by motion primitives: legs, turns on the spot and arcs (`robots.body.primitives`).
One that nobody has checked counts as possible and cheap until the state that it leads to would be
expanded: only then `kernels.poses` checks it. If it fails, or is dearer, the state waits for the
next best way to it. What is left from a state is judged by a field, costs from cells to the goal
that are found before.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.buckets import (
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
from nnpp_edge.runtime.kernels.by_address import borrowed
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import (
    DIRECTION_BITS,
    EXHAUSTED,
    FOUND,
    FULL,
    OPEN_BIT,
    ORIGIN,
    PAUSED,
    STAMP_SHIFT,
    UNSURE_BIT,
)
from nnpp_edge.runtime.kernels.poses import AXES, FAILS, UNCHECKED, check_there, motion_weight
from nnpp_edge.runtime.kernels.records import (
    BASE,
    BEST_H,
    BEST_NODE,
    BOUND,
    EXPANSIONS,
    GOAL_STATE,
    INVERSE_WIDTH,
    REFUSED,
)

DIRECTIONS = 16
ROWS = (1, 2, 1, 1, 0, -1, -1, -2, -1, -2, -1, -1, 0, 1, 1, 2)
COLS = (0, 1, 1, 2, 1, 2, 1, 1, 0, -1, -1, -2, -1, -2, -1, -1)
KNIGHT = math.sqrt(5.0) / (1.0 + math.sqrt(2.0))
"""A knight's leg over a straight and a diagonal one."""
DOWN, RIGHT, TO, MOTION, THERE, EDGE = range(6)
"""Of a primitive: rows and columns to the cell that it leads to, the state there among those of
a cell (-1 where no such primitive is); the motion that is checked, and whether that begins
there; the direction of a leg, else -1."""
BY_LENGTH = 0
FIXED = 1
"""Of what a primitive costs: cells on the best ground, which its code makes dearer, and what comes
to it always.
"""
LEG = 0
LEFT_TURN = 1
"""Primitives of a body that turns on the spot; `LEFT_TURN` + 1 is the one to the right."""
_MASK = DIRECTIONS - 1
LOOK_EVERY = 8
"""Expansions between two readings of the clock, as each may check poses."""


@helper
def left_over(rows, cols, prices):
    """Least cost of a way so many rows and columns on; `prices`, of straight, diagonal and knight's
    legs.
    """
    near = min(rows, cols)
    far = max(rows, cols)
    straight, diagonal, knight = prices
    if 2 * near <= far:
        return straight * (far - 2 * near) + knight * near
    return knight * (far - near) + diagonal * (2 * near - far)


@helper
def _place(state, frame):
    """Row and column within the border of a state, and its number among those of its cell."""
    bits, stride = frame
    node = state >> bits
    row = node // stride
    return row, node - row * stride, state & ((1 << bits) - 1)


@helper
def _state(row, col, local, frame):
    """The state of that number on a cell."""
    bits, stride = frame
    return ((row * stride + col) << bits) + local


@helper
def _left_at(row, col, local, judge):
    """A lower bound on what a way from a state costs: the field's where that is settled, else by
    distances.
    """
    (
        (_, stride),
        (goal_row, goal_col, best),
        (g, meta, stamp, start_row, start_col, floor, between),
    ) = judge
    left = left_over(abs(row - goal_row), abs(col - goal_col), best)
    if len(g):
        node = row * stride + col
        word = meta[np.uint64(2 * node + 1)]
        if word & ~DIRECTION_BITS == stamp << STAMP_SHIFT:
            left = np.float64(g[np.uint64(2 * node)])
            return (
                left + between[local & _MASK, word & DIRECTION_BITS]
                if len(between) and left > 0.0
                else left
            )
        left = max(left, floor - left_over(abs(row - start_row), abs(col - start_col), best))
    return left


@helper
def _left(state, judge):
    """As `_left_at`, of a state."""
    row, col, local = _place(state, judge[0])
    return _left_at(row, col, local, judge)


@helper
def _left_of_cell(node, judge):
    """By distances alone, of a cell."""
    stride, goal_row, goal_col, best = judge
    row = node // stride
    return left_over(abs(row - goal_row), abs(node - row * stride - goal_col), best)


_refill = refill_by(_left)
_refill_cells = refill_by(_left_of_cell)


@helper
def _outside(allowed, row, col):
    """Whether a region, as everywhere, lacks a cell, numbered within the border."""
    bitmap, row_block, col_block, stamp = allowed
    return (
        bitmap[np.uint64(row_block[np.uint64(row - 1)]), np.uint64(col_block[np.uint64(col - 1)])]
        != stamp
    )


@kernel
def trace_states(meta, state, prices, frame, out):
    """Write the states from one back to the start, (row, col, number), into `out`, as far as it
    reaches; how many.
    """
    _, moves, _, origins, _, _, _ = prices
    n = 0
    while True:
        row, col, local = _place(state, frame)
        if n < len(out):
            out[n, 0] = row - 1
            out[n, 1] = col - 1
            out[n, 2] = local
        n += 1
        way = meta[2 * state + 1] & DIRECTION_BITS
        if way == ORIGIN:
            return n
        before = origins[local, way]
        state = _state(
            row - moves[before, way, DOWN], col - moves[before, way, RIGHT], before, frame
        )


@kernel
def fill_field(poses, edges, prices, region, seeds, ends, rule, memory, limits):
    """Costs to the goal of the cells from which a way to it may be part of the best one.

    Arguments as for `expand_states`, but for memory, which is that of nodes, `seeds`, (nodes,
    costs, onwards), the cells that it begins with, what they cost and the direction in which the
    way on leaves them, `ends`, (goal, start), the first -1 to go on with what is on the open list,
    and `rule`, (towards, width, between). Searches from the seeds until the start is settled, by
    the rays of `prices`. Without `between` turns are free, and no way costs less. With the costs of
    turns `between` directions, (16, 16) float32, each cell's cost is that of a way with its turns:
    as the cell's best way on is what counts for all that come to it, nearly the least. Returns the
    code, the expansions, and the least f of a node that the region refused.
    """
    goal, start = ends
    unit = prices[0]
    rays = borrowed(prices[4])
    lengths = borrowed(prices[5])
    best, width, between = rule
    between = borrowed(between)
    most, until = limits
    codes = borrowed(poses[0])
    rows = poses[1][5][0]
    cols = poses[1][5][1]
    stride = cols + 2
    g, meta, stamp, heads, entries, control, reals, counts, _ = memory
    g = borrowed(g)
    meta = borrowed(meta)
    heads = borrowed(heads)
    entries = borrowed(entries)
    allowed = borrowed(region[0]), borrowed(region[1]), borrowed(region[2]), region[3]
    edges = borrowed(edges)
    regional = len(region[0]) > 0
    by_edges = len(edges) > 0
    start_row = start // stride
    start_col = start % stride
    judge = stride, start_row, start_col, best
    if goal >= 0:
        clear(heads, control)
        reals[BASE] = _left_of_cell(goal, judge)
        reals[INVERSE_WIDTH] = 1.0 / width
        reals[REFUSED] = np.inf
        counts[EXPANSIONS] = 0
        nodes, costs, ways = seeds
        for n in range(len(nodes)):
            node = np.int64(nodes[n])
            left = _left_of_cell(node, judge)
            bucket = bucket_of(costs[n] + left, reals[BASE], reals[INVERSE_WIDTH])
            control[FREE], control[USED] = push(
                heads, entries, bucket, node, 0, 0, control[FREE], control[USED]
            )
            g[2 * node] = costs[n]
            meta[2 * node + 1] = (stamp << STAMP_SHIFT) | OPEN_BIT | ways[n]
        control[LENGTH] = len(nodes)
    order = (reals[BASE], reals[INVERSE_WIDTH])
    refused = reals[REFUSED]
    free = control[FREE]
    used = control[USED]
    fine_at = control[FINE_AT]
    block = control[BLOCK]
    waiting = control[LENGTH]
    room = np.int64(len(entries)) // 2 - len(rays) - 1
    bound = np.inf
    last_bucket = np.int64(SPAN)
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
            rest = _refill_cells(judge, bound, block, order, g, meta, heads, entries, free, waiting)
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
        for k in range(len(rays)):
            i = row - rays[k, DOWN]
            j = col - rays[k, RIGHT]
            if not (1 <= i <= rows and 1 <= j <= cols):
                continue
            there = i * stride + j
            motion = np.int64(rays[k, MOTION])
            at = node if rays[k, THERE] else there
            found = np.int64(codes[np.uint64(at), np.uint64(motion)])
            if found >= FAILS:
                continue
            if by_edges:
                step = edges[np.uint64(there), np.uint64(k)]
            else:
                step = lengths[k] * (np.float32(1.0) + motion_weight(found, unit))
            known = np.float32(np.inf)
            if meta[np.uint64(2 * there + 1)] >> STAMP_SHIFT == stamp:
                known = g[np.uint64(2 * there)]
            turned = np.float32(0.0)
            if len(between) and g_node > 0.0:
                turned = between[k, onwards]
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
                check_there(poses, at // stride - 1, at % stride - 1, motion)
                found = np.int64(codes[np.uint64(at), np.uint64(motion)])
                if found >= FAILS:
                    continue
                if not by_edges:
                    step = lengths[k] * (np.float32(1.0) + motion_weight(found, unit))
            reached = g_node + np.float32(step + turned)
            if not reached < known or reached + left >= bound:
                continue
            g[np.uint64(2 * there)] = reached
            meta[np.uint64(2 * there + 1)] = (stamp << STAMP_SHIFT) | OPEN_BIT | (k & _MASK)
            if there == start:
                bound = np.float64(reached)
                last_bucket = last_bucket_below(bound, *order)
            else:
                bucket = bucket_of(reached + left, *order)
                free, used = push(heads, entries, bucket, there, block, fine_at, free, used)
                waiting += 1
    control[FREE] = free
    control[USED] = used
    control[FINE_AT] = fine_at
    control[BLOCK] = block
    control[LENGTH] = waiting
    reals[BASE] = order[0]
    reals[INVERSE_WIDTH] = order[1]
    reals[REFUSED] = refused
    counts[EXPANSIONS] = expansions
    return code, expansions, refused


@kernel
def least_of_cells(states, frame, part, nodes, costs, onwards):
    """Least costs of cells near a goal, as a search of states from the goal has them.

    Parameters
    ----------
    states : (g, meta, stamp)
        Of that search, in which bodies stand the other way round than on their way to the goal.
    frame : (bits, stride)
        As for `expand_states`.
    part : (row, rows, col, cols)
        The cells that are looked at, numbered within the border: from, to.
    nodes, costs, onwards : (2, N)
        Written: cells, what they cost, and the direction in which the way on leaves them; in the
        first row by states that are still open, in the second by settled ones. N cells are in
        `part`.

    Returns
    -------
    (int, int)
        How many are written into each row.
    """
    g, meta, stamp = states
    bits, stride = frame
    found = 0
    open_cells = 0
    for settled in range(2):
        open_cells = found
        found = 0
        for row in range(part[0], part[1]):
            for col in range(part[2], part[3]):
                node = row * stride + col
                least = np.float32(np.inf)
                for local in range(1 << bits):
                    state = (node << bits) + local
                    word = meta[2 * state + 1]
                    wanted = word >> STAMP_SHIFT == stamp and (word & OPEN_BIT == 0) == settled
                    if wanted and g[2 * state] < least:
                        least = g[2 * state]
                        ahead = local + (AXES if local < DIRECTIONS else 0)
                        onwards[settled, found] = ahead & _MASK
                if least < np.inf:
                    nodes[settled, found] = node
                    costs[settled, found] = least
                    found += 1
    return open_cells, found


@helper
def _step(code, edges, node, move, fare, unit):
    """Cost of a primitive by its code; unchecked as if on the best ground, inf where it fails."""
    if code >= FAILS:
        return np.float32(np.inf)
    if len(edges) and move[EDGE] >= 0:
        return edges[np.uint64(node), np.uint64(move[EDGE])]
    return fare[BY_LENGTH] * (np.float32(1.0) + motion_weight(code, unit)) + fare[FIXED]


@kernel
def expand_states(poses, edges, prices, field, region, ends, rule, memory, limits):
    """As `kernels.expansion.expand`, over a body's states.

    Parameters
    ----------
    poses : tuple
        Of the body, see `kernels.poses`. What a motion needs of them is checked.
    edges : (nodes, 16) float32
        What the leg that leaves a node in each direction costs, inf where there is none; without
        any, legs cost by what they are checked to be.
    prices : tuple
        Of primitives and rays, see `robots.body.primitives`.
    field : (g, meta, stamp, row, col, floor, between)
        What `fill_field` left, the number of that search, the start, and what it costs from there;
        no g without one. With costs of turns `between` directions, (16, 16) float32, if it was
        filled by these.
    region, limits
        As there.
    ends : (start, goal)
        Nodes.
    rule : (towards, width, beyond, again, frame, starting, wanted)
        Costs of straight, diagonal and knight's legs by which what is left is judged; else as
        there. By how much an expanded state must become cheaper to be expanded again: 0 where what
        is left is judged consistently. Binary digits of a cell's states, and cells of a row with
        its border. (S,) bool, states in which it may start, one at least, and that will do at the
        goal.
    memory
        As there, of the states.

    Returns
    -------
    tuple
        As there; once the goal is found, `counts` has its state in the place of the nearest one's.
    """
    start, goal = ends
    unit, moves, fares, origins, _, _, _ = prices
    moves = borrowed(moves)
    fares = borrowed(fares)
    origins = borrowed(origins)
    best, width, beyond, again, frame, starting, wanted = rule
    starting = borrowed(starting)
    wanted = borrowed(wanted)
    most, until = limits
    codes = borrowed(poses[0])
    rows = poses[1][5][0]
    cols = poses[1][5][1]
    stride = cols + 2
    ways = moves.shape[1]
    g, meta, stamp, heads, entries, control, reals, counts, path = memory
    g = borrowed(g)
    meta = borrowed(meta)
    heads = borrowed(heads)
    entries = borrowed(entries)
    allowed = borrowed(region[0]), borrowed(region[1]), borrowed(region[2]), region[3]
    edges = borrowed(edges)
    regional = len(region[0]) > 0
    goal_row = goal // stride
    goal_col = goal % stride
    field = (
        borrowed(field[0]),
        borrowed(field[1]),
        field[2],
        field[3],
        field[4],
        field[5],
        borrowed(field[6]),
    )
    judge = frame, (goal_row, goal_col, best), field
    if start >= 0:
        h = np.inf
        clear(heads, control)
        free = np.int64(NOTHING)
        used = np.int64(0)
        waiting = 0
        for local in range(len(moves)):
            if starting[local]:
                state = _state(start // stride, start % stride, local, frame)
                h = min(h, _left(state, judge))
                free, used = push(heads, entries, 0, state, 0, 0, free, used)
                g[2 * state] = 0.0
                meta[2 * state + 1] = (stamp << STAMP_SHIFT) | OPEN_BIT | ORIGIN
                waiting += 1
        control[FREE] = free
        control[USED] = used
        control[LENGTH] = waiting
        reals[BASE] = h
        reals[INVERSE_WIDTH] = 1.0 / width
        reals[REFUSED] = np.inf
        reals[BEST_H] = np.inf
        reals[BOUND] = np.inf
        counts[EXPANSIONS] = 0
        counts[BEST_NODE] = state
        counts[GOAL_STATE] = NOTHING
    order = (reals[BASE], reals[INVERSE_WIDTH])
    refused = reals[REFUSED]
    best_h = reals[BEST_H]
    free = control[FREE]
    used = control[USED]
    fine_at = control[FINE_AT]
    block = control[BLOCK]
    waiting = control[LENGTH]
    room = np.int64(len(entries)) // 2 - ways - DIRECTIONS - 3
    bound = reals[BOUND]
    settled = counts[GOAL_STATE]
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
        word = np.int64(meta[np.uint64(2 * state + 1)])
        if not word & OPEN_BIT:
            continue
        row, col, local = _place(state, frame)
        h = _left_at(row, col, local, judge)
        g_state = g[np.uint64(2 * state)]
        if g_state + h >= bound:
            meta[np.uint64(2 * state + 1)] = word & ~OPEN_BIT
            continue
        if word & UNSURE_BIT:  # what leads here is checked now
            way = word & DIRECTION_BITS
            before = origins[local, way]
            i = row - moves[before, way, DOWN]
            j = col - moves[before, way, RIGHT]
            motion = np.int64(moves[before, way, MOTION])
            at = i * stride + j
            on = row * stride + col if moves[before, way, THERE] else at
            if codes[np.uint64(on), np.uint64(motion)] == UNCHECKED:
                check_there(poses, on // stride - 1, on % stride - 1, motion)
            found = np.int64(codes[np.uint64(on), np.uint64(motion)])
            reached = g[np.uint64(2 * _state(i, j, before, frame))]
            reached += _step(found, edges, at, moves[before, way], fares[before, way], unit)
            if reached > g_state:
                least = np.float32(np.inf)
                word = np.int64(0)
                for way in range(ways):  # the best of all from states that are sure
                    before = origins[local, way]
                    if before < 0:
                        continue
                    i = row - moves[before, way, DOWN]
                    j = col - moves[before, way, RIGHT]
                    if not (1 <= i <= rows and 1 <= j <= cols):
                        continue
                    other = _state(i, j, before, frame)
                    known = np.int64(meta[np.uint64(2 * other + 1)])
                    if known >> STAMP_SHIFT != stamp or known & UNSURE_BIT:
                        continue
                    motion = np.int64(moves[before, way, MOTION])
                    at = i * stride + j
                    on = row * stride + col if moves[before, way, THERE] else at
                    found = np.int64(codes[np.uint64(on), np.uint64(motion)])
                    reached = g[np.uint64(2 * other)]
                    reached += _step(found, edges, at, moves[before, way], fares[before, way], unit)
                    if reached < least:
                        least = reached
                        word = (
                            (stamp << STAMP_SHIFT)
                            | OPEN_BIT
                            | (UNSURE_BIT if found == UNCHECKED else 0)
                            | way
                        )
                meta[np.uint64(2 * state + 1)] = word
                if word:
                    g[np.uint64(2 * state)] = least
                    free, used = push(
                        heads,
                        entries,
                        bucket_of(least + h, *order),
                        state,
                        block,
                        fine_at,
                        free,
                        used,
                    )
                    waiting += 1
                continue
        meta[np.uint64(2 * state + 1)] = word & ~(OPEN_BIT | UNSURE_BIT)
        expansions += 1
        if h < best_h:
            best_h = h
            counts[BEST_NODE] = state
        node = row * stride + col
        for way in range(ways):
            to = np.int64(moves[local, way, TO])
            i = row + moves[local, way, DOWN]
            j = col + moves[local, way, RIGHT]
            if to < 0 or not (1 <= i <= rows and 1 <= j <= cols):
                continue
            across = i * stride + j
            motion = np.int64(moves[local, way, MOTION])
            on = across if moves[local, way, THERE] else node
            found = np.int64(codes[np.uint64(on), np.uint64(motion)])
            if found >= FAILS:
                continue
            there = _state(i, j, to, frame)
            known = np.float32(np.inf)
            sure = False
            before = np.int64(meta[np.uint64(2 * there + 1)])
            if before >> STAMP_SHIFT == stamp:
                known = g[np.uint64(2 * there)]
                sure = not before & UNSURE_BIT
                if not before & OPEN_BIT and across != goal:
                    known -= np.float32(again * expansions)
            step = _step(found, edges, node, moves[local, way], fares[local, way], unit)
            left = _left_at(i, j, to, judge)
            reached = np.float32(g_state + step)
            if not reached < known or reached + left >= bound:
                continue
            if regional and across != node and across != goal and _outside(allowed, i, j):
                refused = min(refused, reached + left)
                continue
            ends_here = across == goal and wanted[to]
            if (ends_here or sure) and found == UNCHECKED:  # what is sure stays so
                check_there(poses, on // stride - 1, on % stride - 1, motion)
                found = np.int64(codes[np.uint64(on), np.uint64(motion)])
                step = _step(found, edges, node, moves[local, way], fares[local, way], unit)
                reached = np.float32(g_state + step)
                if not reached < known or reached + left >= bound:
                    continue
            g[np.uint64(2 * there)] = reached
            come = np.int64((stamp << STAMP_SHIFT) | way)
            if ends_here:  # never expanded, so never put on the open list
                bound = (reached + left) * beyond
                settled = there
                last_bucket = last_bucket_below(bound, *order)
            else:
                come |= OPEN_BIT | (UNSURE_BIT if found == UNCHECKED else 0)
                bucket = bucket_of(reached + left, *order)
                free, used = push(heads, entries, bucket, there, block, fine_at, free, used)
                waiting += 1
            meta[np.uint64(2 * there + 1)] = come
    control[FREE] = free
    control[USED] = used
    control[FINE_AT] = fine_at
    control[BLOCK] = block
    control[LENGTH] = waiting
    reals[BASE] = order[0]
    reals[INVERSE_WIDTH] = order[1]
    reals[REFUSED] = refused
    reals[BEST_H] = best_h
    reals[BOUND] = bound
    counts[GOAL_STATE] = settled
    counts[EXPANSIONS] = expansions
    if code == FOUND:
        counts[BEST_NODE] = settled
    cells = 0
    if code != FULL:
        cells = trace_states(meta, counts[BEST_NODE], prices, frame, path)
    return code, cells, expansions, refused


@kernel
def walk_states(poses, edges, prices, stride, path, first, costs):
    """Write what a body's path (N, 2) costs from its cell `first` to each later one into `costs`
    (N,).

    Returns the number of the first cell that a failing leg or turn leads to, from `first` on; -1 if
    all pass. The turn at `first` must pass, too, but is not counted.
    """
    unit, _, fares, _, _, _, _ = prices
    codes = poses[0]
    total = 0.0
    before = -1
    if first == 0:
        costs[:1] = 0.0
    for n in range(max(first, 1), len(path)):
        k = direction_of(path[n, 0] - path[n - 1, 0], path[n, 1] - path[n - 1, 1])
        node = (path[n - 1, 0] + 1) * stride + path[n - 1, 1] + 1
        if n == first:  # the leg before: only its direction counts
            before = k
            costs[n] = 0.0
            continue
        if before >= 0 and before != k:
            price = turn_price(poses, fares, stride, node, before, k)
            if price == np.inf:
                return n
            total += price if n > first + 1 else 0.0
        axis = k & 7
        at = node if k < AXES else (path[n, 0] + 1) * stride + path[n, 1] + 1
        if codes[at, axis] == UNCHECKED:
            check_there(poses, at // stride - 1, at % stride - 1, axis)
        if codes[at, axis] >= FAILS:
            return n
        if len(edges):
            total += edges[node, k]
        else:
            total += fares[k, LEG, BY_LENGTH] * (1.0 + motion_weight(codes[at, axis], unit))
        costs[n] = total
        before = k
    return -1


@kernel
def walk_primitives(poses, edges, prices, path, first, costs):
    """Write what a path of states (N, 3) costs from its state `first` to each later one into
    `costs` (N,).

    Returns the number of the first state that a failing primitive, or none at all, leads to; -1 if
    all pass.
    """
    unit, moves, fares, _, _, _, _ = prices
    stride = poses[1][5][1] + 2
    total = 0.0
    costs[first : first + 1] = 0.0
    for n in range(first + 1, len(path)):
        row = path[n - 1, 0] + 1
        col = path[n - 1, 1] + 1
        local = path[n - 1, 2]
        down = path[n, 0] + 1 - row
        right = path[n, 1] + 1 - col
        step = np.inf
        for way in range(moves.shape[1]):
            move = moves[local, way]
            if move[TO] == path[n, 2] and move[DOWN] == down and move[RIGHT] == right:
                i = row + down * move[THERE]
                j = col + right * move[THERE]
                motion = np.int64(move[MOTION])
                if poses[0][i * stride + j, motion] == UNCHECKED:
                    check_there(poses, i - 1, j - 1, motion)
                code = np.int64(poses[0][i * stride + j, motion])
                step = np.float64(
                    _step(code, edges, row * stride + col, move, fares[local, way], unit)
                )
        if step == np.inf:
            return n
        total += step
        costs[n] = total
    return -1


@helper
def direction_of(rows, cols):
    """Number of the direction of a leg; -1 where it is none."""
    for k in range(DIRECTIONS):
        if ROWS[k] == rows and COLS[k] == cols:
            return k
    return -1


@helper
def turn_price(poses, fares, stride, node, before, after):
    """Cost of turning on a node to another direction, the shorter way; inf where impossible (both
    ways are).
    """
    left = (after - before) & _MASK <= DIRECTIONS // 2
    total = 0.0
    k = before
    while k != after and total < np.inf:
        axis = k & 7 if left else (k - 1) & 7
        if poses[0][node, AXES + axis] == UNCHECKED:
            check_there(poses, node // stride - 1, node % stride - 1, AXES + axis)
        total = (
            total + fares[axis, LEFT_TURN, FIXED] if poses[0][node, AXES + axis] < FAILS else np.inf
        )
        k = (k + 1 if left else k - 1) & _MASK
    return total
