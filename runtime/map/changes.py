"""The log of a map's changes, which every reader reads when it has time.

Where many changes wait for a slow reader, neighbouring ones are merged: a merged change covers what
it is made of, so that the reader looks at more than it need, never at less. A reader that is gone
costs nothing more.
"""

from collections.abc import Sequence
from typing import NamedTuple
from weakref import WeakSet

import numpy as np

from nnpp_edge.runtime.arrays import Float32s, Int32
from nnpp_edge.runtime.cells import Rectangle, enclosing
from nnpp_edge.runtime.tuning import MOST_LOGGED_CHANGES

MANY_NODES = 1 << 16
"""From here on the nodes of merged changes are kept once each."""
NO_NODES = np.empty(0, np.int32)
NO_WEIGHTS = np.empty(0, np.float32)


class Change(NamedTuple):
    """The cells that one update of a map changed, or several in a row."""

    part: Rectangle
    """The least rectangle that holds every changed cell."""
    cells: int
    """Number of changed cells; a cell that changed twice counts twice."""
    cheaper: bool = False
    """Whether a cell weighs less than before; steps by the slope may cost less all the same."""
    rescaled: bool = False
    """Whether all that is relative to the map's least and greatest weight is out of date
    (``length`` model).
    """
    nodes: Int32 = NO_NODES
    """(N,) the changed cells, for a reader that keeps old weights; else empty."""
    old_weights: Float32s = NO_WEIGHTS
    """(N,) what they weighed before. Where a node stands twice, the first is the older weight."""

    def then(self, newer: "Change") -> "Change":
        """This change and the next one as one."""
        nodes = np.append(self.nodes, newer.nodes)
        old_weights = np.append(self.old_weights, newer.old_weights)
        if len(nodes) > MANY_NODES:
            nodes, first = np.unique(nodes, return_index=True)
            old_weights = old_weights[first]
        cells = self.cells + newer.cells
        flags = (self.cheaper or newer.cheaper, self.rescaled or newer.rescaled)
        return Change(enclosing((self.part, newer.part)), cells, *flags, nodes, old_weights)


class ChangeReader:
    """Changes that a reader has not read yet, the oldest first; of more than `MOST_LOGGED_CHANGES`,
    neighbours are merged.
    """

    def __init__(self, keeps_old_weights: bool) -> None:
        self.keeps_old_weights = keeps_old_weights
        self._unread: list[Change] = []

    def skip(self) -> None:
        """Count everything so far as read."""
        self._unread = []

    def read(self) -> Sequence[Change]:
        """The changes since the last call."""
        changes = self._unread
        self._unread = []
        return changes

    def peek(self) -> Sequence[Change]:
        """The changes since the last `read` or `skip`, without counting them as read."""
        return self._unread

    def add(self, change: Change) -> None:
        """A change to be read; for `ChangeLog`."""
        unread = [*self._unread, change]
        if len(unread) > MOST_LOGGED_CHANGES:
            last = unread[-1:] if len(unread) % 2 else []
            pairs = zip(unread[::2], unread[1::2], strict=False)
            unread = [older.then(newer) for older, newer in pairs] + last
        self._unread = unread


class ChangeLog:
    """Tells readers of a map's changes. Serves one thread at a time."""

    def __init__(self) -> None:
        self.version = 0
        """Number of changes so far."""
        self._readers = WeakSet[ChangeReader]()

    @property
    def keeps_old_weights(self) -> bool:
        """Whether a reader wants to know what changed cells weighed before."""
        return any(reader.keeps_old_weights for reader in self._readers)

    def append(self, change: Change) -> None:
        """Write a change down."""
        self.version += 1
        bare = change._replace(nodes=NO_NODES, old_weights=NO_WEIGHTS)
        for reader in self._readers:
            reader.add(change if reader.keeps_old_weights else bare)

    def reader(self, *, keeps_old_weights: bool = False) -> ChangeReader:
        """A new reader, to whom all changes so far are known."""
        reader = ChangeReader(keeps_old_weights)
        self._readers.add(reader)
        return reader
