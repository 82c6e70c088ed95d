"""The kernels of D* Lite: reading the map, mending what a change touched, expanding, following the
path.

Where steps are directed, ``edges`` is (edges, factor): what the step that leaves a node in each
direction costs, see `expansion.expand`, and the units to it; costs then say only whether a node can
be stood on, and are 0 or inf. The search leads from the goal to the start, so a node's neighbours
come to it by the steps that lead back.

Bundles: ``search`` is (stride, start, goal, corner_cutting, steps, prices, km), ``terrain`` (costs,
walls, span), ``heap`` (position, firsts, seconds, nodes), ``source`` (weights, factor, stride,
start, goal) of the map that is read, ``known`` (costs, walls, inside), ``noted`` (changed,
is_changed).
"""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import COL_STEP, OPPOSITE, ROW_STEP, lowest_bit, octile

SETTLED = 0
PAUSED = 1
READ = 0
STALE = 1
UNREAD = 2
ABSENT = -1
_LOOK_EVERY = 512
"""Nodes between two readings of the clock."""
SPARE_SLOTS = 4
"""Slots of the heap beyond the number of nodes, so that the last entries have four below each as
well.
"""
EXACT = float(1 << 52)
"""Sums of units are exact up to here: two thousand million of the cheapest steps."""
CAUTION = 1.0 + 2.0**-40
"""Beyond that, keys this much above the start's are looked at too, so that rounding cannot hide
one.
"""
DEAREST = 1e38
"""No passable cell weighs more units, lest it read as impassable."""


@helper
def _read(node, weights, factor, ends, known):
    """Read what one node weighs; whether its steps have changed."""
    costs, walls, inside = known
    allowed = (inside[np.uint64(node)] != 0) | (node == ends[0]) | (node == ends[1])
    weight = weights[np.uint64(node)]
    wall = weight == np.inf
    cost = np.float32(min(np.rint(factor * weight), DEAREST))
    cost = np.float32(np.inf) if wall | (not allowed) else cost
    changed = (cost != costs[np.uint64(node)]) | (wall != walls[np.uint64(node)])
    costs[np.uint64(node)] = cost
    walls[np.uint64(node)] = wall
    return changed


