"""Scratch memory of the searches, allocated once for a map's size and never cleared.

A node's g and its `meta` word stand side by side, in one cache line. The meta word holds the number of the
search that wrote it, so what an earlier search left reads as unvisited, and starting a search costs
nothing that grows with the map.
"""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.kernels.nodes import STAMP_SHIFT
from nnpp_edge.runtime.kernels.open_list import BUCKETS, CONTROL_SLOTS

LAST_STAMP = (1 << (31 - STAMP_SHIFT)) - 1
"""The greatest number of a search; the next one is 1 again, and the memory is cleared."""
LEAST_KEPT, MOST_KEPT = 1 << 16, 1 << 23
"""Numbers in the memory that a workspace leaves to the next: less is soon made, more (32 MiB) is not kept."""
Int32s = NDArray[np.int32]
PackedWorkspace = tuple[
    NDArray[np.float32],
    Int32s,
    int,
    Int32s,
    Int32s,
    NDArray[np.int64],
    NDArray[np.float64],
    NDArray[np.int64],
    Int32s,
]
"""A workspace as `expand` takes it: (g, meta, stamp, heads, entries, control, reals, counts, path)."""


_KEPT: dict[int, tuple[Int32s, int]] = {}
"""What the last workspaces left, by its size, and the number of the last search in it: at most four of them."""


def _taken(size: int) -> tuple[Int32s, int]:
    """So many numbers for a workspace, and that of the last search in them.

    To a search whatever an earlier one left reads as unvisited, so memory that was used is as good as new. New memory
    takes longer: it is cleared first, or given by the system page by page.
    """
    return _KEPT.pop(size, None) or (np.zeros(size, np.int32), 0)


class Workspace:
    """g, parents and open list of one grid. Serves one search at a time."""

    def __init__(self, nodes: int) -> None:
        state, stamp = _taken(2 * nodes)
        self.stamp = stamp
        """Number of the newest search."""
        self.g: NDArray[np.float32] = state.view(np.float32)
        """g of node n at 2n."""
        self.meta: Int32s = state
        """stamp, open bit and direction of node n at 2n + 1."""
        self.heads = np.empty(BUCKETS, np.int32)
        self.control = np.zeros(CONTROL_SLOTS, np.int64)
        self.entries = np.empty(2 * min(max(nodes // 2, 1024), 1 << 16), np.int32)
        self.reals, self.counts = np.zeros(4), np.zeros(2, np.int64)
        self.path = np.empty((min(nodes, 4096), 2), np.int32)

    def __del__(self) -> None:
        """Leave the memory to the next one of its size."""
        if "meta" in self.__dict__ and LEAST_KEPT <= self.meta.size <= MOST_KEPT and self.meta.flags.owndata:
            _KEPT[self.meta.size] = self.meta, self.stamp
            while len(_KEPT) > 4:
                _KEPT.pop(next(iter(_KEPT), 0), None)

    @property
    def packed(self) -> PackedWorkspace:
        """All of it, for the newest search."""
        state = self.g, self.meta, self.stamp
        return *state, self.heads, self.entries, self.control, self.reals, self.counts, self.path

    def next_stamp(self) -> int:
        """Number of a new search; all nodes read as unvisited to it."""
        if self.stamp == LAST_STAMP:
            self.meta[1::2] = 0
            self.stamp = 0
        self.stamp += 1
        return self.stamp

    def grow(self) -> None:
        """Make room for twice as many entries on the open list, keeping those that are there."""
        grown = np.empty(2 * len(self.entries), np.int32)
        grown[: len(self.entries)] = self.entries
        self.entries = grown
