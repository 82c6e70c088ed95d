"""Scratch memory of the searches, allocated once for a map's size and never cleared.

A node's g and its `meta` word stand side by side, in one cache line. The meta word holds the number of the
search that wrote it, so what an earlier search left reads as unvisited, and starting a search costs
nothing that grows with the map.
"""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.kernels.open_list import BUCKETS, CONTROL_SLOTS

STAMP_SHIFT = 5
OPEN_BIT = 16
ORIGIN = 8
"""Direction 0-7 leads from the parent to the node; this one marks the start."""
_LAST_STAMP = (1 << (31 - STAMP_SHIFT)) - 1


class Workspace:
    """g, parents and open list of one grid. Serves one search at a time."""

    def __init__(self, nodes: int) -> None:
        state = np.zeros(2 * nodes, np.int32)
        self.g: NDArray[np.float32] = state.view(np.float32)
        """g of node n at 2n."""
        self.meta: NDArray[np.int32] = state
        """stamp, open bit and direction of node n at 2n + 1."""
        self.heads = np.empty(BUCKETS, np.int32)
        self.control = np.zeros(CONTROL_SLOTS, np.int64)
        self.entries = np.empty(0, np.int32)
        self.grow(min(max(nodes // 2, 1024), 1 << 16))
        self.reals, self.counts = np.zeros(3), np.zeros(2, np.int64)
        self.path = np.empty((min(nodes, 4096), 2), np.int32)
        self.stamp = 0

    def next_stamp(self) -> int:
        """Number of a new search; all nodes read as unvisited to it."""
        if self.stamp == _LAST_STAMP:
            self.meta[1::2] = 0
            self.stamp = 0
        self.stamp += 1
        return self.stamp

    def grow(self, entries: int | None = None) -> None:
        """Make room for more entries on the open list, keeping those that are there."""
        grown = np.empty(2 * entries if entries else 2 * len(self.entries), np.int32)
        grown[: len(self.entries)] = self.entries
        self.entries = grown
