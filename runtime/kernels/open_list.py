"""The open list: a two-level bucket queue on f, in arrays.

A bucket holds the entries whose f falls into one span of width δ, newest first. The `FINE` buckets
cover one coarse bucket; entries further ahead wait in the coarse buckets and are dealt out when
their turn comes. Putting in and taking out cost the same however long the list is. What lies beyond
the last coarse bucket waits in one chain; when all else is empty, the buckets begin anew at the
least f in it.

Entries inside a bucket are not sorted, so a search that takes them in this order may expand a node
before its g is final and again when it improves. The answer stays exact: the goal is settled only
once every bucket below its g is empty (see `astar`). δ is a quarter of the cheapest step, so this
is rare. Where the buckets begin anew, it is at least f / `SPAN`: finer buckets would tell apart
what g, a float32, cannot. So they cover at least as much again as f has come to, and begin anew a
few times at most, whatever the weights.
"""

from numpy import float32, inf, int64, uint64

from nnpp_edge.runtime.compiled.kernel import inlined
from nnpp_edge.runtime.kernels.nodes import OPEN_BIT, STAMP_SHIFT, g_of, word_of
from nnpp_edge.runtime.kernels.records import (
    BASE,
    BLOCK,
    EXPANSIONS,
    FINE_AT,
    FREE,
    INVERSE_WIDTH,
    LENGTH,
    REFUSED,
    USED,
    Frontier,
    Queue,
)

FINE = 1024
COARSE = 4096
SPAN = FINE * COARSE
"""Number of a bucket that stands for all beyond the last."""
BUCKETS = FINE + COARSE + 1
"""Heads of the buckets' chains: the fine ones, the coarse ones, and what lies beyond."""
NOTHING = -1


@inlined
def empty(memory, base, width):
    """Empty the list. Its first bucket begins at `base`, and is so wide."""
    memory.heads[:] = NOTHING
    zero = int64(0)
    return Queue(int64(NOTHING), zero, zero, zero, zero, base, 1.0 / width)


@inlined
def known(memory, node):
    """g of a node so far, inf where no search has come."""
    visited = word_of(memory.meta, node) >> STAMP_SHIFT == memory.stamp
    return g_of(memory.g, node) if visited else float32(inf)


@inlined
def resumed(memory, bound):
    """How far a search had come when a call stopped; it leaves out what has an f of this bound or
    more.
    """
    control = memory.control
    reals = memory.reals
    queue = Queue(
        control[FREE],
        control[USED],
        control[FINE_AT],
        control[BLOCK],
        control[LENGTH],
        reals[BASE],
        reals[INVERSE_WIDTH],
    )
    return Frontier(queue, bound, last_bucket_below(bound, queue), memory.reals[REFUSED])


@inlined
def suspend(memory, queue, refused, expansions):
    """Keep for the next call where the list stands, the least f that the region refused, and the
    expansions so far.
    """
    memory.reals[REFUSED] = refused
    memory.control[EXPANSIONS] = expansions
    control = memory.control
    control[FREE] = queue.free
    control[USED] = queue.used
    control[FINE_AT] = queue.fine_at
    control[BLOCK] = queue.block
    control[LENGTH] = queue.length
    memory.reals[BASE] = queue.base
    memory.reals[INVERSE_WIDTH] = queue.inverse_width


@inlined
def bucket_of(f, queue):
    """Number of the bucket that an f belongs to, `SPAN` for what lies beyond the last."""
    return int64(min(max((f - queue.base) * queue.inverse_width, 0.0), float(SPAN)))


@inlined
def last_bucket_below(bound, queue):
    """Number of the last bucket that holds an f below a bound; -1 where none does."""
    return int64(min(max((bound - queue.base) * queue.inverse_width, -1.0), float(SPAN)))


@inlined
def push(memory, queue, bucket, node):
    """Put a node into a bucket, see `bucket_of`. There must be room."""
    recycled = queue.free != NOTHING
    entry = queue.free if recycled else queue.used
    following = int64(memory.entries[uint64(2 * entry + 1)])
    ahead = bucket - queue.block * FINE
    # a rounding error may put f a hair below the bucket being emptied: it then goes into that one
    slot = max(ahead, queue.fine_at) if ahead < FINE else FINE + bucket // FINE
    memory.entries[uint64(2 * entry)] = node
    memory.entries[uint64(2 * entry + 1)] = memory.heads[uint64(slot)]
    memory.heads[uint64(slot)] = entry
    free = following if recycled else queue.free
    used = queue.used if recycled else queue.used + 1
    length = queue.length + 1
    return Queue(free, used, queue.fine_at, queue.block, length, queue.base, queue.inverse_width)


