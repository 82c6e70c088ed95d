"""Searches of a map's blocks whose links have prices, and the region around what they find. See `region.links`.

A link leads from a block to one of its eight neighbours, and has one price both ways. Blocks are numbered row by row
with a border of one block around, `stride` to a row; `prices` is (nodes, 8) float32 by block and direction, inf where
there is no block.
"""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.nodes import COL_STEP, OPPOSITE, ROW_STEP, STAMP_SHIFT, octile
from nnpp_edge.runtime.kernels.open_list import COARSE, FINE, NOTHING, SPAN, clear, next_block, pop, push
from nnpp_edge.runtime.kernels.pooling import FACTOR

FORWARDS = (1, 7, 3, 5)
"""The direction that leads along each heading, see `terrain.vehicle.HEADINGS`."""
_DIAGONAL = np.float32(2.0**0.5)
_INF = np.float32(np.inf)
FULL, LATE = -1, -2
_LOOK_EVERY = 4096
"""Blocks between two looks at the clock."""


@kernel
def price_links(answers, first, part, tables, lengths, links):
    """Prices of links by a network's answers, of a rectangle of blocks.

    Parameters
    ----------
    answers : (., ., 16) uint8
        See `network.passage_model`; those of block `first` come first.
    part : (row, col, rows, cols)
    tables : (dear, fine)
        (256,) float32 each: by the answer on half a way's T, what a length of it costs; by that on the chance that
        there is a way, what is added.
    lengths : (4,) float32
        Of a straight way along each heading.
    links : (prices, stride)
        Written.

    Returns
    -------
    float32
        The least price of a length.
    """
    row, col, rows, cols = part
    dear, fine = tables
    prices, stride = links
    lowest = np.uint8(255)
    for i in range(row, row + rows):
        for j in range(col, col + cols):
            node = (i + 1) * stride + j + 1
            y, x = np.uint64(i - first[0]), np.uint64(j - first[1])
            for k in range(4):
                ahead = FORWARDS[k]
                there = node + ROW_STEP[ahead] * stride + COL_STEP[ahead]
                if prices[node, ahead] < _INF:
                    way, chance = answers[y, x, np.uint64(12 + k)], answers[y, x, np.uint64(8 + k)]
                    price = lengths[k] * dear[way] + fine[chance]
                    prices[node, ahead], prices[there, OPPOSITE[ahead]] = price, price
                    lowest = min(lowest, way)
    return dear[lowest]


@kernel
def join_blocks(by_heading, links):
    """Prices of links of a whole map from those by block and heading, (4, R, C): of the link that leads forwards."""
    prices, stride = links
    prices[:] = np.inf
    for k in range(4):
        ahead, back = FORWARDS[k], OPPOSITE[FORWARDS[k]]
        down, right = ROW_STEP[ahead], COL_STEP[ahead]
        for i in range(max(-down, 0), by_heading.shape[1] - max(down, 0)):
            for j in range(by_heading.shape[2] - right):
                node = (i + 1) * stride + j + 1
                prices[node, ahead] = by_heading[k, i, j]
                prices[node + down * stride + right, back] = by_heading[k, i, j]


