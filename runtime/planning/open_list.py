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

# slots of the int64 control array
FREE, USED, FINE_AT, COARSE_AT, LENGTH = 0, 1, 2, 3, 4
CONTROL_SLOTS = 5


@kernel
def clear(fine, coarse, control):
    """Empty the list."""
    fine[:] = NOTHING
    coarse[:] = NOTHING
    control[FREE] = NOTHING
    control[USED] = 0
    control[FINE_AT] = 0
    control[COARSE_AT] = 0
    control[LENGTH] = 0


@kernel
def push(fine, coarse, entry_node, entry_next, control, bucket, node):
    """Put `node` into bucket ⌊(f - f_start)/δ⌋; False if the entries' arrays are full."""
    entry = control[FREE]
    if entry != NOTHING:
        control[FREE] = entry_next[entry]
    else:
        entry = control[USED]
        if entry == len(entry_node):
            return False
        control[USED] = entry + 1
    entry_node[entry] = node
    block = bucket // FINE
    if block <= control[COARSE_AT]:
        # a rounding error may put f a hair below the bucket being emptied: it then goes into that one
        slot = max(bucket - control[COARSE_AT] * FINE, control[FINE_AT])
        entry_next[entry] = fine[slot]
        fine[slot] = entry
    else:
        slot = block % COARSE
        entry_next[entry] = coarse[slot]
        coarse[slot] = entry
    control[LENGTH] += 1
    return True


@kernel
def pop(fine, entry_node, entry_next, control):
    """Take the newest node of the first bucket, or NOTHING when the fine buckets are empty."""
    slot = control[FINE_AT]
    while slot < FINE and fine[slot] == NOTHING:
        slot += 1
    control[FINE_AT] = slot
    if slot == FINE:
        return np.int64(NOTHING)
    entry = fine[slot]
    fine[slot] = entry_next[entry]
    entry_next[entry] = control[FREE]
    control[FREE] = entry
    control[LENGTH] -= 1
    return np.int64(entry_node[entry])


@kernel
def next_block(coarse, control):
    """Go to the next coarse bucket that holds something; its chain of entries, or NOTHING."""
    if control[LENGTH] == 0:
        return np.int64(NOTHING)
    block = control[COARSE_AT] + 1
    while coarse[block % COARSE] == NOTHING:
        block += 1
    control[COARSE_AT] = block
    control[FINE_AT] = 0
    chain = coarse[block % COARSE]
    coarse[block % COARSE] = NOTHING
    return np.int64(chain)
