"""The kernels of D* Lite, by the names of its paper (Koenig and Likhachev, 2002).

The search leads from the goal to the start. A node whose g and rhs differ waits on the open list, a
heap with four entries below each. Its key is min(g, rhs) + h + km: the paper's second part tells a
node from those that its cost rests on where the first is equal, which it never is here, as h falls
by less along a step than the step costs.
"""

from numpy import float64, inf, int64, uint64

from nnpp_edge.runtime.compiled.kernel import inlined, kernel
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import (
    COL,
    COL_STEP,
    FOUND,
    OPPOSITE,
    PAUSED,
    ROW,
    ROW_STEP,
    beside_wall,
    fetch_around,
    lowest_bit,
    neighbour,
    octile,
    outside,
    step_cost,
)
from nnpp_edge.runtime.kernels.records import (
    DStar,
    Rectangle,
)
from nnpp_edge.runtime.kernels.tiles import open_at

_LOOK_EVERY = 512
"""Expansions between two readings of the clock."""
ABSENT = -1
"""In place of a slot of the heap, of a node that is not on it."""
SPARE_SLOTS = 4
"""Slots of the heap beyond its entries, so that the last ones have four below each as well."""


# Costs


@inlined
def _cost(node, k, there, search):
    """Cost of the step from a node in direction k; inf where there is none."""
    edges = search.grid.edges
    if len(edges):
        return float64(edges[uint64(node), uint64(k)])
    weights = search.grid.weights
    pair = float64(weights[uint64(node)]) + float64(weights[uint64(there)])
    cost = step_cost(k >= 4, pair, search.grid.steps)
    if k >= 4 and not search.grid.corner_cutting:
        down = ROW_STEP[k] * search.grid.stride
        cost = inf if beside_wall(weights, node, down, COL_STEP[k]) else cost
    return cost


@inlined
def _least_by_way(node, search):
    """The least cost to the goal by way of a neighbour, and the direction of that neighbour."""
    best = inf
    direction = int64(-1)
    for k in range(8):  # unrolled by the compiler
        there = neighbour(node, k, search.grid.stride)
        by_way = _cost(node, k, there, search) + search.g[uint64(there)]
        direction = k if by_way < best else direction
        best = min(best, by_way)
    return best, direction


@inlined
def _key(node, row, col, search):
    """The key by which a node waits on the open list."""
    prices = (search.h_straight, search.h_diagonal)
    h = octile(row, col, search.start_row, search.start_col, *prices)
    return min(search.g[uint64(node)], search.rhs[uint64(node)]) + h + search.km


@inlined
def _may_enter(node, row, col, search):
    """Whether the region has a node; the ends count as inside."""
    at_end = node == search.start or node == search.goal
    return at_end or not outside(search.region, row, col)


# The open list


@inlined
def _put(slot, key, node, search):
    """Put an entry at a slot of the heap."""
    search.keys[uint64(slot)] = key
    search.nodes[uint64(slot)] = node
    search.slots[uint64(node)] = slot


@inlined
def _place(slot, key, node, search):
    """Put an entry at a slot of the heap, or as far above or below as its key wants."""
    keys = search.keys
    while slot > 0:
        above = (slot - 1) >> 2
        if keys[uint64(above)] <= key:
            break
        _put(slot, keys[uint64(above)], int64(search.nodes[uint64(above)]), search)
        slot = above
    size = search.size[0]
    below = 4 * slot + 1
    while below < size:
        # the least of the four below, without a branch
        a = keys[uint64(below)]
        b = keys[uint64(below + 1)]
        c = keys[uint64(below + 2)]
        d = keys[uint64(below + 3)]
        ab = min(a, b)
        cd = min(c, d)
        if key <= min(ab, cd):
            break
        least = below + (2 + int64(d < c) if cd < ab else int64(b < a))
        _put(slot, keys[uint64(least)], int64(search.nodes[uint64(least)]), search)
        slot = least
        below = 4 * slot + 1
    _put(slot, key, node, search)


@inlined
def _remove(slot, search):
    """Take an entry off the list."""
    search.slots[uint64(search.nodes[uint64(slot)])] = ABSENT
    size = search.size[0] - 1
    search.size[0] = size
    key = search.keys[uint64(size)]
    node = int64(search.nodes[uint64(size)])
    search.keys[uint64(size)] = inf
    if slot < size:
        _place(slot, key, node, search)


@inlined
def _update_vertex(node, row, col, rhs, search):
    """Write rhs of a node, and have the node on the open list exactly if that differs from g."""
    search.rhs[uint64(node)] = rhs
    slot = int64(search.slots[uint64(node)])
    if search.g[uint64(node)] != rhs:
        if slot == ABSENT:
            for numbers in (search.g, search.rhs):
                fetch_around(numbers, 1, node, search.grid.stride)
            fetch_around(search.grid.weights, 1, node, search.grid.stride)
            slot = search.size[0]
            search.size[0] = slot + 1
        _place(slot, _key(node, row, col, search), node, search)
    elif slot != ABSENT:
        _remove(slot, search)