@inlined
def wait(memory, front, f, node):
    """Have a node of this f wait on the list."""
    queue = push(memory, front.queue, bucket_of(f, front.queue), node)
    return Frontier(queue, front.bound, front.last_bucket, front.refused)


@inlined
def refuse(front, f):
    """Note that the region refused a node of this f."""
    return Frontier(front.queue, front.bound, front.last_bucket, min(front.refused, f))


@inlined
def stop_at(front, bound):
    """Leave out what has an f of this bound or more."""
    last_bucket = last_bucket_below(bound, front.queue)
    return Frontier(front.queue, bound, last_bucket, front.refused)


@inlined
def pop(memory, queue):
    """Take the newest open node of the first fine bucket that has any; NOTHING where none has."""
    fine_at = queue.fine_at
    free = queue.free
    length = queue.length
    node = int64(NOTHING)
    while fine_at < FINE:
        entry = int64(memory.heads[uint64(fine_at)])
        if entry == NOTHING:
            fine_at += 1
            continue
        memory.heads[uint64(fine_at)] = memory.entries[uint64(2 * entry + 1)]
        memory.entries[uint64(2 * entry + 1)] = free
        free = entry
        length -= 1
        node = int64(memory.entries[uint64(2 * entry)])
        if word_of(memory.meta, node) & OPEN_BIT:
            break
        node = int64(NOTHING)
    return node, Queue(
        free, queue.used, fine_at, queue.block, length, queue.base, queue.inverse_width
    )


def taking_by(left):
    """A helper that takes the next open node, of which `left(node, judge)` is left: handed to a
    kernel, that is compiled anew in each process.
    """

    @inlined
    def refill(memory, queue, judge):
        """Deal the next coarse bucket's entries out into the fine buckets, dropping those that are
        no longer open. The buckets begin anew where only what lies beyond the last is left.
        """
        heads = memory.heads
        entries = memory.entries
        base = queue.base
        inverse_width = queue.inverse_width
        free = queue.free
        length = queue.length
        block = queue.block + 1
        while heads[FINE + block] == NOTHING:
            block += 1
        chain = int64(heads[FINE + block])
        fine_at = int64(0)
        heads[FINE + block] = NOTHING
        if block == COARSE:  # what lies beyond
            block = int64(-1)
            fine_at = int64(FINE)
            least = inf
            entry = chain
            while entry != NOTHING:
                node = int64(entries[2 * entry])
                if word_of(memory.meta, node) & OPEN_BIT:
                    least = min(least, g_of(memory.g, node) + left(node, judge))
                entry = int64(entries[2 * entry + 1])
            if least < inf:
                base = least
                inverse_width = min(inverse_width, SPAN / least)
        moved = Queue(free, queue.used, fine_at, block, length, base, inverse_width)
        while chain != NOTHING:
            following = int64(entries[2 * chain + 1])
            node = int64(entries[2 * chain])
            if word_of(memory.meta, node) & OPEN_BIT:
                bucket = bucket_of(g_of(memory.g, node) + left(node, judge), moved)
                slot = FINE + bucket // FINE  # g may have risen meanwhile
                if block >= 0:
                    ahead = max(bucket - block * FINE, int64(0))
                    slot = ahead if ahead < FINE else slot
                entries[2 * chain + 1] = heads[slot]
                heads[slot] = chain
            else:
                entries[2 * chain + 1] = free
                free = chain
                length -= 1
            chain = following
        return Queue(free, queue.used, fine_at, block, length, base, inverse_width)

    @inlined
    def take(memory, judge, front):
        """Take the next open node off the list: NOTHING where all buckets with an f below the bound
        are empty.
        """
        last_bucket = front.last_bucket
        node, queue = pop(memory, front.queue)
        while node == NOTHING and queue.length > 0 and queue.block * FINE + FINE <= last_bucket:
            queue = refill(memory, queue, judge)
            last_bucket = last_bucket_below(front.bound, queue)
            node, queue = pop(memory, queue)
        if queue.block * FINE + queue.fine_at > last_bucket:
            node = int64(NOTHING)
        return node, Frontier(queue, front.bound, last_bucket, front.refused)

    return take