@helper
def _note(node, stride, changed, is_changed, pending):
    """Put a node and its neighbours down as changed; the number of nodes put down so far."""
    for k in range(9):  # unrolled by the compiler
        there = node + (k // 3 - 1) * stride + k % 3 - 1
        changed[np.uint64(pending)] = there
        pending += 1 - np.int64(is_changed[np.uint64(there)])
        is_changed[np.uint64(there)] = 1
    return pending


@kernel
def read_rectangle(part, rows_left, source, directed, known, noted, pending):
    """Read a rectangle of the map; the number of nodes put down as changed so far: where steps are
    `directed`, all.

    Rows that are `UNREAD` are left for `read_rows`.
    """
    row, col, rows, cols = part
    weights, factor, stride, start, goal = source
    changed, is_changed = noted
    for r in range(row, row + rows):
        if rows_left[r + 1] == UNREAD:
            continue
        for c in range(col, col + cols):
            node = (r + 1) * stride + c + 1
            if _read(node, weights, factor, (start, goal), known) or directed:
                pending = _note(node, stride, changed, is_changed, pending)
    return pending


@kernel
def read_rows(rows_left, region, source, known, state, heap, noted, pending, until):
    """Read rows that have not been read, or whose region is another; the number of nodes put down
    as changed so far.

    `rows_left`, (H + 2,) uint8, says of each row, and those of the border, whether it is `UNREAD`,
    `STALE` or `READ`, and is written. What is kept of an unread row may hold anything: nothing has
    been found out there, and none of its nodes is put down. `region` is (mask, row_block,
    col_block). Once it is late, the rows that are left stay as they are.
    """
    mask, row_block, col_block = region
    weights, factor, stride, start, goal = source
    costs, walls, inside = known
    position, firsts, _, _ = heap
    changed, is_changed = noted
    for r in range(len(rows_left)):
        if rows_left[r] == READ:
            continue
        anew = rows_left[r] == UNREAD
        first = r * stride
        if anew:
            end = first + stride
            costs[first:end] = np.inf
            walls[first:end] = 1
            inside[first:end] = 0
            position[first:end] = ABSENT
            state[2 * first : 2 * end] = np.inf
            firsts[first:end] = np.inf
        for c in range(len(col_block) if 0 < r < len(rows_left) - 1 else 0):
            node = first + c + 1
            now = mask[np.uint64(row_block[r - 1]), np.uint64(col_block[c])]
            if anew or now != inside[node]:
                inside[node] = now
                if _read(node, weights, factor, (start, goal), known) and not anew:
                    pending = _note(node, stride, changed, is_changed, pending)
        rows_left[r] = READ
        if late(until):
            break
    return pending


@helper
def _step(k, pair, steps):
    """Cost of a step in direction k between cells whose weights sum to `pair`, in units."""
    return steps[0] + pair if k < 4 else steps[1] + np.floor(steps[2] * pair)


@helper
def _directed_step(node, k, pair, edges):
    """Cost of the step that leaves a node in direction k, in units; `pair` is inf where it may not
    be made.
    """
    return np.rint(edges[1] * edges[0][np.uint64(node), np.uint64(k)]) + pair


@helper
def _least_by_way(node, row_steps, corner_cutting, steps, edges, costs, walls, state):
    """The least cost to the goal by way of a neighbour of a passable node, and the direction of
    that neighbour.
    """
    best = np.inf
    direction = -1
    for k in range(8):  # unrolled by the compiler
        there = node + row_steps[k] + COL_STEP[k]
        pair = np.float64(costs[np.uint64(node)]) + np.float64(costs[np.uint64(there)])
        step = _step(k, pair, steps) if edges is None else _directed_step(node, k, pair, edges)
        if k >= 4 and not corner_cutting:
            shut = walls[np.uint64(node + row_steps[k])] | walls[np.uint64(node + COL_STEP[k])]
            step = np.inf if shut else step
        by_way = step + state[np.uint64(2 * there)]
        direction = k if by_way < best else direction
        best = min(best, by_way)
    return best, direction


@helper
def _rise(firsts, seconds, nodes, position, i, first, second, node):
    """Put a node at slot i of the heap, or as far above as its key wants; the slot that it got."""
    while i > 0:
        p = (i - 1) >> 2
        a = firsts[np.uint64(p)]
        b = seconds[np.uint64(p)]
        if a < first or (a == first and b <= second):
            break
        moved = nodes[np.uint64(p)]
        firsts[np.uint64(i)] = a
        seconds[np.uint64(i)] = b
        nodes[np.uint64(i)] = moved
        position[np.uint64(moved)] = i
        i = p
    firsts[np.uint64(i)] = first
    seconds[np.uint64(i)] = second
    nodes[np.uint64(i)] = node
    position[np.uint64(node)] = i
    return i


@helper
def _sink(firsts, seconds, nodes, position, size, i, first, second, node):
    """Put a node at slot i of the heap, or as far below as its key wants."""
    child = 4 * i + 1
    while child < size:
        w = firsts[np.uint64(child)]
        x = firsts[np.uint64(child + 1)]
        y = firsts[np.uint64(child + 2)]
        z = firsts[np.uint64(child + 3)]
        left = min(w, x)
        right = min(y, z)
        a = min(left, right)
        c = child + (np.int64(z < y) + 2 if right < left else np.int64(x < w))
        if (w == x) | (y == z) | (left == right):
            for k in range(child, child + 4):  # c is one of those whose first part is the least
                better = (firsts[np.uint64(k)] == a) & (
                    seconds[np.uint64(k)] < seconds[np.uint64(c)]
                )
                c = k if better else c
        b = seconds[np.uint64(c)]
        if first < a or (first == a and second <= b):
            break
        moved = nodes[np.uint64(c)]
        firsts[np.uint64(i)] = a
        seconds[np.uint64(i)] = b
        nodes[np.uint64(i)] = moved
        position[np.uint64(moved)] = i
        i = c
        child = 4 * i + 1
    firsts[np.uint64(i)] = first
    seconds[np.uint64(i)] = second
    nodes[np.uint64(i)] = node
    position[np.uint64(node)] = i


@helper
def _update_vertex(node, ahead, state, position, firsts, seconds, nodes, size):
    """Have a node on the open list exactly if its g and rhs differ; `ahead` is its h + km.

    What is left to do: the slot of the heap (ABSENT where nothing is left), the key and the node
    that is to be put there, and the heap's new size.
    """
    g = state[np.uint64(2 * node)]
    rhs = state[np.uint64(2 * node + 1)]
    second = min(g, rhs)
    first = second + ahead
    slot = np.int64(position[np.uint64(node)])
    position[np.uint64(node)] = ABSENT
    end = np.uint64(max(size - 1, 0))
    last = np.int64(nodes[end])
    last_first = firsts[end]
    last_second = seconds[end]
    firsts[end] = np.inf if g == rhs and slot != ABSENT else last_first
    if g != rhs:
        return (
            (slot, first, second, node, size)
            if slot != ABSENT
            else (size, first, second, node, size + 1)
        )
    if slot != ABSENT:
        return (
            (slot if slot < size - 1 else np.int64(ABSENT)),
            last_first,
            last_second,
            last,
            size - 1,
        )
    return slot, first, second, node, size


@helper
def _touched(node, value, raised, row_steps, costs, steps, edges, state):
    """Directions, as bits, of the neighbours that a node touches whose g becomes, or where `raised`
    was, `value`.

    They come to a lower rhs by way of it; or their rhs may have rested on it.
    """
    found = np.int64(0)
    for k in range(8):  # unrolled by the compiler
        there = node + row_steps[k] + COL_STEP[k]
        pair = np.float64(costs[np.uint64(node)]) + np.float64(costs[np.uint64(there)])
        step = (
            _step(k, pair, steps)
            if edges is None
            else _directed_step(there, OPPOSITE[k], pair, edges)
        )
        by_way = value + step
        rhs = state[np.uint64(2 * there + 1)]
        found |= np.int64((by_way == rhs) & (by_way < np.inf) if raised else by_way < rhs) << k
    return found


@kernel
def begin(goal, state, heap):
    """A search that knows the goal alone, over rows that have just been read; the size of its open
    list.
    """
    position, firsts, seconds, nodes = heap
    state[2 * goal + 1] = 0.0
    _rise(firsts, seconds, nodes, position, 0, 0.0, 0.0, goal)
    return 1


@kernel
def mend(pending, search, terrain, edges, state, heap, size, noted, until):
    """Work out rhs anew wherever a step has changed; how many nodes are left once it is late, and
    the list's size.
    """
    stride, start, goal, corner_cutting, steps, prices, km = search
    costs, walls = terrain
    position, firsts, seconds, nodes = heap
    changed, is_changed = noted
    row_steps = (-stride, stride, 0, 0, -stride, -stride, stride, stride)
    start_row = start // stride
    start_col = start % stride
    for n in range(pending):
        if n % _LOOK_EVERY == _LOOK_EVERY - 1 and late(until):
            left = pending - n
            for m in range(left):
                changed[m] = changed[n + m]
            return left, size
        node = np.int64(changed[n])
        is_changed[node] = 0
        if node == goal:
            continue
        rhs = np.inf
        if costs[node] < np.inf:  # so not on the border, whose neighbours are not all there
            rhs, _ = _least_by_way(
                node, row_steps, corner_cutting, steps, edges, costs, walls, state
            )
        if rhs == state[2 * node + 1]:
            continue
        state[2 * node + 1] = rhs
        ahead = km + octile(
            node // stride, node % stride, start_row, start_col, prices[0], prices[1]
        )
        slot, first, second, moved, size = _update_vertex(
            node, ahead, state, position, firsts, seconds, nodes, size
        )
        if slot != ABSENT:
            above = _rise(firsts, seconds, nodes, position, slot, first, second, moved)
            if above == slot and 4 * slot + 1 < size:
                _sink(firsts, seconds, nodes, position, size, slot, first, second, moved)
    return 0, size


@kernel
def expand(search, terrain, edges, state, heap, size, until):
    """ComputeShortestPath: expand until the start is settled or it is late, see `clock.late`.

    The code, the number of expansions and the open list's size.
    """
    stride, start, goal, corner_cutting, steps, prices, km = search
    costs, walls = terrain
    position, firsts, seconds, nodes = heap
    row_steps = (-stride, stride, 0, 0, -stride, -stride, stride, stride)
    start_row = start // stride
    start_col = start % stride
    inverse_stride = 1.0 / stride
    expansions = 0
    while size > 0:
        g = state[2 * start]
        rhs = state[2 * start + 1]
        second = min(g, rhs)
        first = second + km
        if first > EXACT:
            first *= CAUTION
        if rhs <= g and not (firsts[0] < first or (firsts[0] == first and seconds[0] < second)):
            break
        if expansions % _LOOK_EVERY == _LOOK_EVERY - 1 and late(until):
            return PAUSED, expansions, size
        node = np.int64(nodes[0])
        g = state[np.uint64(2 * node)]
        rhs = state[np.uint64(2 * node + 1)]
        second = min(g, rhs)
        row = np.int64((node + 0.5) * inverse_stride)
        col = node - row * stride
        ahead = km + octile(row, col, start_row, start_col, prices[0], prices[1])
        first = second + ahead
        if firsts[0] < first or (firsts[0] == first and seconds[0] < second):
            _sink(firsts, seconds, nodes, position, size, 0, first, second, node)
            continue
        expansions += 1
        raised = g <= rhs
        touched = _touched(
            node, g if raised else rhs, raised, row_steps, costs, steps, edges, state
        )
        state[np.uint64(2 * node)] = np.inf if raised else rhs
        # A node that leaves the list leaves its slot to the first neighbour to come on. With a key
        # not much greater that one stays near the top, where the heap's last entry would sink to
        # the bottom again.
        vacant = not raised or rhs == np.inf
        if vacant:
            position[np.uint64(node)] = ABSENT
            firsts[0] = -np.inf
        else:
            _sink(firsts, seconds, nodes, position, size, 0, rhs + ahead, rhs, node)
        while touched:
            k = lowest_bit(touched)
            touched &= touched - 1
            up = np.int64(ROW_STEP[k])
            left = np.int64(COL_STEP[k])
            there = node + up * stride + left
            if there == goal:
                continue
            if raised:
                by_way, _ = _least_by_way(
                    there, row_steps, corner_cutting, steps, edges, costs, walls, state
                )
                if by_way == state[np.uint64(2 * there + 1)]:
                    continue
            else:
                pair = np.float64(costs[np.uint64(node)]) + np.float64(costs[np.uint64(there)])
                step = (
                    _step(k, pair, steps)
                    if edges is None
                    else _directed_step(there, OPPOSITE[k], pair, edges)
                )
                by_way = rhs + step
                if (
                    k >= 4
                    and not corner_cutting
                    and (walls[node + up * stride] or walls[node + left])
                ):
                    continue
            state[np.uint64(2 * there + 1)] = by_way
            ahead = km + octile(row + up, col + left, start_row, start_col, prices[0], prices[1])
            slot, first, second, moved, grown = _update_vertex(
                there, ahead, state, position, firsts, seconds, nodes, size
            )
            if vacant and grown > size:
                slot = np.int64(0)
                grown = size
                vacant = False
            size = grown
            if slot != ABSENT:
                above = _rise(firsts, seconds, nodes, position, slot, first, second, moved)
                if above == slot and 4 * slot + 1 < size:
                    _sink(firsts, seconds, nodes, position, size, slot, first, second, moved)
        if vacant:
            size -= 1
            end = np.uint64(size)
            first = firsts[end]
            second = seconds[end]
            moved = np.int64(nodes[end])
            firsts[end] = np.inf
            if size > 0:
                _sink(firsts, seconds, nodes, position, size, 0, first, second, moved)
    return SETTLED, expansions, size


@kernel
def descend(search, terrain, edges, state, cells, path):
    """Write the path that follows the least cost to the goal, as far as `path` reaches; its length.

    0 if it does not lead to the goal.
    """
    stride, start, goal, corner_cutting, steps, _, _ = search
    costs, walls = terrain
    row_steps = (-stride, stride, 0, 0, -stride, -stride, stride, stride)
    node = start
    n = 0
    while n < cells:
        if n < len(path):
            path[n, 0] = node // stride - 1
            path[n, 1] = node % stride - 1
        n += 1
        if node == goal:
            return n
        _, k = _least_by_way(node, row_steps, corner_cutting, steps, edges, costs, walls, state)
        if k < 0:
            return 0
        node += ROW_STEP[k] * stride + COL_STEP[k]
    return 0
