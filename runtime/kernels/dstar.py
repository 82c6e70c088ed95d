"""The kernels of D* Lite: reading the map, mending what a change touched, expanding, following the
path.

The search leads from the goal to the start, so a node's neighbours come to it by the steps that
lead back. ``state`` is (2 · nodes,) float64, g of node n at 2n and rhs at 2n + 1. Where steps are
directed, ``edges`` is a `UnitEdges`, else None; costs then say only whether a node can be stood on,
and are 0 or inf.
"""

import numpy as np
from numpy import float32, float64, inf, int64, uint64

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.by_address import borrowed
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import (
    COL_STEP,
    FOUND,
    OPPOSITE,
    PAUSED,
    ROW_STEP,
    lowest_bit,
    neighbour,
    octile,
    row_steps,
)
from nnpp_edge.runtime.kernels.records import (
    Area,
    CostSource,
    DStarSearch,
    Heap,
    Known,
    Mask,
    Noted,
    UnitEdges,
)

READ = 0
STALE = 1
UNREAD = 2
"""Of a row: what is known of it is right; its region is another; nothing is known of it."""
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


@inlined
def _g(state, node):
    return state[uint64(2 * node)]


@inlined
def _rhs(state, node):
    return state[uint64(2 * node + 1)]


# Reading the map


@inlined
def _read(node, source, known):
    """Read what one node weighs; whether its steps have changed."""
    at = uint64(node)
    allowed = (known.inside[at] != 0) | (node == source.start) | (node == source.goal)
    weight = source.weights[at]
    wall = weight == inf
    cost = float32(min(np.rint(source.factor * weight), DEAREST))
    cost = float32(inf) if wall | (not allowed) else cost
    changed = (cost != known.costs[at]) | (wall != known.walls[at])
    known.costs[at] = cost
    known.walls[at] = wall
    return changed


