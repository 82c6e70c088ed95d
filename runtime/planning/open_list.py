"""The open list: a two-level bucket queue on f, in arrays.

A bucket holds the entries whose f falls into one span of width δ, newest first. The `FINE` buckets cover
one coarse bucket; entries further ahead wait in the coarse buckets, a ring, and are dealt out when their
turn comes. Putting in and taking out cost the same however long the list is.

Entries inside a bucket are not sorted, so a search that takes them in this order may expand a node before
its g is final and again when it improves. The answer stays exact: the goal is settled only once every
bucket below its g is empty (see `astar`). δ is a quarter of the cheapest step, so this is rare.
"""

import numpy as np

from nnpp_edge.runtime._jit import kernel

FINE = 1024
COARSE = 4096
NOTHING = -1

# Slots of the int64 array that keeps a list between calls; the kernels hold them in local variables, which
# is a third faster than reading and writing memory at every push.
FREE, USED, FINE_AT, BLOCK, LENGTH = 0, 1, 2, 3, 4
CONTROL_SLOTS = 5


@kernel
def clear(fine, coarse, control):
    """Empty the list."""
    fine[:] = NOTHING
    coarse[:] = NOTHING
    control[:] = 0
    control[FREE] = NOTHING


@kernel
def push(fine, coarse, entry_node, entry_next, bucket, node, block, fine_at, free, used):
    """Put `node` into bucket ⌊(f - f_start)/δ⌋; the new `free` and `used`. There must be room."""
    entry = free
    if entry != NOTHING:
        free = np.int64(entry_next[entry])
    else:
        entry = used
        used += 1
    entry_node[entry] = node
    ahead = bucket - block * FINE
    if ahead < FINE:
        # a rounding error may put f a hair below the bucket being emptied: it then goes into that one
        slot = max(ahead, fine_at)
        entry_next[entry] = fine[slot]
        fine[slot] = entry
    else:
        slot = (bucket // FINE) % COARSE
        entry_next[entry] = coarse[slot]
        coarse[slot] = entry
    return free, used


@kernel
def pop(fine, entry_node, entry_next, fine_at, free):
    """Take the newest node of the first bucket; node (NOTHING if the fine buckets are empty), fine_at, free."""
    while fine_at < FINE and fine[fine_at] == NOTHING:
        fine_at += 1
    if fine_at == FINE:
        return np.int64(NOTHING), fine_at, free
    entry = np.int64(fine[fine_at])
    fine[fine_at] = entry_next[entry]
    entry_next[entry] = free
    return np.int64(entry_node[entry]), fine_at, entry


@kernel
def next_block(coarse, block):
    """The next coarse bucket that holds something, emptied: its number and its chain of entries."""
    block += 1
    while coarse[block % COARSE] == NOTHING:
        block += 1
    chain = np.int64(coarse[block % COARSE])
    coarse[block % COARSE] = NOTHING
    return block, chain