@kernel
def _straight(row, col, end, stride, least):
    """The least that a way to a block costs, if no link costs less than `least` for a block's side."""
    return octile(row, col, end // stride, end % stride, least, least * _DIAGONAL)


@kernel
def _left(row, col, ends, stride, least, guide):
    """The least that is left from a block to the last one."""
    straight = _straight(row, col, ends[1], stride, least)
    if guide is not None:
        costs, seen, number, limit = guide
        node = row * stride + col
        back = _straight(row, col, ends[0], stride, least)
        known = seen[node] >> 1 == number and costs[node] + back <= limit
        straight = max(costs[node] if known else limit - back, straight)
    return straight


@kernel
def _deal_out(chain, block, search, order, found, lists):
    """Put a coarse bucket's entries into fine ones; those beyond the last into coarse ones, where `block` is -1."""
    stride, least, ends, guide = search
    base, inverse_width = order
    reached = found[0]
    heads, entries = lists
    while chain != NOTHING:
        following, node = np.int64(entries[2 * chain + 1]), np.int64(entries[2 * chain])
        f = reached[node] + _left(node // stride, node % stride, ends, stride, least, guide)
        bucket = np.int64(min(max((f - base) * inverse_width, np.float32(0.0)), np.float32(SPAN)))
        slot = max(bucket - block * FINE, np.int64(0)) if block >= 0 else FINE + bucket // FINE
        entries[2 * chain + 1] = heads[slot]
        heads[slot] = chain
        chain = following


@kernel
def settle_links(links, least, ends, beyond, found, guide, memory, until):
    """Costs from the first block to all that lie on ways to the last which cost at most `beyond` times the least.

    Parameters
    ----------
    links : (prices, stride)
        Of all blocks.
    least : float32
        No link costs less for a block's side.
    ends : (first, last)
        Blocks.
    beyond : float32
        At least 1.
    found : (reached, seen, number)
        (nodes,) float32 costs, and (nodes,) int32 twice the number of the search that reached a block, one more as
        long as it waits to be expanded; both written; and this one's number.
    guide : (reached, seen, number, limit) or None
        What a search from the last block to the first left, when no link was dearer than now, and the cost up to
        which it searched.
    memory : (heads, entries, control)
        Of an open list, see `kernels.open_list`.
    until : float
        Reading of the clock, see `clock.late`.

    Returns
    -------
    int
        Blocks expanded; `FULL` where the open list has no room, `LATE` where time was up.
    """
    prices, stride = links
    reached, seen, number = found
    heads, entries, control = memory
    first, last = ends
    search = stride, least, ends, guide
    lists = heads, entries
    clear(heads, control)
    base = _left(first // stride, first % stride, ends, stride, least, guide)
    inverse_width = np.float32(1.0) / least
    reached[first], seen[first] = 0.0, 2 * number + 1
    free, used = push(heads, entries, np.int64(0), first, 0, 0, NOTHING, 0)
    fine_at, block, waiting = np.int64(0), np.int64(0), 1
    room = np.int64(len(entries)) // 2 - 8
    bound, last_bucket, expanded = _INF, np.int64(SPAN), 0
    while True:
        node, fine_at, free = pop(heads, entries, fine_at, free)
        if block * FINE + fine_at > last_bucket:
            return expanded
        if node == NOTHING:
            if waiting == 0:
                return expanded
            block, chain = next_block(heads, block)
            fine_at = np.int64(0)
            if block == COARSE:  # what lies beyond all buckets: these begin anew there
                block, fine_at = np.int64(-1), np.int64(FINE)
                base += np.float32(SPAN) / inverse_width
                last_bucket = np.int64(min(max((bound - base) * inverse_width, np.float32(-1.0)), np.float32(SPAN)))
            _deal_out(chain, block, search, (base, inverse_width), found, lists)
            continue
        waiting -= 1
        if seen[np.uint64(node)] & 1 == 0:
            continue
        seen[np.uint64(node)] -= 1
        own = reached[np.uint64(node)]
        row, col = node // stride, node % stride
        expanded += 1
        if waiting > room:
            return np.int64(FULL)
        if expanded % _LOOK_EVERY == 0 and late(until):
            return np.int64(LATE)
        for k in range(8):
            there = np.uint64(node + ROW_STEP[k] * stride + COL_STEP[k])
            cost = own + prices[np.uint64(node), np.uint64(k)]
            if not cost < _INF or (seen[there] >> 1 == number and cost >= reached[there]):
                continue
            promise = cost + _left(row + ROW_STEP[k], col + COL_STEP[k], ends, stride, least, guide)
            if promise > bound:
                continue
            reached[there], seen[there] = cost, 2 * number + 1
            if np.int64(there) == last and cost * beyond < bound:
                bound = cost * beyond
                last_bucket = np.int64(min((bound - base) * inverse_width, np.float32(SPAN)))
            bucket = np.int64(min(max((promise - base) * inverse_width, np.float32(0.0)), np.float32(SPAN)))
            free, used = push(heads, entries, bucket, np.int64(there), block, fine_at, free, used)
            waiting += 1


@kernel
def mark_links(links, first, beyond, found, scratch, radius, marks, until):
    """Mark the quarters of blocks on ways from `first` that cost at most `beyond` times the least, and those around.

    False where it was late before they were found.

    Parameters
    ----------
    links : (prices, stride)
    found : (reached, seen, number)
        What `settle_links` left, that came from the other end.
    scratch : (cost, queue)
        (nodes,) float32; a power of two of int32, at least twice the nodes. Overwritten.
    radius : int
        Quarters around each block, as the king moves.
    marks : (bitmap, stamp)
        (2 R, 2 C) int32, and the number to write.
    until : float
        Reading of the clock, see `clock.late`.
    """
    prices, stride = links
    reached, seen, number = found
    cost, queue = scratch
    bitmap, mark = marks
    rows, cols = bitmap.shape
    limit = reached[first] * np.float32(beyond)
    mask = len(queue) - 1
    cost[:] = np.inf
    cost[first], queue[0] = 0.0, first
    head, tail = 0, 1
    while head != tail:
        node = np.int64(queue[head & mask])
        head += 1
        own = cost[node]
        if head % _LOOK_EVERY == 0 and late(until):
            return False
        for k in range(8):
            there = np.uint64(node + ROW_STEP[k] * stride + COL_STEP[k])
            if seen[there] >> 1 != number:
                continue
            through = own + prices[np.uint64(node), np.uint64(k)]
            if through >= cost[there] or through + reached[there] > limit:
                continue
            cost[there] = through
            queue[tail & mask] = np.int32(there)
            tail += 1
    for i in range(rows // 2):
        for j in range(cols // 2):
            if cost[(i + 1) * stride + j + 1] < _INF:
                for row in range(max(2 * i - radius, 0), min(2 * i + 2 + radius, rows)):
                    for col in range(max(2 * j - radius, 0), min(2 * j + 2 + radius, cols)):
                        bitmap[row, col] = mark
    return True


@kernel
def _was_reached(meta, stamp, shape, row, col):
    """Whether a search came to any cell of a block."""
    rows, cols = shape
    for i in range(FACTOR * row, min(FACTOR * row + FACTOR, rows)):
        for j in range(FACTOR * col, min(FACTOR * col + FACTOR, cols)):
            if meta[2 * ((i + 1) * (cols + 2) + j + 1) + 1] >> STAMP_SHIFT == stamp:
                return True
    return False


@kernel
def close_links(links, marks, reached, more, came):
    """Make links dearer between blocks of a region that a search came to and those that it did not.

    Parameters
    ----------
    links : (prices, stride)
        Changed.
    marks : (bitmap, stamp)
        The region, in quarters of blocks: (2 R, 2 C) int32, and the number within it.
    reached : (meta, stamp, shape)
        What the search left, see `search.workspace`; its number; the map's rows and columns.
    more : float
        What is added.
    came : (nodes,) int8
        Scratch: 1 where a block of the region was missed, 2 where it was reached, else 0.
    """
    prices, stride = links
    bitmap, mark = marks
    meta, stamp, shape = reached
    rows, cols = bitmap.shape[0] // 2, bitmap.shape[1] // 2
    came[:] = 0
    for i in range(rows):
        for j in range(cols):
            quarters = np.int64(bitmap[2 * i, 2 * j] == mark) + np.int64(bitmap[2 * i, 2 * j + 1] == mark)
            quarters += np.int64(bitmap[2 * i + 1, 2 * j] == mark) + np.int64(bitmap[2 * i + 1, 2 * j + 1] == mark)
            if quarters and _was_reached(meta, stamp, shape, i, j):
                came[(i + 1) * stride + j + 1] = 2
            elif quarters == 4:  # into the rest of another there may be a way
                came[(i + 1) * stride + j + 1] = 1
    for i in range(rows):
        for node in range((i + 1) * stride + 1, (i + 1) * stride + 1 + cols):
            if came[node] == 2:
                for k in range(8):
                    there = node + ROW_STEP[k] * stride + COL_STEP[k]
                    if came[there] == 1:
                        prices[node, k] += np.float32(more)
                        prices[there, OPPOSITE[k]] += np.float32(more)
