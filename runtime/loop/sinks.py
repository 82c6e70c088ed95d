"""Where the loop's answers go: each sink has a queue and a thread of its own."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from nnpp_edge.runtime.loop.messages import Output

_LOG = logging.getLogger(__name__)
_CALM_S = 10.0
"""What has failed counts as working again once it has worked for so long."""


class Sink(Protocol):
    """Where answers go. Each sink is served by a thread of its own and may take its time.

    A sink may have an attribute ``lost``: the number of messages that it took and could not keep. It is reported in
    `Counters.lost`.
    """

    name: str

    def publish(self, message: Output) -> None:
        """Send the message on. If it raises, that is counted, and the next message is tried."""


class SinkWriter:
    """A sink's queue, and the thread that empties it."""

    def __init__(self, sink: Sink, most: int, count_error: Callable[[str], None]) -> None:
        self.name = sink.name
        self.drops = 0
        """Messages that were dropped because too many were waiting."""
        self._sink, self._count_error, self._most = sink, count_error, most
        self._failures = FailureLog(f"the sink {self.name}")
        self._queue: deque[Output] = deque()
        self._news = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._work, name=f"nnpp-edge sink {sink.name}", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    @property
    def lost(self) -> int | None:
        """Messages that the sink took and could not keep, if it counts them."""
        lost: int | None = getattr(self._sink, "lost", None)
        return lost

    def put(self, message: Output) -> None:
        """Queue a message; if the queue is full, the oldest one is dropped."""
        with self._news:
            if len(self._queue) >= self._most:
                self._queue.popleft()
                self.drops += 1
            self._queue.append(message)
            self._news.notify()

    def close(self, patience_s: float = 1.0) -> None:
        """Let the queued messages be sent, for so long at most; a sink that hangs is left behind."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(patience_s)

    def _work(self) -> None:
        while True:
            with self._news:
                while not self._queue and not self._closing:
                    self._news.wait()
                if not self._queue:
                    return
                message = self._queue.popleft()
            try:
                self._sink.publish(message)
            except Exception:
                self._failures.failed()
                self._count_error(f"sink {self.name}")
            else:
                self._failures.worked()


class FailureLog:
    """Logs the first of a row of failures, with its traceback, and when it has worked again for a while."""

    def __init__(self, who: str) -> None:
        self._who = who
        self._times, self._last = 0, 0.0

    def failed(self) -> None:
        """Note a failure. Call it where the exception is handled."""
        if not self._times:
            _LOG.warning("%s failed; more of the same is counted, not logged", self._who, exc_info=True)
        self._times, self._last = self._times + 1, time.monotonic()

    def worked(self) -> None:
        """Note that it worked."""
        if self._times and time.monotonic() - self._last >= _CALM_S:
            _LOG.warning("%s works again, after %d failures", self._who, self._times)
            self._times = 0
