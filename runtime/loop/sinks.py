"""Where the loop's answers go: each sink has a queue and a thread of its own."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, Literal, Protocol, TypeVar

from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.loop.messages import Output

T = TypeVar("T")
_LOG = logging.getLogger(__name__)
_CALM_S = 10.0
"""Seconds of work after which what has failed counts as working again."""
_LOOK_EVERY_S = 0.1


class Sink(Protocol):
    """Where answers go. Each sink is served by a thread of its own and may take its time.

    A sink may have an attribute ``lost``: the number of messages that it took and could not keep. It is reported in
    `Counters.lost`.
    """

    name: str

    def publish(self, message: Output) -> None:
        """Send the message on. If it raises, that is counted, and the next message is tried."""


class Worker(Generic[T]):
    """A queue of at most so many items, and a thread that hands each to `use`, in order; `use` must not raise.

    While `patient` says so, `put` waits for room, and `close` for the end of the queue. `size` says what an item
    counts.
    """

    def __init__(
        self,
        name: str,
        use: Callable[[T], None],
        most: int,
        patient: Callable[[], bool] = lambda: False,
        size: Callable[[T], int] = lambda item: 1,
    ) -> None:
        self._use, self._most, self._patient, self._size = use, most, patient, size
        self._queue: deque[T] = deque()
        self._used = 0
        self._news = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._work, name=f"nnpp-edge {name}", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def put(self, item: T, *, when_full: Literal["drop oldest", "refuse"]) -> bool:
        """Queue an item; False if the queue was full, and the oldest item was dropped or this one refused."""
        size, room = self._size(item), True
        with self._news:
            while self._queue and self._used + size > self._most:
                if self._patient():
                    self._news.wait(_LOOK_EVERY_S)
                    continue
                if when_full == "refuse":
                    return False
                self._oldest()
                room = False
            self._queue.append(item)
            self._used += size
            self._news.notify_all()
            return room

    def close(self, patience_s: float = 1.0) -> None:
        """Let the queued items be used, for so long at most; a function that hangs is left behind."""
        with self._news:
            self._closing = True
            self._news.notify_all()
        while self._thread.is_alive() and self._patient():
            self._thread.join(_LOOK_EVERY_S)
        self._thread.join(patience_s)

    def _work(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._queue or self._closing)
                if not self._queue:
                    return
                item = self._oldest()
                self._news.notify_all()
            self._use(item)

    def _oldest(self) -> T:
        item = self._queue.popleft()
        self._used -= self._size(item)
        return item


class SinkWriter:
    """A sink's queue, and the thread that empties it."""

    def __init__(
        self, sink: Sink, most: int, count_error: Callable[[str], None], patient: Callable[[], bool] = lambda: False
    ) -> None:
        self.name = sink.name
        self.drops = 0
        """Messages that were dropped because too many were waiting."""
        self._sink, self._count_error = sink, count_error
        self._failures = FailureLog(f"the sink {self.name}")
        self._worker = Worker(f"sink {sink.name}", self._publish, most, patient)
        self.start, self.close = self._worker.start, self._worker.close

    @property
    def lost(self) -> int | None:
        """Messages that the sink took and could not keep, if it counts them."""
        lost: int | None = getattr(self._sink, "lost", None)
        return lost

    def put(self, message: Output) -> None:
        """Queue a message; if the queue is full, the oldest one is dropped."""
        self.drops += not self._worker.put(message, when_full="drop oldest")

    def _publish(self, message: Output) -> None:
        try:
            self._sink.publish(message)
        except Exception as error:
            self._failures.failed(error)
            self._count_error(f"sink {self.name}")
        else:
            self._failures.worked()


class FailureLog:
    """Logs the first of a row of failures, and when it has worked again for a while.

    With its traceback, unless the system or a message of the package says all there is to say.
    """

    def __init__(self, who: str) -> None:
        self._who = who
        self._times, self._last = 0, 0.0

    def failed(self, error: Exception) -> None:
        """Note a failure."""
        if not self._times:
            known = isinstance(error, OSError | NnppEdgeError)
            words = "%s failed (%s); more of the same is counted, not logged"
            _LOG.warning(words, self._who, " ".join(str(error).split()), exc_info=None if known else error)
        self._times, self._last = self._times + 1, time.monotonic()

    def worked(self) -> None:
        """Note that it worked."""
        if self._times and time.monotonic() - self._last >= _CALM_S:
            _LOG.warning("%s works again, after %d failures", self._who, self._times)
            self._times = 0
