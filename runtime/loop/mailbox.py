"""Inputs that wait for the loop."""

import threading
from collections import deque
from collections.abc import Iterator
from typing import Literal

from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, Pose

WhenFull = Literal["wait", "drop oldest", "refuse"]


class Mailbox:
    """Inputs that wait for the loop. Of poses and goals the newest is kept; patches keep their order. For any thread.

    Parameters
    ----------
    most_patches, most_cells : int
        Most that may wait; a single patch may have any size.
    """

    def __init__(self, most_patches: int = 256, most_cells: int = 1 << 24) -> None:
        self._most_patches, self._most_cells = most_patches, most_cells
        self._changed = threading.Condition()
        self._newest: dict[type, Pose | Goal] = {}
        self._patches: deque[MapPatch] = deque()
        self._cells = 0
        self._closed = False
        self.drops = 0
        """Patches that were dropped or refused for lack of room."""

    def put(self, message: Input, *, when_full: WhenFull) -> int:
        """Add a message. The number of patches dropped for it; 1 also where it was refused itself."""
        with self._changed:
            if not isinstance(message, MapPatch):
                self._newest[type(message)] = message
                return 0
            cells, dropped = message.shape[0] * message.shape[1], 0
            while self._patches and (
                len(self._patches) >= self._most_patches or self._cells + cells > self._most_cells
            ):
                if when_full == "wait":
                    self._changed.wait()
                    continue
                self.drops += 1
                if when_full == "refuse":
                    return 1
                self._oldest()
                dropped += 1
            self._patches.append(message)
            self._cells += cells
            return dropped

    def read(self) -> Iterator[Input]:
        """The waiting inputs, one by one; pose and goal first, so that patches cannot hold them up."""
        while True:
            with self._changed:
                if self._newest:
                    message: Input = self._newest.pop(next(iter(self._newest)))
                elif self._patches:
                    message = self._oldest()
                    self._changed.notify()
                else:
                    return
            yield message

    def close(self) -> None:
        """Say that nothing more will come."""
        with self._changed:
            self._closed = True

    @property
    def waiting(self) -> int:
        """Inputs that wait."""
        with self._changed:
            return len(self._patches) + len(self._newest)

    @property
    def closed(self) -> bool:
        """Whether nothing more will come."""
        return self._closed

    @property
    def ended(self) -> bool:
        """Whether nothing waits, and nothing more will come."""
        with self._changed:
            return self._closed and not self._patches and not self._newest

    def _oldest(self) -> MapPatch:
        patch = self._patches.popleft()
        self._cells -= patch.shape[0] * patch.shape[1]
        return patch
