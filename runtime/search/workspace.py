"""Scratch memory of the searches, allocated once for a map's size and never cleared.

A node's g and its `meta` word stand side by side, in one cache line. The meta word holds the number
of the search that wrote it: what an earlier search left reads as unvisited, and to start one costs
nothing that grows with the map.
"""

import sys
from functools import cached_property

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Float32s, Int32, Int64
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.kernels.nodes import STAMP_SHIFT, next_stamp
from nnpp_edge.runtime.kernels.open_list import BUCKETS, FINE
from nnpp_edge.runtime.kernels.records import (
    BASE,
    BLOCK,
    CONTROL_SLOTS,
    FINE_AT,
    INVERSE_WIDTH,
    REAL_SLOTS,
    Packed,
)
from nnpp_edge.runtime.memory import virtual_zeros

MOST_KEPT = 1 << 23
"""Numbers in the memory that a workspace leaves to the next one; more (32 MiB) is not kept."""
_AT_ONCE = 1 << 18
"""Words that are looked at between two readings of the clock."""
_KEPT: dict[int, Int32] = {}
"""The memory of the newest workspace of each size: of four sizes at most."""
_IN_USE = 3
"""References to memory from which on a workspace holds it: the name and the counting itself make
two.
"""


def _memory(size: int) -> Int32:
    """Memory of this size for a workspace.

    Memory that was used is as good as new. New memory takes longer: it is cleared first, or given
    by the system page by page.
    """
    kept = _KEPT.pop(size, None)  # from now on no other thread finds it
    if kept is None or sys.getrefcount(kept) >= _IN_USE:
        kept = np.zeros(size, np.int32)
    if size <= MOST_KEPT:
        _KEPT[size] = kept
        while len(_KEPT) > 4:
            _KEPT.pop(next(iter(_KEPT), 0), None)
    return kept


class Workspace:
    """g, parents and open list of one grid, of each node or of so many states of it. Serves one
    search at a time.
    """

    def __init__(self, nodes: int, states: int = 1, *, sparse: bool = False) -> None:
        self.field = Workspace(nodes) if states > 1 else None
        """Memory of a search of the nodes that goes before one of their states."""
        self.states = states
        self._nodes = nodes
        nodes = nodes * states
        size = 2 * nodes
        state = virtual_zeros(size, np.int32) if sparse else _memory(size)
        self.g: Float32s = state.view(np.float32)
        """g of node n at 2n."""
        self.meta: Int32 = state
        """stamp, open bit and direction of node n at 2n + 1."""
        self.heads = np.empty(BUCKETS, np.int32)
        self.control = np.zeros(CONTROL_SLOTS, np.int64)
        self.entries = np.empty(2 * min(max(nodes // 2, 1024), 1 << 16), np.int32)
        self.reals = np.zeros(REAL_SLOTS)
        self.path = np.empty((min(nodes, 4096), 2 if states == 1 else 3), np.int32)

    @property
    def stamp(self) -> int:
        """Number of the newest search, kept where the g of the border's first node would be, which
        no search comes to.
        """
        return int(self.meta[0])

    @property
    def packed(self) -> Packed:
        """All of it, for the newest search, as kernels take it."""
        return (  # `records.Memory`
            self.g,
            self.meta,
            self.stamp,
            self.heads,
            self.entries,
            self.control,
            self.reals,
            self.path,
        )

    def costs(self, nodes: Int64 | slice = slice(None)) -> Float32s:
        """(N,) least g of nodes, by default of all, in the newest search; inf where it did not
        come.
        """
        meta = self.meta.reshape(-1, self.states, 2)[nodes]
        g = self.g.reshape(-1, self.states, 2)[nodes]
        found: Float32s = np.where(
            meta[..., 1] >> STAMP_SHIFT == self.stamp, g[..., 0], np.inf
        ).min(1)
        return found

    def came_to(self, node: int, direction: int) -> bool:
        """Whether the newest search came to a node: to all of its states, or to that of a body that
        heads in this direction.
        """
        words = self.meta[1::2].reshape(-1, self.states)[node]
        came = words >> STAMP_SHIFT == self.stamp
        return bool(came[direction] if direction >= 0 and self.states > 1 else came.all())

    def reached(
        self, rows: int, deadline: Deadline, part: tuple[slice, slice] = np.s_[:, :]
    ) -> Bool:
        """(h, w) cells of a part of a map of so many rows, by default all of it, to which the
        newest search came, in any state. It pauses as searches do.
        """
        padded = self.meta[1::2].reshape(rows + 2, -1, self.states)
        words = padded[1:-1, 1:-1][part]
        found = np.empty(words.shape[:2], np.bool_)
        step = max(_AT_ONCE // words[0].size, 1)
        for first in range(0, len(words), step):
            stripe = slice(first, first + step)
            found[stripe] = words[stripe].max(2) >> STAMP_SHIFT == self.stamp
            deadline.goes_on()
        return found

    def next_stamp(self) -> int:
        """Number of a new search; all nodes read as unvisited to it."""
        return int(next_stamp(self.meta))

    @cached_property
    def from_goal(self) -> "Workspace":
        """Memory of a search from the other end, which stays small: the system backs what it
        writes to, by small pages, which are there at once.
        """
        return Workspace(self._nodes, self.states, sparse=True)

    @property
    def least_open(self) -> float:
        """No f on the open list is less, nor will be: the bucket that is being emptied begins
        there.
        """
        bucket = int(self.control[BLOCK]) * FINE + int(self.control[FINE_AT])
        return max(float(self.reals[BASE] + bucket / self.reals[INVERSE_WIDTH]), 0.0)

    def grow(self) -> None:
        """Make room for twice as many entries on the open list, keeping those that are there."""
        grown = np.empty(2 * len(self.entries), np.int32)
        grown[: len(self.entries)] = self.entries
        self.entries = grown
