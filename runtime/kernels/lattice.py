"""The search over a body's states: a cell, one of sixteen directions in which the body stands
there, and its gear.

A state is left by motion primitives: legs, turns on the spot and arcs (`robots.body.primitives`).
One that nobody has checked counts as possible and cheap until the state that it leads to would be
expanded: only then `kernels.poses` checks it. If it fails, or is dearer, the state waits for the
next best way to it. What is left from a state is judged by a field, costs from cells to the goal
that are found before.
"""

import math

from numpy import float32, float64, inf, int64, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import (
    COL,
    DIRECTION_BITS,
    EXHAUSTED,
    FOUND,
    FULL,
    OPEN_BIT,
    ORIGIN,
    PAUSED,
    ROW,
    STAMP_SHIFT,
    STATE,
    UNSURE_BIT,
    g_of,
    outside,
    put_word,
    visit,
    word_of,
)
from nnpp_edge.runtime.kernels.open_list import (
    NOTHING,
    bucket_of,
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
from nnpp_edge.runtime.kernels.paths import node_on, step_to
from nnpp_edge.runtime.kernels.poses import (
    AXIS_COUNT,
    FAILS,
    UNCHECKED,
    check_there,
    motion_weight,
)
from nnpp_edge.runtime.kernels.records import (
    BASE,
    BEST_H,
    BEST_NODE,
    BOUND,
    BY_LENGTH,
    DOWN,
    EXPANSIONS,
    FIXED,
    GOAL_STATE,
    MOTION,
    RIGHT,
    THERE,
    TO,
    CellJudge,
    Ends,
    Field,
    FieldRule,
    FieldTask,
    FrameRecord,
    Limits,
    Memory,
    PosesRecord,
    Prices,
    RegionRecord,
    Seeds,
    StateJudge,
    StateRule,
    StateTask,
)

DIRECTION_COUNT = 16
_FIRST_LEGS = (
    (1, 0),
    (2, 1),
    (1, 1),
    (1, 2),
    (0, 1),
    (-1, 2),
    (-1, 1),
    (-2, 1),
)
"""(rows, columns) of the first eight directions; the others lead the other way."""
LEG_ROWS = tuple(sign * rows for sign in (1, -1) for rows, _ in _FIRST_LEGS)
LEG_COLS = tuple(sign * cols for sign in (1, -1) for _, cols in _FIRST_LEGS)
KNIGHT = math.sqrt(5.0) / (1.0 + math.sqrt(2.0))
"""A knight's leg over a straight and a diagonal one."""
LEG = 0
LEFT_TURN = 1
"""Primitives of a body that turns on the spot; `LEFT_TURN` + 1 is the one to the right."""
_DIRECTION_MASK = DIRECTION_COUNT - 1
_AXIS_MASK = AXIS_COUNT - 1
_LOOK_EVERY = 8
"""States taken between two readings of the clock."""
_MOST_CHECKS = 64
"""Poses checked between two readings: at 512² one of a large body takes 4 µs, and a state where
nothing has been checked 116 of them."""


# What is left


@inlined
def left_over(rows, cols, legs):
    """Least cost of a way so many rows and columns on, by `Legs`."""
    near = min(rows, cols)
    far = max(rows, cols)
    if 2 * near <= far:
        return legs.straight * (far - 2 * near) + legs.knight * near
    return legs.knight * (far - near) + legs.diagonal * (2 * near - far)


@inlined
def _distance(row, col, to, legs):
    """Least cost of a way from a cell to another, by distances alone."""
    return left_over(abs(row - to.row), abs(col - to.col), legs)


@inlined
def _place(state, frame):
    """Row and column within the border of a state, and its number among those of its cell."""
    node = state >> frame.bits
    row = node // frame.stride
    return row, node - row * frame.stride, state & ((1 << frame.bits) - 1)


@inlined
def _state(node, local, frame):
    """The state of that number on a node."""
    return (node << frame.bits) + local


@inlined
def _left_at(row, col, local, judge):
    """A lower bound on what a way from a state costs: the field's where that is settled, else by
    distances.
    """
    field = judge.field
    left = _distance(row, col, judge, judge.legs)
    if len(field.g):
        node = row * judge.frame.stride + col
        word = word_of(field.meta, node)
        onwards = word & DIRECTION_BITS
        if word - onwards == field.stamp << STAMP_SHIFT:
            left = float64(g_of(field.g, node))
            if len(field.between) and left > 0.0:
                left += field.between[local & _DIRECTION_MASK, onwards]
            return left
        left = max(left, field.floor - _distance(row, col, field, judge.legs))
    return left


@helper
def _left(state, judge):
    """As `_left_at`, of a state."""
    row, col, local = _place(state, judge.frame)
    return _left_at(row, col, local, judge)


@helper
def _left_of_cell(node, judge):
    """As `_distance`, of a node."""
    row = node // judge.stride
    return _distance(row, node - row * judge.stride, judge, judge.legs)


_take = taking_by(_left)
_take_cell = taking_by(_left_of_cell)


# Motions


@inlined
def _code(poses, node, motion):
    """What is known of a motion that begins on a node."""
    return int64(poses.codes[uint64(node), uint64(motion)])


@inlined
def _checked_code(poses, node, motion):
    """The same, once it has been checked."""
    if poses.codes[uint64(node), uint64(motion)] == UNCHECKED:
        stride = poses.cols + 2
        check_there(poses, node // stride - 1, node % stride - 1, motion)
    return _code(poses, node, motion)


@inlined
def _is_on_map(poses, row, col):
    """Whether a cell, numbered within the border, lies on the map."""
    return 1 <= row <= poses.rows and 1 <= col <= poses.cols


@inlined
def _fare(code, fare, unit):
    """Cost of a primitive by its code; unchecked as if on the best ground, inf where it fails."""
    if code >= FAILS:
        return float32(inf)
    return fare[BY_LENGTH] * (float32(1.0) + motion_weight(code, unit)) + fare[FIXED]


@inlined
def _step(code, node, local, way, fare, edges, unit):
    """As `_fare`, of a primitive that leaves a state of a node; of a leg by its edge, if there are
    any, which bodies that drive arcs have not.
    """
    if len(edges) and way == LEG and code < FAILS:
        return edges[uint64(node), uint64(local)]
    return _fare(code, fare, unit)


@kernel
def trace_states(meta, state, prices: Prices, frame: FrameRecord, out):
    """Write the states from one back to the start, (row, col, number), into `out`, as far as it
    reaches; how many.
    """
    n = 0
    while True:
        row, col, local = _place(state, frame)
        if n < len(out):
            out[n, ROW] = row - 1
            out[n, COL] = col - 1
            out[n, STATE] = local
        n += 1
        way = meta[2 * state + 1] & DIRECTION_BITS
        if way == ORIGIN:
            return n
        before = prices.origins[local, way]
        move = prices.moves[before, way]
        node = (row - move[DOWN]) * frame.stride + col - move[RIGHT]
        state = _state(node, before, frame)


# The field


@inlined
def _seed(memory, seeds, judge, base, width):
    """Begin a field: the seeds are on the open list, which has room for all."""
    queue = empty(memory, base, width)
    for n in range(len(seeds.nodes)):
        node = int64(seeds.nodes[n])
        bucket = bucket_of(seeds.costs[n] + _left_of_cell(node, judge), queue)
        queue = push(memory, queue, bucket, node)
        visit(memory, node, seeds.costs[n], OPEN_BIT | seeds.onwards[n])
    suspend(memory, queue, inf, 0)


@inlined
def _bound(cost, inverse_width, task):
    """The f from which on cells are left out, once the start costs so much. On the whole map all of
    the last bucket is looked at, as a cell that was closed there early may cost less.
    """
    return float64(cost) + (0.0 if len(task.between) else 1.0 / inverse_width)


@inlined
def _by_ray(there, k, g_node, code, onwards, task):
    """Cost of the node `there` by ray k, whose motion has this code, to a node that costs `g_node`
    and is left `onwards`.
    """
    turn = float32(0.0)
    if len(task.between) and g_node > 0.0:
        turn = task.between[k, onwards]
    if len(task.edges):
        return g_node + (task.edges[uint64(there), uint64(k)] + turn)
    fare = task.prices.ray_fares[k]
    return g_node + (fare * (float32(1.0) + motion_weight(code, task.prices.unit)) + turn)


@inlined
def _relax_ray(i, j, k, on, g_node, onwards, task, front):
    """Relax ray k, by which a cell costs less than it did: its motion, from a node on, is checked
    now.
    """
    poses = task.poses
    judge = task.judge
    there = i * judge.stride + j
    motion = int64(task.prices.rays[k, MOTION])
    code = _code(poses, on, motion)
    reached = _by_ray(there, k, g_node, code, onwards, task)
    left = _distance(i, j, judge, judge.legs)
    if reached + left >= front.bound:
        return front
    in_region = len(task.region.bitmap) == 0 or there == task.start
    if not in_region and outside(task.region, i, j):
        return refuse(front, reached + left)
    if code == UNCHECKED:
        code = _checked_code(poses, on, motion)
        reached = _by_ray(there, k, g_node, code, onwards, task)
        dearer = not reached < known(task.memory, there) or reached + left >= front.bound
        if code >= FAILS or dearer:
            return front
    visit(task.memory, there, reached, OPEN_BIT | (k & _DIRECTION_MASK))
    if there == task.start:
        return stop_at(front, _bound(reached, front.queue.inverse_width, task))
    return wait(task.memory, front, reached + left, there)


@kernel
def fill_field(
    poses: PosesRecord,
    edges,
    prices: Prices,
    region: RegionRecord,
    seeds: Seeds,
    ends,
    rule: FieldRule,
    memory: Memory,
    limits: Limits,
):
    """Costs to the goal of the cells from which a way to it may be part of the best one.

    Searches from the seeds, by the rays of `prices` backwards, until the start is settled.

    Parameters
    ----------
    poses, prices, region, seeds, rule, memory, limits
        Records, see `kernels.records`; `Memory` of the nodes.
    edges : (nodes, 16) float32
        As for `expand_states`.
    ends : (goal, start)
        The goal is -1 to go on where the last call stopped.

    Returns
    -------
    tuple
        The code, the expansions, and the least f of a node that the region refused.
    """
    goal, start = ends
    rays = prices.rays
    stride = poses.cols + 2
    judge = CellJudge(stride, start // stride, start % stride, rule.legs)
    task = FieldTask(poses, edges, prices, region, judge, start, rule.between, memory)
    if goal >= 0:
        base = _left_of_cell(goal, judge)
        _seed(memory, seeds, judge, base, rule.width)
        memory.reals[BOUND] = _bound(known(memory, start), 1.0 / rule.width, task)
    front = resumed(memory, memory.reals[BOUND])
    room = int64(len(memory.entries)) // 2 - len(rays) - 1
    expansions = memory.control[EXPANSIONS]
    last = expansions + limits.most
    taken = 0
    checked = poses.counts[0]
    code = PAUSED
    while expansions < last:
        # not every state that is taken is expanded, and some take long to check
        taken += 1
        if taken % _LOOK_EVERY == 0 or poses.counts[0] - checked > _MOST_CHECKS:
            checked = poses.counts[0]
            if late(limits.until):
                break
        if front.queue.length > room:
            code = FULL
            break
        # take an open node of the least f
        node, front = _take_cell(memory, judge, front)
        if node == NOTHING:
            code = FOUND if front.bound < inf else EXHAUSTED
            break
        g_node = g_of(memory.g, node)
        row = node // stride
        col = node - row * stride
        if g_node + _distance(row, col, judge, judge.legs) >= front.bound:
            continue  # and stays open: what it costs may not be the least
        # close it, and expand it: relax the rays that lead to it
        word = word_of(memory.meta, node)
        put_word(memory.meta, node, word & ~OPEN_BIT)
        expansions += 1
        onwards = word & DIRECTION_BITS
        for k in range(len(rays)):
            i = row - rays[k, DOWN]
            j = col - rays[k, RIGHT]
            if not _is_on_map(poses, i, j):
                continue
            there = i * stride + j
            on = node if rays[k, THERE] else there
            found = _code(poses, on, int64(rays[k, MOTION]))
            if found >= FAILS:
                continue
            reached = _by_ray(there, k, g_node, found, onwards, task)
            if reached < known(memory, there):
                front = _relax_ray(i, j, k, on, g_node, onwards, task, front)
    suspend(memory, front.queue, front.refused, expansions)
    memory.reals[BOUND] = front.bound
    return code, expansions, front.refused


# The states


@inlined
def _set_out(ends, task):
    """Begin a search: the states in which it may start are on the open list."""
    memory = task.memory
    frame = task.judge.frame
    h = inf
    queue = empty(memory, h, task.rule.width)
    state = int64(0)
    for local in range(len(task.prices.moves)):
        if task.rule.starting[local]:
            state = _state(ends.start, local, frame)
            h = min(h, _left(state, task.judge))
            queue = push(memory, queue, int64(0), state)
            visit(memory, state, 0.0, OPEN_BIT | ORIGIN)
    suspend(memory, queue, inf, 0)
    memory.reals[BASE] = h
    memory.reals[BEST_H] = inf
    memory.reals[BOUND] = inf
    memory.control[BEST_NODE] = state
    memory.control[GOAL_STATE] = NOTHING


@inlined
def _is_dominated(state, g_state, task):
    """Whether the state of the other gear is sure to cost less, a change of gears included."""
    other = state ^ DIRECTION_COUNT
    word = word_of(task.memory.meta, other)
    sure = word >> STAMP_SHIFT == task.memory.stamp and not word & UNSURE_BIT
    return sure and g_of(task.memory.g, other) + task.rule.gear_change <= g_state


@inlined
def _come_by(row, col, local, way, checks, task):
    """g of a state by the primitive that leads to it, and that primitive's code, checked if it
    `checks`.
    """
    prices = task.prices
    frame = task.judge.frame
    before = prices.origins[local, way]
    move = prices.moves[before, way]
    motion = int64(move[MOTION])
    at = (row - move[DOWN]) * frame.stride + col - move[RIGHT]
    on = row * frame.stride + col if move[THERE] else at
    code = _checked_code(task.poses, on, motion) if checks else _code(task.poses, on, motion)
    step = _step(code, at, before, way, prices.fares[before, way], task.edges, prices.unit)
    return g_of(task.memory.g, _state(at, before, frame)) + step, code


@inlined
def _wait_for_next(row, col, local, h, task, front):
    """Have a state wait on the open list for the best of all ways to it from states that are sure,
    or for none.
    """
    prices = task.prices
    memory = task.memory
    frame = task.judge.frame
    state = _state(row * frame.stride + col, local, frame)
    least = float32(inf)
    word = int64(0)
    for way in range(prices.moves.shape[1]):
        before = prices.origins[local, way]
        if before < 0:
            continue
        i = row - prices.moves[before, way, DOWN]
        j = col - prices.moves[before, way, RIGHT]
        if not _is_on_map(task.poses, i, j):
            continue
        from_word = word_of(memory.meta, _state(i * frame.stride + j, before, frame))
        if from_word >> STAMP_SHIFT != memory.stamp or from_word & UNSURE_BIT:
            continue
        reached, code = _come_by(row, col, local, way, False, task)
        if reached < least:
            least = reached
            unsure = UNSURE_BIT if code == UNCHECKED else 0
            word = (memory.stamp << STAMP_SHIFT) | OPEN_BIT | unsure | way
    put_word(memory.meta, state, word)
    if not word:
        return front
    memory.g[uint64(2 * state)] = least
    return wait(memory, front, least + h, state)


@inlined
def _relax(row, col, local, way, g_state, expansions, task, front, settled):
    """Relax a primitive by which a state is left; the frontier, and the best state at the goal."""
    memory = task.memory
    poses = task.poses
    prices = task.prices
    frame = task.judge.frame
    move = prices.moves[local, way]
    fare = prices.fares[local, way]
    to = int64(move[TO])
    i = row + move[DOWN]
    j = col + move[RIGHT]
    if to < 0 or not _is_on_map(poses, i, j):
        return front, settled
    node = row * frame.stride + col
    across = i * frame.stride + j
    motion = int64(move[MOTION])
    on = across if move[THERE] else node
    found = _code(poses, on, motion)
    if found >= FAILS:
        return front, settled
    there = _state(across, to, frame)
    least = float32(inf)
    sure = False
    before = word_of(memory.meta, there)
    if before >> STAMP_SHIFT == memory.stamp:
        least = g_of(memory.g, there)
        sure = not before & UNSURE_BIT
        if not before & OPEN_BIT and across != task.goal:
            least -= float32(task.rule.again * expansions)
    reached = float32(g_state + _step(found, node, local, way, fare, task.edges, prices.unit))
    left = _left_at(i, j, to, task.judge)
    if not reached < least or reached + left >= front.bound:
        return front, settled
    in_region = len(task.region.bitmap) == 0 or across == node or across == task.goal
    if not in_region and outside(task.region, i, j):
        return refuse(front, reached + left), settled
    ends_here = across == task.goal and task.rule.wanted[to]
    if (ends_here or sure) and found == UNCHECKED:  # what is sure stays so
        found = _checked_code(poses, on, motion)
        reached = float32(g_state + _step(found, node, local, way, fare, task.edges, prices.unit))
        if not reached < least or reached + left >= front.bound:
            return front, settled
    if ends_here:  # never expanded, so never put on the open list
        visit(memory, there, reached, way)
        return stop_at(front, (reached + left) * task.rule.beyond), there
    unsure = UNSURE_BIT if found == UNCHECKED else 0
    visit(memory, there, reached, OPEN_BIT | unsure | way)
    return wait(memory, front, reached + left, there), settled


@kernel
def expand_states(
    poses: PosesRecord,
    edges,
    prices: Prices,
    field: Field,
    region: RegionRecord,
    ends: Ends,
    rule: StateRule,
    memory: Memory,
    limits: Limits,
):
    """As `kernels.expansion.expand`, over a body's states.

    Parameters
    ----------
    poses, prices, field, region, ends, rule, memory, limits
        Records, see `kernels.records`; `Memory` of the states. What a motion needs of `poses` is
        checked.
    edges : (nodes, 16) float32
        What the leg that leaves a node in each direction costs, inf where there is none; without
        any, legs cost by what they are checked to be.

    Returns
    -------
    tuple
        As there; once the goal is found, `control` has its state in the place of the nearest one's.
    """
    stride = poses.cols + 2
    frame = rule.frame
    place = (ends.goal // stride, ends.goal % stride)
    judge = StateJudge(frame, *place, rule.legs, field)
    task = StateTask(poses, edges, prices, region, judge, ends.goal, rule, memory)
    if ends.start >= 0:
        _set_out(ends, task)
    front = resumed(memory, memory.reals[BOUND])
    best_h = memory.reals[BEST_H]
    settled = memory.control[GOAL_STATE]
    ways = prices.moves.shape[1]
    changes_gears = len(prices.moves) > DIRECTION_COUNT
    room = int64(len(memory.entries)) // 2 - ways - DIRECTION_COUNT - 3
    expansions = memory.control[EXPANSIONS]
    last = expansions + limits.most
    taken = 0
    checked = poses.counts[0]
    code = PAUSED
    while expansions < last:
        taken += 1
        if taken % _LOOK_EVERY == 0 or poses.counts[0] - checked > _MOST_CHECKS:
            checked = poses.counts[0]
            if late(limits.until):
                break
        if front.queue.length > room:
            code = FULL
            break
        # take an open state of the least f
        state, front = _take(memory, judge, front)
        if state == NOTHING:
            code = FOUND if settled >= 0 else EXHAUSTED
            break
        word = word_of(memory.meta, state)
        row, col, local = _place(state, frame)
        h = _left_at(row, col, local, judge)
        g_state = g_of(memory.g, state)
        # close it where no better path leads on, or its other gear leads on at no higher cost
        too_dear = g_state + h >= front.bound
        if too_dear or (changes_gears and _is_dominated(state, g_state, task)):
            put_word(memory.meta, state, word & ~OPEN_BIT)
            continue
        # check what leads here; if that fails, or is dearer, the state waits for the next best way
        if word & UNSURE_BIT:
            reached, _ = _come_by(row, col, local, word & DIRECTION_BITS, True, task)
            if reached > g_state:
                front = _wait_for_next(row, col, local, h, task, front)
                continue
        # close it, and expand it: relax the primitives that lead from it
        put_word(memory.meta, state, word & ~(OPEN_BIT | UNSURE_BIT))
        expansions += 1
        if h < best_h:
            best_h = h
            memory.control[BEST_NODE] = state
        for way in range(ways):
            front, settled = _relax(row, col, local, way, g_state, expansions, task, front, settled)
    suspend(memory, front.queue, front.refused, expansions)
    memory.reals[BEST_H] = best_h
    memory.reals[BOUND] = front.bound
    memory.control[GOAL_STATE] = settled
    if code == FOUND:
        memory.control[BEST_NODE] = settled
    # by plain tuples, as from Python: so that is compiled, too
    end = memory.control[BEST_NODE]
    cells = trace_states(memory.meta, end, prices[:], frame[:], memory.path)
    return code, cells, expansions, front.refused


# Paths


@kernel
def walk_states(poses: PosesRecord, prices: Prices, path, first, costs):
    """Write what a body's path (N, 2) costs from its cell `first` to each later one into `costs`
    (N,).

    Returns the number of the first cell that a failing leg or turn leads to, from `first` on; -1 if
    all pass. The turn at `first` must pass, too, but is not counted.
    """
    stride = poses.cols + 2
    total = 0.0
    before = -1
    costs[first : first + 1] = 0.0
    for n in range(max(first, 1), len(path)):
        down, right = step_to(path, n)
        k = _direction_of(down, right)
        node = node_on(path, n - 1, stride)
        if n > first:  # of the leg before only its direction counts
            if before >= 0 and before != k:
                turn = _turn_cost(poses, prices, node, before, k)
                if turn == inf:
                    return n
                total += turn if n > first + 1 else 0.0
            at = node if k < AXIS_COUNT else node_on(path, n, stride)
            code = _checked_code(poses, at, k & _AXIS_MASK)
            if code >= FAILS:
                return n
            total += prices.fares[k, LEG, BY_LENGTH] * (1.0 + motion_weight(code, prices.unit))
            costs[n] = total
        before = k
    return -1


@kernel
def walk_primitives(poses: PosesRecord, prices: Prices, path, first, costs):
    """Write what a path of states (N, 3) costs from its state `first` to each later one into
    `costs` (N,).

    Returns the number of the first state that a failing primitive, or none at all, leads to; -1 if
    all pass.
    """
    stride = poses.cols + 2
    total = 0.0
    costs[first : first + 1] = 0.0
    for n in range(first + 1, len(path)):
        local = path[n - 1, STATE]
        node = node_on(path, n - 1, stride)
        across = node_on(path, n, stride)
        down, right = step_to(path, n)
        step = inf
        for way in range(prices.moves.shape[1]):
            move = prices.moves[local, way]
            leads = move[TO] == path[n, STATE]
            leads &= move[DOWN] == down
            leads &= move[RIGHT] == right
            if leads:
                on = across if move[THERE] else node
                code = _checked_code(poses, on, int64(move[MOTION]))
                step = float64(_fare(code, prices.fares[local, way], prices.unit))
        if step == inf:
            return n
        total += step
        costs[n] = total
    return -1


@helper
def _direction_of(rows, cols):
    """Number of the direction of a leg; -1 where it is none."""
    for k in range(DIRECTION_COUNT):
        if LEG_ROWS[k] == rows and LEG_COLS[k] == cols:
            return k
    return -1


@helper
def _turn_cost(poses, prices, node, before, after):
    """Cost of turning on a node to another direction, the shorter way; inf where impossible (both
    ways are).
    """
    step = 1 if (after - before) & _DIRECTION_MASK <= DIRECTION_COUNT // 2 else -1
    total = 0.0
    k = before
    while k != after and total < inf:
        axis = min(k, k + step) & _AXIS_MASK
        passes = _checked_code(poses, node, AXIS_COUNT + axis) < FAILS
        total = total + prices.fares[axis, LEFT_TURN, FIXED] if passes else inf
        k = (k + step) & _DIRECTION_MASK
    return total
