"""Corridors: what is searched on the next finer level, marked in a bitmap of numbers."""

from numpy import float32, inf, int64, uint8

from nnpp_edge.runtime.compiled.kernel import helper, inlined, kernel
from nnpp_edge.runtime.kernels.by_address import call_at, put_record, reader_of
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.expansion import BELOW, NO_HINTS, expand
from nnpp_edge.runtime.kernels.nodes import (
    DIRECTION_BITS,
    FOUND,
    FULL,
    OPEN_BIT,
    OPPOSITE,
    ORIGIN,
    PAUSED,
    STAMP_SHIFT,
    WITHOUT_END,
    g_of,
    neighbour,
    next_stamp,
    step_cost,
    word_of,
)
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.records import (
    BEGUN,
    LEVEL_AT,
    SPENT,
    TOP,
    CoarseLevel,
    Memory,
    RegionRecord,
    Width,
)
from nnpp_edge.runtime.kernels.tiles import open_at

_LOOK_EVERY = 256
"""Cells between two readings of the clock."""
_APART = 1
_REACHED = 2
"""Of a cell of a region: a search did not come to it, and did."""
_OUTCOME = (0, 0, 0, inf)
"""Of the kinds that `expand` returns."""
_level_at = reader_of(CoarseLevel)


@kernel
def keep_level(level: CoarseLevel, memory):
    """Write a coarse level into memory, for `descend`."""
    put_record(memory, level)


@helper
def _mark(row, col, radius, region):
    """Mark the four quarters of a cell, and those within `radius` (as the king moves) of them."""
    rows, cols = region.bitmap.shape
    top = 2 * row
    left = 2 * col
    for i in range(max(top - radius, 0), min(top + 2 + radius, rows)):
        for j in range(max(left - radius, 0), min(left + 2 + radius, cols)):
            region.bitmap[i, j] = region.stamp


@inlined
def _marked(level):
    """What was marked last, as a region of the next finer level."""
    return RegionRecord(level.bitmap, level.row_block, level.col_block, level.marked[0])


