"""Searches of a map's blocks whose links have prices, and the region around what they find. See `region.links`.

A link leads from a block to the next along one of the four headings, and has one price both ways. It stands with the
block that it leaves forwards: `prices` is (4, R, C) float32, finite.
"""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP, STAMP_SHIFT
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.poses import HEADING

BACKWARDS = tuple(
    int((row, col) not in ((1, 0), (1, 1), (0, 1), (-1, 1))) for row, col in zip(ROW_STEP, COL_STEP, strict=True)
)
"""Whether each of the eight directions leads against its heading."""
FORWARDS = tuple(next(n for n in range(8) if HEADING[n] == k and not BACKWARDS[n]) for k in range(4))
"""The direction that leads along each heading."""
_DIAGONAL = np.float32(2.0**0.5 - 1.0)
_INF = np.float32(np.inf)
LOGIT_STEPS, LOGITS = 32, 1024
"""Of the tables of what a network's answers come to: steps to a logit of 1, and entries; from -16 up to below 16."""


@kernel
def price_links(answers, first, part, tables, lengths, prices):
    """Prices of links by a network's answers, of a rectangle of blocks.

    Parameters
    ----------
    answers : (16, ., .) float32
        Logits, see `model.passage`; those of block `first` come first.
    part : (row, col, rows, cols)
    tables : (dear, fine)
        (1024,) float32 each: by the logit of half a way's T, what a length of it costs; by that of the chance that
        there is a way, what is added.
    lengths : (4,) float32
        Of a straight way along each heading.
    prices : (4, R, C) float32
        Written.

    Returns
    -------
    float32
        The least price of a length.
    """
    row, col, rows, cols = part
    dear, fine = tables
    lowest = np.float32(LOGITS - 1)
    by, middle, last = np.float32(LOGIT_STEPS), np.float32(LOGITS // 2), np.float32(LOGITS - 1)
    for k in range(4):
        for i in range(row, row + rows):
            for j in range(col, col + cols):
                chance = min(max(by * answers[8 + k, i - first[0], j - first[1]] + middle, np.float32(0.0)), last)
                way = min(max(by * answers[12 + k, i - first[0], j - first[1]] + middle, np.float32(0.0)), last)
                lowest = min(lowest, way)
                prices[k, i, j] = lengths[k] * dear[np.int32(way)] + fine[np.int32(chance)]
    return dear[np.int32(lowest)]


@kernel
def _straight(node, other, cols, least):
    """The least that a way between two blocks costs, if no link costs less than `least` a length."""
    down, across = abs(node // cols - other // cols), abs(node % cols - other % cols)
    length = np.float32(max(down, across)) + _DIAGONAL * np.float32(min(down, across))
    return np.float32(FACTOR) * least * length


@kernel
def _left(node, ends, cols, least, guide):
    """The least that is left from a block to the last one."""
    first, last = ends
    costs, stamps, stamp, limit = guide
    straight = _straight(node, last, cols, least)
    if limit == np.float32(0.0):
        return straight
    back = _straight(node, first, cols, least)
    known = stamps[node] == stamp and costs[node] + back <= limit
    return max(costs[node] if known else limit - back, straight)


@kernel
def _push(keys, nodes, size, key, node):
    """Put a node on the heap."""
    i = size
    while i > 0 and key < keys[(i - 1) >> 1]:
        above = (i - 1) >> 1
        keys[i], nodes[i] = keys[above], nodes[above]
        i = above
    keys[i], nodes[i] = key, node
    return size + 1


@kernel
def _pop(keys, nodes, size):
    """Take the first node off the heap."""
    size -= 1
    key, node = keys[size], nodes[size]
    i = 0
    while 2 * i + 1 < size:
        below = 2 * i + 1
        if below + 1 < size and keys[below + 1] < keys[below]:
            below += 1
        if keys[below] >= key:
            break
        keys[i], nodes[i] = keys[below], nodes[below]
        i = below
    keys[i], nodes[i] = key, node
    return size


@kernel
def settle_links(prices, least, ends, beyond, found, guide, heap):
    """Costs from the first block to all that lie on ways to the last which cost at most `beyond` times the least.

    Parameters
    ----------
    least : float32
        No link costs less a length.
    ends : (first, last)
        Blocks, row by row.
    beyond : float
        At least 1.
    found : (reached, stamps, stamp)
        (R · C,) float32 costs and int32 numbers of the search that reached a block, both written; and this one's.
    guide : (reached, stamps, stamp, limit)
        What a search from the last block to the first left, when no link was dearer than now, and the cost up to
        which it searched; 0 for none.
    heap : (keys, nodes)
        Room for eight times the blocks.

    Returns
    -------
    int
        Blocks expanded.
    """
    rows, cols = prices.shape[1], prices.shape[2]
    reached, stamps, stamp = found
    keys, nodes = heap
    first, last = ends
    reached[first], stamps[first] = 0.0, stamp
    size = _push(keys, nodes, 0, _left(first, ends, cols, least, guide), first)
    bound, expanded = _INF, 0
    while size and keys[0] <= bound:
        key, node = keys[0], nodes[0]
        size = _pop(keys, nodes, size)
        row, col = node // cols, node % cols
        own = reached[node]
        if key > own + _left(node, ends, cols, least, guide):
            continue  # reached for less since
        expanded += 1
        for k in range(8):
            i, j = row + ROW_STEP[k], col + COL_STEP[k]
            if i < 0 or i >= rows or j < 0 or j >= cols:
                continue
            price = prices[HEADING[k], i, j] if BACKWARDS[k] else prices[HEADING[k], row, col]
            there, cost = i * cols + j, own + price
            if stamps[there] == stamp and cost >= reached[there]:
                continue
            promise = cost + _left(there, ends, cols, least, guide)
            if promise > bound:
                continue
            reached[there], stamps[there] = cost, stamp
            if there == last:
                bound = min(bound, cost * np.float32(beyond))
            size = _push(keys, nodes, size, promise, there)
    return expanded


@kernel
def mark_links(prices, first, beyond, found, scratch, radius, marks):
    """Mark the quarters of blocks on ways from `first` that cost at most `beyond` times the least, and those around.

    Parameters
    ----------
    found : (reached, stamps, stamp)
        What `settle_links` left, that came from the other end.
    scratch : (cost, queue)
        (R · C,) float32; a power of two of int32, at least twice R · C. Overwritten.
    radius : int
        Quarters around each block, as the king moves.
    marks : (bitmap, stamp)
        (2 R, 2 C) int32, and the number to write.
    """
    rows, cols = prices.shape[1], prices.shape[2]
    reached, stamps, stamp = found
    cost, queue = scratch
    bitmap, mark = marks
    limit = reached[first] * np.float32(beyond)
    mask = len(queue) - 1
    cost[:] = np.inf
    cost[first], queue[0] = 0.0, first
    head, tail = 0, 1
    while head != tail:
        node = np.int64(queue[head & mask])
        head += 1
        row, col = node // cols, node % cols
        for i in range(max(2 * row - radius, 0), min(2 * row + 2 + radius, 2 * rows)):
            for j in range(max(2 * col - radius, 0), min(2 * col + 2 + radius, 2 * cols)):
                bitmap[i, j] = mark
        for k in range(8):
            i, j = row + ROW_STEP[k], col + COL_STEP[k]
            if i < 0 or i >= rows or j < 0 or j >= cols:
                continue
            there = i * cols + j
            if stamps[there] != stamp:
                continue
            price = prices[HEADING[k], i, j] if BACKWARDS[k] else prices[HEADING[k], row, col]
            through = cost[node] + price
            if through >= cost[there] or through + reached[there] > limit:
                continue
            cost[there] = through
            queue[tail & mask] = there
            tail += 1


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
def close_links(prices, marks, reached, more, came):
    """Make links dearer between blocks of a region that a search came to and those that it did not.

    Parameters
    ----------
    prices : (4, R, C) float32
        Changed.
    marks : (bitmap, stamp)
        The region, in quarters of blocks: (2 R, 2 C) int32, and the number within it.
    reached : (meta, stamp, shape)
        What the search left, see `search.workspace`; its number; the map's rows and columns.
    more : float
        What is added.
    came : (R, C) int8
        Scratch: 1 where a block of the region was missed, 2 where it was reached, else 0.
    """
    bitmap, mark = marks
    meta, stamp, shape = reached
    rows, cols = came.shape
    for i in range(rows):
        for j in range(cols):
            came[i, j] = 0
            if (bitmap[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] == mark).any():
                came[i, j] = 2 if _was_reached(meta, stamp, shape, i, j) else 1
    for k in range(4):
        down, right = ROW_STEP[FORWARDS[k]], COL_STEP[FORWARDS[k]]
        for i in range(max(-down, 0), rows - max(down, 0)):
            for j in range(cols - right):
                if came[i, j] * came[i + down, j + right] == 2:
                    prices[k, i, j] += np.float32(more)
