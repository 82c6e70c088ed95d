"""Work beside the loop: queues of bounded size, threads that empty them, and errors that end
nothing.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Generic, Literal, TypeVar

from nnpp_edge.runtime.errors import NnppEdgeError

T = TypeVar("T")
WhenFull = Literal["wait", "drop oldest", "refuse"]
CountError = Callable[[str], None]
"""Counts an error, by the place where it was caught."""
_LOG = logging.getLogger(__name__)
_CALM_S = 10.0
"""Seconds of work after which what has failed counts as working again."""
_LOOK_EVERY_S = 0.1


class Guard:
    """A ``with`` block for what may fail: an `Exception` is counted, as by `count_error(place)`,
    and goes no further.

    The first failure of a row is logged, with its traceback unless it is an error of the system or
    of this package; and later that it works again, once it has for 10 s.
    """

    def __init__(self, who: str, place: str, count_error: CountError) -> None:
        self._who = who
        self.place = place
        self._count_error = count_error
        self._times = 0
        self._last = 0.0

    def __enter__(self) -> None:
        """Begin what may fail."""

    def __exit__(
        self, kind: object, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        """Whether it failed by an `Exception`."""
        now = time.monotonic()
        if isinstance(error, Exception):
            if not self._times:
                known = isinstance(error, OSError | NnppEdgeError)
                _LOG.warning(
                    "%s failed (%s); more of the same is counted, not logged",
                    self._who,
                    " ".join(str(error).split()),
                    exc_info=None if known else error,
                )
            self._times += 1
            self._last = now
            self._count_error(self.place)
            return True
        if error is None and self._times and now - self._last >= _CALM_S:
            _LOG.warning("%s works again, after %d failures", self._who, self._times)
            self._times = 0
        return False


class BoundedQueue(Generic[T]):
    """Items that wait, of at most so much size in all; a single one may have any. For any thread.

    While `patient` says so, `put` with "wait" waits for room.
    """

    def __init__(
        self,
        most: int,
        size: Callable[[T], int] = lambda item: 1,
        patient: Callable[[], bool] = lambda: True,
    ) -> None:
        self._most = most
        self._size = size
        self.patient = patient
        self._items: deque[T] = deque()
        self._used = 0
        self._changed = threading.Condition()
        self.closed = False
        """Whether nothing more will come."""
        self.drops = 0
        """Items that were dropped or refused for lack of room."""

    def __len__(self) -> int:
        """Items that wait."""
        return len(self._items)

    def put(self, item: T, when_full: WhenFull) -> int:
        """Add an item. The number of items dropped for it; 1 also where it was refused itself."""
        size = self._size(item)
        dropped = 0
        with self._changed:
            while self._items and self._used + size > self._most:
                if when_full == "wait" and self.patient():
                    self._changed.wait(_LOOK_EVERY_S)
                    continue
                self.drops += 1
                dropped += 1
                if when_full == "refuse":
                    return dropped
                self._oldest()
            self._items.append(item)
            self._used += size
            self._changed.notify_all()
        return dropped

    def take(self, *, wait: bool = False) -> T | None:
        """The oldest item; None if none waits, with `wait` only once the queue is closed too."""
        with self._changed:
            if wait:
                self._changed.wait_for(lambda: self._items or self.closed)
            if not self._items:
                return None
            self._changed.notify_all()
            return self._oldest()

    def close(self) -> None:
        """Say that nothing more will come."""
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    def _oldest(self) -> T:
        item = self._items.popleft()
        self._used -= self._size(item)
        return item


class Worker(Generic[T]):
    """A thread that hands each item of a queue to `use`, in order, within a guard."""

    def __init__(self, use: Callable[[T], object], queue: BoundedQueue[T], guard: Guard) -> None:
        self._use = use
        self.queue = queue
        self._guard = guard
        self._thread = threading.Thread(
            target=self._work, name=f"nnpp-edge {guard.place}", daemon=True
        )
        self.start = self._thread.start

    def close(self, patience_s: float = 1.0) -> None:
        """Let the queued items be used, for so long at most, and while the queue is `patient`; what
        hangs is left behind.
        """
        self.queue.close()
        while self._thread.is_alive() and self.queue.patient():
            self._thread.join(_LOOK_EVERY_S)
        self._thread.join(patience_s)

    def _work(self) -> None:
        while (item := self.queue.take(wait=True)) is not None:
            with self._guard:
                self._use(item)
