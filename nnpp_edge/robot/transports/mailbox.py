"""Between a transport's thread and the loop: inputs that wait, and inputs that were refused."""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator

from nnpp_edge.robot.transports.wire import Fault
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, Pose

_LOG = logging.getLogger(__name__)
_MOST_PATCHES = 256
_MOST_CELLS = 1 << 24
_MOST_FAULTS = 64
_LOGGED = 5
"""Refusals that are logged; further ones are only counted."""


class Mailbox:
    """Inputs that wait for the loop. Of poses and goals the newest is kept; patches keep their order.

    Parameters
    ----------
    most_patches, most_cells : int
        Most that may wait; a single patch may have any size.
    """

    def __init__(self, most_patches: int = _MOST_PATCHES, most_cells: int = _MOST_CELLS) -> None:
        self._most_patches, self._most_cells = most_patches, most_cells
        self._changed = threading.Condition()
        self._newest: dict[type, Pose | Goal] = {}
        self._patches: deque[MapPatch] = deque()
        self._cells = 0
        self._closed = False
        self.drops = 0
        """Patches that were dropped to make room for later ones."""

    def put(self, message: Input, *, wait: bool) -> int:
        """Add a message; if there is no room, wait, or drop the oldest patches. The number of patches dropped."""
        with self._changed:
            if not isinstance(message, MapPatch):
                self._newest[type(message)] = message
                return 0
            cells, dropped = message.shape[0] * message.shape[1], 0
            while self._patches and (
                len(self._patches) >= self._most_patches or self._cells + cells > self._most_cells
            ):
                if wait:
                    self._changed.wait()
                else:
                    self._oldest()
                    dropped += 1
            self._patches.append(message)
            self._cells += cells
            self.drops += dropped
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


class FaultQueue:
    """Faults that wait to be sent with the next answer. Of many the newest 64 are kept. For any thread."""

    def __init__(self) -> None:
        self._faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)

    def answer(self, fault: Fault) -> None:
        """Send a fault with the next answer; does not wait."""
        self._faults.append(fault)

    def waiting_faults(self) -> Iterator[Fault]:
        """The waiting faults, oldest first, each taken out."""
        while self._faults:
            yield self._faults.popleft()


class Refusals:
    """Counts refused inputs, answers each, and logs the first few. For any thread.

    Parameters
    ----------
    count_error : callable
        `Navigator.count_error`; called with ``input`` for each.
    answer : callable
        Sends the fault to the sender of the input; None if there is no way back.
    """

    def __init__(self, count_error: Callable[[str], None], answer: Callable[[Fault], None] | None = None) -> None:
        self._count_error, self._answer = count_error, answer
        self._lock = threading.Lock()
        self.count = 0

    def add(self, error: Exception) -> None:
        """Count a refused input, and answer it."""
        with self._lock:
            self.count += 1
            fault = Fault(str(error), self.count)
            if self._answer is not None:
                self._answer(fault)
        self._count_error("input")
        if fault.count <= _LOGGED:
            more = "" if fault.count < _LOGGED else " (further ones are only counted)"
            _LOG.warning("an input was refused: %s%s", error, more)
