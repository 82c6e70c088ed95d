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

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper
from nnpp_edge.runtime.kernels.nodes import OPEN_BIT

FINE = 1024
COARSE = 4096
SPAN = FINE * COARSE
"""Number of a bucket that stands for all beyond the last."""
BUCKETS = FINE + COARSE + 1
"""Heads of the buckets' chains: the fine ones, the coarse ones, and what lies beyond."""
NOTHING = -1

# Slots of the int64 array that keeps a list between calls; the kernels hold them in local
# variables, which is a third faster than reading and writing memory at every push.
FREE = 0
USED = 1
FINE_AT = 2
BLOCK = 3
LENGTH = 4
CONTROL_SLOTS = 5

# An entry e holds its node at 2e and the next entry of its chain at 2e + 1. The kernels below touch
# their arrays in straight lines only: numba counts references to an array that is used on both
# sides of a branch in a called kernel, and these atomic operations once took a third of a search's
# time.


@helper
def clear(heads, control):
    """Empty the list."""
    heads[:] = NOTHING
    control[:] = 0
    control[FREE] = NOTHING


@helper
def push(heads, entries, bucket, node, block, fine_at, free, used):
    """Put `node` into bucket ⌊(f - base)/δ⌋, at most `SPAN`; the new `free` and `used`. There must
    be room.
    """
    recycled = free != NOTHING
    entry = free if recycled else used
    following = np.int64(entries[np.uint64(2 * entry + 1)])
    ahead = bucket - block * FINE
    # a rounding error may put f a hair below the bucket being emptied: it then goes into that one
    slot = max(ahead, fine_at) if ahead < FINE else FINE + bucket // FINE
    entries[np.uint64(2 * entry)] = node
    entries[np.uint64(2 * entry + 1)] = heads[np.uint64(slot)]
    heads[np.uint64(slot)] = entry
    return (following, used) if recycled else (free, used + 1)


@helper
def pop(heads, entries, fine_at, free):
    """Take the newest node of the first bucket; node (NOTHING if the fine buckets are empty),
    fine_at, free.
    """
    while fine_at < FINE and heads[np.uint64(fine_at)] == NOTHING:
        fine_at += 1
    if fine_at == FINE:
        return np.int64(NOTHING), fine_at, free
    entry = np.int64(heads[np.uint64(fine_at)])
    heads[np.uint64(fine_at)] = entries[np.uint64(2 * entry + 1)]
    entries[np.uint64(2 * entry + 1)] = free
    return np.int64(entries[np.uint64(2 * entry)]), fine_at, entry


@helper
def bucket_of(f, base, inverse_width):
    """Number of the bucket that an f belongs to."""
    return np.int64(min(max((f - base) * inverse_width, 0.0), float(SPAN)))


@helper
def last_bucket_below(bound, base, inverse_width):
    """Number of the last bucket that holds an f below a bound; -1 where none does."""
    return np.int64(min(max((bound - base) * inverse_width, -1.0), float(SPAN)))


def refill_by(left):
    """A helper that refills by `left(node, judge)`: handed to a kernel, that is compiled anew in
    each process.
    """

    @helper
    def refill(judge, bound, block, order, g, meta, heads, entries, free, waiting):
        """Deal the next coarse bucket's entries out into the fine buckets, dropping those that are
        no longer open.

        `order` is (base, inverse_width) of the buckets, which begin anew where only what lies
        beyond the last is left. Returns the new block, fine_at, order, free and waiting, and the
        last bucket with an f below the bound.
        """
        base, inverse_width = order
        block += 1
        while heads[FINE + block] == NOTHING:
            block += 1
        chain = np.int64(heads[FINE + block])
        fine_at = np.int64(0)
        heads[FINE + block] = NOTHING
        if block == COARSE:  # what lies beyond
            block = np.int64(-1)
            fine_at = np.int64(FINE)
            least = np.inf
            entry = chain
            while entry != NOTHING:
                node = np.int64(entries[2 * entry])
                if meta[2 * node + 1] & OPEN_BIT:
                    least = min(least, g[2 * node] + left(node, judge))
                entry = np.int64(entries[2 * entry + 1])
            if least < np.inf:
                base = least
                inverse_width = min(inverse_width, SPAN / least)
        while chain != NOTHING:
            following = np.int64(entries[2 * chain + 1])
            node = np.int64(entries[2 * chain])
            if meta[2 * node + 1] & OPEN_BIT:
                bucket = bucket_of(g[2 * node] + left(node, judge), base, inverse_width)
                ahead = max(bucket - block * FINE, np.int64(0)) if block >= 0 else np.int64(FINE)
                slot = (
                    ahead if ahead < FINE else FINE + bucket // FINE
                )  # g may have risen meanwhile
                entries[2 * chain + 1] = heads[slot]
                heads[slot] = chain
            else:
                entries[2 * chain + 1] = free
                free = chain
                waiting -= 1
            chain = following
        return (
            block,
            fine_at,
            (base, inverse_width),
            free,
            waiting,
            last_bucket_below(bound, base, inverse_width),
        )

    return refill