@helper
def _note(node, stride, noted, pending):
    """Put a node and its neighbours down as changed; the number of nodes put down so far."""
    for k in range(9):  # unrolled by the compiler
        there = node + (k // 3 - 1) * stride + k % 3 - 1
        noted.changed[uint64(pending)] = there
        pending += 1 - int64(noted.is_changed[uint64(there)])
        noted.is_changed[uint64(there)] = 1
    return pending


@kernel
def read_rectangle(area, rows_left, source, directed, known, noted, pending):
    """Read an `Area` of the map; the number of nodes put down as changed so far: where steps are
    `directed`, all.

    Rows that are `UNREAD` are left for `read_rows`.
    """
    area = Area(*area)
    source = borrowed(CostSource(*source))
    known = borrowed(Known(*known))
    noted = borrowed(Noted(*noted))
    for row in range(area.row0, area.row1):
        if rows_left[row + 1] == UNREAD:
            continue
        for col in range(area.col0, area.col1):
            node = (row + 1) * source.stride + col + 1
            if _read(node, source, known) or directed:
                pending = _note(node, source.stride, noted, pending)
    return pending


@kernel
def read_rows(rows_left, mask, source, known, state, heap, noted, pending, until):
    """Read rows that have not been read, or whose region is another; the number of nodes put down
    as changed so far.

    `rows_left`, (H + 2,) uint8, says of each row, and those of the border, whether it is `UNREAD`,
    `STALE` or `READ`, and is written. What is kept of an unread row may hold anything: nothing has
    been found out there, and none of its nodes is put down. Once it is late, the rows that are left
    stay as they are.
    """
    mask = borrowed(Mask(*mask))
    source = borrowed(CostSource(*source))
    known = borrowed(Known(*known))
    heap = borrowed(Heap(*heap))
    noted = borrowed(Noted(*noted))
    stride = source.stride
    for row in range(len(rows_left)):
        if rows_left[row] == READ:
            continue
        anew = rows_left[row] == UNREAD
        first = row * stride
        if anew:
            end = first + stride
            known.costs[first:end] = inf
            known.walls[first:end] = 1
            known.inside[first:end] = 0
            heap.position[first:end] = ABSENT
            heap.firsts[first:end] = inf
            state[2 * first : 2 * end] = inf
        cols = len(mask.col_block) if 0 < row < len(rows_left) - 1 else 0
        for col in range(cols):
            node = first + col + 1
            i = uint64(mask.row_block[row - 1])
            now = mask.blocks[i, uint64(mask.col_block[col])]
            if anew or now != known.inside[node]:
                known.inside[node] = now
                if _read(node, source, known) and not anew:
                    pending = _note(node, stride, noted, pending)
        rows_left[row] = READ
        if late(until):
            break
    return pending


# Costs of steps


@inlined
def _step(node, k, there, search, known, edges):
    """Cost, in units, of the step from a node in direction k."""
    pair = float64(known.costs[uint64(node)]) + float64(known.costs[uint64(there)])
    if edges is not None:
        directed = borrowed(UnitEdges(*edges))
        return np.rint(directed.factor * directed.edges[uint64(node), uint64(k)]) + pair
    if k < 4:
        return search.length_straight + pair
    return search.length_diagonal + np.floor(search.weight_diagonal * pair)


@inlined
def _step_back(node, k, there, search, known, edges):
    """Cost, in units, of the step that comes to a node from its neighbour in direction k."""
    return _step(there, OPPOSITE[k], node, search, known, edges)


@inlined
def _cuts_wall(node, k, search, known):
    """Whether a step in direction k may not be made, as it passes beside an impassable cell."""
    if k < 4 or search.corner_cutting:
        return False
    above = known.walls[uint64(node + ROW_STEP[k] * search.stride)]
    return (above | known.walls[uint64(node + COL_STEP[k])]) != 0


@inlined
def _least_by_way(node, search, known, edges, state):
    """The least cost to the goal by way of a neighbour of a passable node, and the direction of
    that neighbour.
    """
    down = row_steps(search.stride)
    best = inf
    direction = -1
    for k in range(8):  # unrolled by the compiler
        there = node + down[k] + COL_STEP[k]
        step = _step(node, k, there, search, known, edges)
        if k >= 4 and not search.corner_cutting:
            above = known.walls[uint64(node + down[k])]
            step = inf if above | known.walls[uint64(node + COL_STEP[k])] else step
        by_way = step + _g(state, there)
        direction = k if by_way < best else direction
        best = min(best, by_way)
    return best, direction


@inlined
def _touched(node, value, raised, search, known, edges, state):
    """Directions, as bits, of the neighbours that a node touches whose g becomes, or where `raised`
    was, `value`.

    They come to a lower rhs by way of it; or their rhs may have rested on it.
    """
    down = row_steps(search.stride)
    found = int64(0)
    for k in range(8):  # unrolled by the compiler
        there = node + down[k] + COL_STEP[k]
        by_way = value + _step_back(node, k, there, search, known, edges)
        rhs = _rhs(state, there)
        rested = (by_way == rhs) & (by_way < inf)
        found |= int64(rested if raised else by_way < rhs) << k
    return found


# The open list


@inlined
def _is_above(heap, i, first, second):
    """Whether the entry at slot i of the heap has a lower key."""
    there = heap.firsts[uint64(i)]
    return there < first or (there == first and heap.seconds[uint64(i)] < second)


@inlined
def _put(heap, i, first, second, node):
    """Put a node at slot i of the heap."""
    heap.firsts[uint64(i)] = first
    heap.seconds[uint64(i)] = second
    heap.nodes[uint64(i)] = node
    heap.position[uint64(node)] = i


@helper
def _rise(heap, i, first, second, node):
    """Put a node at slot i of the heap, or as far above as its key wants; the slot that it got."""
    while i > 0:
        above = (i - 1) >> 2
        a = heap.firsts[uint64(above)]
        b = heap.seconds[uint64(above)]
        if a < first or (a == first and b <= second):
            break
        _put(heap, i, a, b, heap.nodes[uint64(above)])
        i = above
    _put(heap, i, first, second, node)
    return i


@inlined
def _least_below(heap, child):
    """The slot with the least key of four, from `child` on."""
    firsts = heap.firsts
    w = firsts[uint64(child)]
    x = firsts[uint64(child + 1)]
    y = firsts[uint64(child + 2)]
    z = firsts[uint64(child + 3)]
    left = min(w, x)
    right = min(y, z)
    least = min(left, right)
    slot = child + (int64(z < y) + 2 if right < left else int64(x < w))
    if (w == x) | (y == z) | (left == right):
        for k in range(child, child + 4):  # the slot is one of those whose first part is the least
            second = heap.seconds[uint64(k)]
            better = (firsts[uint64(k)] == least) & (second < heap.seconds[uint64(slot)])
            slot = k if better else slot
    return slot


@helper
def _sink(heap, size, i, first, second, node):
    """Put a node at slot i of the heap, or as far below as its key wants."""
    child = 4 * i + 1
    while child < size:
        slot = _least_below(heap, child)
        a = heap.firsts[uint64(slot)]
        b = heap.seconds[uint64(slot)]
        if first < a or (first == a and second <= b):
            break
        _put(heap, i, a, b, heap.nodes[uint64(slot)])
        i = slot
        child = 4 * i + 1
    _put(heap, i, first, second, node)


@helper
def _update_vertex(node, ahead, state, heap, size):
    """Have a node on the open list exactly if its g and rhs differ; `ahead` is its h + km.

    What is left to do: the slot of the heap (ABSENT where nothing is left), the key and the node
    that is to be put there, and the heap's new size.
    """
    g = _g(state, node)
    rhs = _rhs(state, node)
    second = min(g, rhs)
    first = second + ahead
    slot = int64(heap.position[uint64(node)])
    heap.position[uint64(node)] = ABSENT
    listed = slot != ABSENT
    end = uint64(max(size - 1, 0))
    last = int64(heap.nodes[end])
    last_first = heap.firsts[end]
    last_second = heap.seconds[end]
    heap.firsts[end] = inf if g == rhs and listed else last_first
    if g != rhs and listed:  # its key has changed
        return slot, first, second, node, size
    if g != rhs:  # it comes on the list
        return size, first, second, node, size + 1
    if listed:  # it leaves the list, and its place to the last entry
        slot = slot if slot < size - 1 else int64(ABSENT)
        return slot, last_first, last_second, last, size - 1
    return slot, first, second, node, size


@inlined
def _place(heap, size, slot, first, second, node):
    """Put a node where its key wants it, from a slot of the heap on, unless that is `ABSENT`."""
    if slot != ABSENT:
        above = _rise(heap, slot, first, second, node)
        if above == slot and 4 * slot + 1 < size:
            _sink(heap, size, slot, first, second, node)


@inlined
def _h(row, col, start_row, start_col, search):
    """The octile distance to the start."""
    return octile(row, col, start_row, start_col, search.h_straight, search.h_diagonal)


@kernel
def begin(goal, state, heap):
    """A search that knows the goal alone, over rows that have just been read; the size of its open
    list.
    """
    state[2 * goal + 1] = 0.0
    _put(Heap(*heap), 0, 0.0, 0.0, goal)
    return 1


@kernel
def mend(pending, search, known, edges, state, heap, size, noted, until):
    """Work out rhs anew wherever a step has changed; how many nodes are left once it is late, and
    the list's size.
    """
    search = DStarSearch(*search)
    known = borrowed(Known(*known))
    state = borrowed(state)
    heap = borrowed(Heap(*heap))
    noted = borrowed(Noted(*noted))
    stride = search.stride
    start_row = search.start // stride
    start_col = search.start % stride
    for n in range(pending):
        if n % _LOOK_EVERY == _LOOK_EVERY - 1 and late(until):
            left = pending - n
            for m in range(left):
                noted.changed[m] = noted.changed[n + m]
            return left, size
        node = int64(noted.changed[n])
        noted.is_changed[node] = 0
        if node == search.goal:
            continue
        rhs = inf
        if known.costs[node] < inf:  # so not on the border, whose neighbours are not all there
            rhs, _ = _least_by_way(node, search, known, edges, state)
        if rhs == _rhs(state, node):
            continue
        state[2 * node + 1] = rhs
        h = _h(node // stride, node % stride, start_row, start_col, search)
        slot, first, second, moved, size = _update_vertex(node, search.km + h, state, heap, size)
        _place(heap, size, slot, first, second, moved)
    return 0, size


@inlined
def _is_settled(search, state, heap):
    """Whether the start's rhs is its cost to the goal: no key on the open list is lower."""
    g = _g(state, search.start)
    rhs = _rhs(state, search.start)
    second = min(g, rhs)
    first = second + search.km
    if first > EXACT:
        first *= CAUTION
    return rhs <= g and not _is_above(heap, 0, first, second)


@inlined
def _new_rhs(node, k, there, rhs, raised, search, known, edges, state):
    """rhs of a node's neighbour in direction k, after the node's g has changed: to its rhs, or to
    inf where `raised`.
    """
    if raised:
        by_way, _ = _least_by_way(there, search, known, edges, state)
        return by_way
    if _cuts_wall(node, k, search, known):
        return _rhs(state, there)
    return rhs + _step_back(node, k, there, search, known, edges)


@inlined
def _fill_vacancy(heap, size):
    """Move the last entry of a heap to its top, which a node has left; the new size."""
    size -= 1
    end = uint64(size)
    first = heap.firsts[end]
    second = heap.seconds[end]
    moved = int64(heap.nodes[end])
    heap.firsts[end] = inf
    if size > 0:
        _sink(heap, size, 0, first, second, moved)
    return size


@kernel
def expand(search, known, edges, state, heap, size, until):
    """ComputeShortestPath: expand until the start is settled or it is late, see `clock.late`.

    The code, the number of expansions and the open list's size.
    """
    search = DStarSearch(*search)
    known = borrowed(Known(*known))
    state = borrowed(state)
    heap = borrowed(Heap(*heap))
    stride = search.stride
    start_row = search.start // stride
    start_col = search.start % stride
    inverse_stride = 1.0 / stride
    expansions = 0
    while size > 0 and not _is_settled(search, state, heap):
        if expansions % _LOOK_EVERY == _LOOK_EVERY - 1 and late(until):
            return PAUSED, expansions, size
        # the node of the lowest key, unless the start's moves have raised that
        node = int64(heap.nodes[0])
        g = _g(state, node)
        rhs = _rhs(state, node)
        row = int64((node + 0.5) * inverse_stride)
        col = node - row * stride
        ahead = search.km + _h(row, col, start_row, start_col, search)
        second = min(g, rhs)
        first = second + ahead
        if _is_above(heap, 0, first, second):
            _sink(heap, size, 0, first, second, node)
            continue
        expansions += 1
        # g falls to rhs, or where it is too low becomes inf
        raised = g <= rhs
        value = g if raised else rhs
        touched = _touched(node, value, raised, search, known, edges, state)
        state[uint64(2 * node)] = inf if raised else rhs
        # A node that leaves the list leaves its slot to the first neighbour to come on. With a key
        # not much greater that one stays near the top, where the heap's last entry would sink to
        # the bottom again.
        vacant = not raised or rhs == inf
        if vacant:
            heap.position[uint64(node)] = ABSENT
            heap.firsts[0] = -inf
        else:
            _sink(heap, size, 0, rhs + ahead, rhs, node)
        # rhs of the neighbours, and with it their places on the list
        while touched:
            k = lowest_bit(touched)
            touched &= touched - 1
            there = neighbour(node, k, stride)
            if there == search.goal:
                continue
            new = _new_rhs(node, k, there, rhs, raised, search, known, edges, state)
            if new == _rhs(state, there):
                continue
            state[uint64(2 * there + 1)] = new
            h = _h(row + ROW_STEP[k], col + COL_STEP[k], start_row, start_col, search)
            update = _update_vertex(there, search.km + h, state, heap, size)
            slot, first, second, moved, grown = update
            if vacant and grown > size:
                slot = int64(0)
                grown = size
                vacant = False
            size = grown
            _place(heap, size, slot, first, second, moved)
        if vacant:
            size = _fill_vacancy(heap, size)
    return FOUND, expansions, size


@kernel
def descend(search, known, edges, state, cells, path):
    """Write the path that follows the least cost to the goal, as far as `path` reaches; its length.

    0 if it does not lead to the goal.
    """
    search = DStarSearch(*search)
    known = Known(*known)
    node = search.start
    n = 0
    while n < cells:
        if n < len(path):
            path[n, 0] = node // search.stride - 1
            path[n, 1] = node % search.stride - 1
        n += 1
        if node == search.goal:
            return n
        _, k = _least_by_way(node, search, known, edges, state)
        if k < 0:
            return 0
        node = neighbour(node, k, search.stride)
    return 0
