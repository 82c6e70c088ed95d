"""The log of a map's changes: each is written down once, numbered, and every reader keeps its own place.

Readers come when they have time: a change costs its writer the same however many parts of a planner must notice it,
and a reader that is not needed any more costs nothing. What all readers have read is dropped. Where many changes
wait for a slow reader, neighbouring ones are merged: a merged change covers what it is made of, so that a reader
looks at more than it need, never at less.
"""

from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Rectangle, enclosing
from nnpp_edge.runtime.tuning import MOST_LOGGED_CHANGES

MANY_NODES = 1 << 16
"""From here on the nodes of merged changes are kept once each, and old weights that have been read are dropped."""
_NO_NODES, _NO_WEIGHTS = np.empty(0, np.int32), np.empty(0, np.float32)


class Change(NamedTuple):
    """The cells that one update of a map changed, or several in a row."""

    part: Rectangle
    """The least rectangle that holds every changed cell."""
    cells: int
    """Number of changed cells; a cell that changed twice counts twice."""
    cheaper: bool = False
    """Whether a cell weighs less than before."""
    rescaled: bool = False
    """Whether all that is relative to the map's least and greatest weight is out of date (``length`` model)."""
    nodes: NDArray[np.int32] = _NO_NODES
    """(N,) the changed cells, where a reader keeps old weights; else empty."""
    old_weights: NDArray[np.float32] = _NO_WEIGHTS
    """(N,) what they weighed before. Where a node stands twice, the first is the older weight."""


class ChangeLog:
    """Numbered changes, and the readers that have not seen all of them. Serves one thread at a time.

    Where more than `most` changes wait, neighbouring ones are merged.
    """

    def __init__(self, most: int = MOST_LOGGED_CHANGES) -> None:
        self.version = 0
        """Number of the newest change; 0 before the first."""
        self.merged = 0
        """Changes that were merged into another because too many were waiting."""
        self._most = most
        self._changes: list[Change] = []
        self._numbers: list[int] = []
        """Number of each kept change, of a merged one that of the newest in it."""
        self._kept_nodes = 0
        """Nodes of the kept changes, or more."""
        self._readers: WeakSet[ChangeReader] = WeakSet()

    @property
    def keeps_old_weights(self) -> bool:
        """Whether a reader wants to know what changed cells weighed before."""
        return any(reader.keeps_old_weights for reader in self._readers)

    def append(self, change: Change) -> int:
        """Write a change down; its number."""
        self.version += 1
        self._changes.append(change)
        self._numbers.append(self.version)
        self._kept_nodes += len(change.nodes)
        if self._kept_nodes > MANY_NODES:
            self._drop_old_weights()
        if len(self._changes) > self._most:
            self._shorten()
        return self.version

    def reader(self, *, keeps_old_weights: bool = False) -> "ChangeReader":
        """A new reader, to whom all changes so far are known."""
        reader = ChangeReader(self, keeps_old_weights)
        self._readers.add(reader)
        return reader

    def since(self, number: int) -> list[Change]:
        """The changes after that number, which must be a reader's place, oldest first."""
        return self._changes[bisect_right(self._numbers, number) :]

    def _drop_old_weights(self) -> None:
        """Drop the old weights that every reader of old weights has read."""
        read = min((r.version for r in self._readers if r.keeps_old_weights), default=self.version)
        for at in range(bisect_right(self._numbers, read)):
            self._changes[at] = self._changes[at]._replace(nodes=_NO_NODES, old_weights=_NO_WEIGHTS)
        self._kept_nodes = sum(len(change.nodes) for change in self._changes)

    def _shorten(self) -> None:
        """Drop what everybody has read, and merge neighbours until half of the room is free."""
        places = {reader.version for reader in self._readers}
        unread = bisect_right(self._numbers, min(places, default=self.version))
        del self._changes[:unread], self._numbers[:unread]
        merging = len(self._changes) > self._most
        while merging and len(self._changes) > self._most // 2:
            merging = False
            for at in range(len(self._changes) - 2, -1, -2):
                if self._numbers[at] not in places:  # a reader's place must stay between two changes
                    self._changes[at : at + 2] = [_merged(*self._changes[at : at + 2])]
                    del self._numbers[at]
                    self.merged += 1
                    merging = True


class ChangeReader:
    """One reader's place in the log. Made by `ChangeLog.reader`."""

    def __init__(self, log: ChangeLog, keeps_old_weights: bool) -> None:
        self._log = log
        self.keeps_old_weights = keeps_old_weights
        self.version = log.version
        """Number of the last change that was read."""

    @property
    def behind(self) -> int:
        """Number of changes, as they were written, that are still to be read."""
        return self._log.version - self.version

    def read(self) -> Sequence[Change]:
        """The changes since the last call, oldest first."""
        if self.version == self._log.version:
            return ()
        changes = self._log.since(self.version)
        self.version = self._log.version
        return changes

    def peek(self) -> Sequence[Change]:
        """The changes since the last `read` or `skip`, oldest first, without counting them as read."""
        return () if self.version == self._log.version else self._log.since(self.version)

    def skip(self) -> None:
        """Count everything so far as read."""
        self.version = self._log.version


def _merged(older: Change, newer: Change) -> Change:
    """Two neighbouring changes as one."""
    nodes = np.concatenate((older.nodes, newer.nodes))
    old_weights = np.concatenate((older.old_weights, newer.old_weights))
    if len(nodes) > MANY_NODES:
        nodes, first = np.unique(nodes, return_index=True)
        old_weights = old_weights[first]
    return Change(
        enclosing((older.part, newer.part)),
        older.cells + newer.cells,
        older.cheaper or newer.cheaper,
        older.rescaled or newer.rescaled,
        nodes,
        old_weights,
    )