@helper
def _flood(level, start, limit, region, until):
    """Mark the cells on paths from `start` that cost at most `limit`, and find what it costs to
    reach them.

    Once it is late nothing more is marked.

    What is left from a cell is g of the search that began at the other end. With that as a bound,
    few cells are expanded twice, so a plain queue serves.
    """
    grid = level.grid
    edges = level.edges
    links = level.links
    weights = grid.weights
    stride = grid.stride
    searched = level.memory
    stamp = searched.meta[0]
    reached, queued, queue = level.flood
    mask = len(queue) - 1
    head = 0
    tail = 1
    ended = False
    queue[0] = start
    reached[start] = 0.0
    _mark(start // stride - 1, start % stride - 1, 0, region)
    while head != tail:
        node = int64(queue[head & mask])
        head += 1
        queued[node] = 0
        ended = ended or (head % _LOOK_EVERY == 0 and late(until))
        if ended:  # the queue is emptied for the next flood
            continue
        # the search that came here may not have left from here
        open_at(grid.tiles, node // stride - 1, node % stride - 1)
        for k in range(8):
            if not (links[node] >> k) & 1:
                continue
            there = neighbour(node, k, stride)
            word = searched.meta[2 * there + 1]
            if word >> STAMP_SHIFT != stamp or word & OPEN_BIT:
                continue
            if len(edges):
                step = edges[node, k]
            else:
                step = float32(step_cost(k >= 4, weights[node] + weights[there], grid.steps))
            cost = reached[node] + step
            if cost + searched.g[2 * there] > limit:
                continue
            row = there // stride - 1
            col = there % stride - 1
            marked = region.bitmap[2 * row, 2 * col] == region.stamp
            if marked and cost >= reached[there]:
                continue
            if not marked:
                _mark(row, col, 0, region)
            reached[there] = cost
            if not queued[there]:
                queued[there] = 1
                queue[tail & mask] = there
                tail += 1


@helper
def _surround(level, start, radius, band, until):
    """Mark what the next finer level is to search: what lies around the path that was found on this
    one, from the goal to `start`, and on paths of nearly the same cost.
    """
    level.marked[0] += 1
    region = _marked(level)
    meta = level.memory.meta
    stride = level.grid.stride
    if band > 0.0 and word_of(meta, start) & DIRECTION_BITS != ORIGIN:
        limit = (1.0 + band) * g_of(level.memory.g, start)
        _flood(level, start, limit, region, until)
    # the path last: the flood goes by the numbers that it wrote
    node = start
    while True:
        _mark(node // stride - 1, node % stride - 1, radius, region)
        k = word_of(meta, node) & DIRECTION_BITS
        if k == ORIGIN:
            break
        node -= neighbour(0, k, stride)


@inlined
def _node(level, cell, number):
    """The node of a coarse level, of that number, in which a cell of the map lies."""
    row, col = cell
    side = FACTOR**number
    return (row // side + 1) * level.grid.stride + col // side + 1


@helper
def _search(level, source, target, region, band, until, at):
    """Search a level from a node to another, and what costs at most 1 + `band` times as much: what
    `expand` came to.
    """
    given = level.memory
    goes_on = at[BEGUN]
    begin = int64(-1) if goes_on else source
    stamp = int64(given.meta[0]) if goes_on else next_stamp(given.meta)
    lists = (given.heads, given.entries, given.control, given.reals, given.path)
    memory = Memory(given.g, given.meta, stamp, *lists)
    beyond = 1.0 + band if band > 0.0 else BELOW
    place = (level.grid, level.links, region, NO_HINTS, beyond)
    task = (*place, (begin, target), level.rule, memory, (WITHOUT_END, until))
    code, _, spent, _ = call_at(expand, level.expand, task, _OUTCOME)
    at[BEGUN] = code in (PAUSED, FULL)
    at[SPENT] += 0 if at[BEGUN] else spent
    return code


@kernel
def descend(levels, start, goal, region: RegionRecord, width: Width, until, latest, at):
    """Search coarse levels from one down, each from the goal to the start and within what lies
    around the path on the one above, until what is to be searched on the map is marked.

    Parameters
    ----------
    levels : (L, RECORD_WORDS) int64
        Records `CoarseLevel` in memory, finest first.
    start, goal : (2,) int
        Cells of the map.
    region, width
        Where to look on the first level, `RegionRecord`, and the corridors' `Width`.
    until, latest : float
        Readings of the clock, s: when to pause, and from when on paths alone are marked.
    at : (DESCENT_SLOTS,) int64
        `TOP` and the others, changed: at first the first level's number, twice, 0 and 0. The same
        call goes on after `PAUSED`; after `FULL`, where that level's open list has been made
        larger.

    Returns
    -------
    int
        `FOUND`; `EXHAUSTED` where no way leads; `PAUSED` or `FULL`.
    """
    while at[LEVEL_AT] > 0:
        number = at[LEVEL_AT]
        level = _level_at(levels[number - 1])
        between = int64(number > 1)
        radius = width.radius + between * width.coarse_radius
        band = width.band + between * width.coarse_band
        inside = region
        if number < at[TOP]:
            inside = _marked(_level_at(levels[number]))
        # from the goal, as the costs from there bound the way on from each cell
        last = _node(level, start, number)
        code = _search(level, _node(level, goal, number), last, inside, band, until, at)
        if code != FOUND:
            return code
        _surround(level, last, radius, band, latest)
        at[LEVEL_AT] = number - 1
    return FOUND


@helper
def _was_reached(meta, stamp, states, rows, cols, row, col):
    """Whether a search came to any cell of the finest level below a cell of the next."""
    for i in range(FACTOR * row, min(FACTOR * row + FACTOR, rows)):
        for j in range(FACTOR * col, min(FACTOR * col + FACTOR, cols)):
            first = ((i + 1) * (cols + 2) + j + 1) * states
            for state in range(first, first + states):
                if meta[2 * state + 1] >> STAMP_SHIFT == stamp:
                    return True
    return False


@kernel
def close_dead_ends(links, region: RegionRecord, meta, stamp, states, shape, came, closed):
    """Close the links between cells of a region that a search of the map came to, until nothing was
    left, and those that it did not: how many.

    Parameters
    ----------
    links : (nodes,) uint8
        Of the first coarse level; changed.
    region
        `RegionRecord`.
    meta, stamp, states : (2 · nodes · states,) int32, int, int
        What the search left, as in `Memory`, its number, and the states of a node.
    shape : (rows, cols)
        Of the map.
    came : (nodes,) uint8
        Scratch, all 0.
    closed : (nodes,) uint8
        The bits that were taken from `links` are added.
    """
    map_rows, map_cols = shape
    rows = region.bitmap.shape[0] // 2
    cols = region.bitmap.shape[1] // 2
    stride = cols + 2
    count = 0
    for row in range(rows):
        for col in range(cols):
            quarters = 0
            for i in range(2 * row, 2 * row + 2):
                for j in range(2 * col, 2 * col + 2):
                    quarters += int64(region.bitmap[i, j] == region.stamp)
            node = (row + 1) * stride + col + 1
            if quarters and _was_reached(meta, stamp, states, map_rows, map_cols, row, col):
                came[node] = _REACHED
            elif quarters == 4:  # into the rest of another there may be a way
                came[node] = _APART
    for row in range(rows):
        first = (row + 1) * stride + 1
        for node in range(first, first + cols):
            if came[node] != _REACHED:
                continue
            for k in range(8):
                there = neighbour(node, k, stride)
                if came[there] == _APART and (links[node] >> k) & 1:
                    count += 1
                    _close(links, closed, node, k)
                    _close(links, closed, there, OPPOSITE[k])
    came[:] = 0
    return count


@helper
def _close(links, closed, node, k):
    """Close a cell's link in direction k."""
    bit = uint8(1 << k)
    closed[node] |= links[node] & bit
    links[node] &= ~bit