# The search


@kernel
def update_vertices(search: DStar, part: Rectangle, blocks, until):
    """Work out rhs anew of the nodes in a `Rectangle` of the map, as far as they lie in some
    `blocks` of the region's bitmap, (I, J) bool; the number of rows done before it is late.
    """
    for done in range(part.rows):
        row = part.row + done + 1
        wanted = blocks[search.region.row_block[row - 1]]
        if not wanted.any():
            continue
        for col in range(part.col + 1, part.col + part.cols + 1):
            node = row * search.grid.stride + col
            if node == search.goal or not wanted[uint64(search.region.col_block[col - 1])]:
                continue
            rhs = inf
            if _may_enter(node, row, col, search):
                rhs, _ = _least_by_way(node, search)
            _update_vertex(node, row, col, rhs, search)
        if late(until):
            return done + 1
    return part.rows


@inlined
def _neighbours(node, g, resting, search):
    """The neighbours, as bits, whose rhs rests on a node of this g; or else would, and lower."""
    found = int64(0)
    for k in range(8):  # unrolled by the compiler
        there = neighbour(node, k, search.grid.stride)
        by_way = _cost(there, OPPOSITE[k], node, search) + g
        rhs = search.rhs[uint64(there)]
        rests = (by_way == rhs) & (by_way < inf) if resting else by_way < rhs
        found |= int64(rests) << k
    return found


@inlined
def _lower(node, row, col, search):
    """Have g of a node fall to its rhs, and rhs of neighbours for which that is cheaper."""
    g = search.rhs[uint64(node)]
    search.g[uint64(node)] = g
    reached = _neighbours(node, g, False, search)
    while reached:
        k = lowest_bit(reached)
        reached &= reached - 1
        there = neighbour(node, k, search.grid.stride)
        below = row + ROW_STEP[k]
        right = col + COL_STEP[k]
        if _may_enter(there, below, right, search):
            by_way = _cost(there, OPPOSITE[k], node, search) + g
            _update_vertex(there, below, right, by_way, search)


@inlined
def _raise(node, row, col, search):
    """Have g of a node rise to inf, and work out rhs anew of the neighbours that rested on it."""
    g = search.g[uint64(node)]
    search.g[uint64(node)] = inf
    _update_vertex(node, row, col, search.rhs[uint64(node)], search)
    rested = _neighbours(node, g, True, search)
    while rested:
        k = lowest_bit(rested)
        rested &= rested - 1
        there = neighbour(node, k, search.grid.stride)
        rhs, _ = _least_by_way(there, search)
        _update_vertex(there, row + ROW_STEP[k], col + COL_STEP[k], rhs, search)


@kernel
def compute_shortest_path(search: DStar, until):
    """Expand nodes until rhs of the start is its cost to the goal, or it is late: which, as `FOUND`
    or `PAUSED`, and the number of expansions.
    """
    stride = search.grid.stride
    start = search.start
    inverse_stride = 1.0 / stride
    expansions = 0
    computed = False
    while search.size[0] > 0:
        # the start is settled where no key is lower than its own, and its g is not to rise
        cost = min(search.g[uint64(start)], search.rhs[uint64(start)])
        settled = search.keys[0] >= cost + search.km
        if settled and search.rhs[uint64(start)] <= search.g[uint64(start)]:
            break
        if (computed or expansions % _LOOK_EVERY == _LOOK_EVERY - 1) and late(until):
            return PAUSED, expansions
        node = int64(search.nodes[0])
        row = int64((node + 0.5) * inverse_stride)
        col = node - row * stride
        g = search.g[uint64(node)]
        rhs = search.rhs[uint64(node)]
        key = _key(node, row, col, search)
        if search.keys[0] < key:
            _place(0, key, node, search)
        else:
            expansions += 1
            computed = open_at(search.grid.tiles, row - 1, col - 1)
            if g > rhs:
                _remove(0, search)
                _lower(node, row, col, search)
            else:
                _raise(node, row, col, search)
    return FOUND, expansions


@kernel
def trace(search: DStar, path):
    """Write the cells of the path from the start to the goal; its length."""
    stride = search.grid.stride
    node = search.start
    length = 0
    while length < len(path):
        path[length, ROW] = node // stride - 1
        path[length, COL] = node % stride - 1
        length += 1
        if node == search.goal:
            break
        _, k = _least_by_way(node, search)
        node = neighbour(node, k, stride)
    return length
