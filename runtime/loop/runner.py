"""The onboard loop at a fixed rate: read the inputs, let the navigator answer, hand the answer to
the sinks.
"""

import gc
import math
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.connections import InputSource, Sink
from nnpp_edge.runtime.loop.messages import Counters, Input, Output, PathMessage, StatusMessage
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.timing import Histogram, Ticker, realtime, signal_handlers
from nnpp_edge.runtime.loop.workers import BoundedQueue, Guard, Worker
from nnpp_edge.runtime.memory import rss_bytes

_SHARE_FOR_INPUTS = 0.5
"""Of a period; inputs that come faster than they can be read wait for the next tick."""
_WAKE_S = 0.002
"""Before a tick, from when on no search goes on: it ends some checks of poses late."""
_LONGEST_SLEEP_S = 0.05
"""Then the loop looks whether it is to stop: an Event's lock is not safe in handlers of signals."""


class Loop:
    """Runs until it is stopped. Errors of source, sinks and planner are counted, and the loop
    continues.

    Parameters
    ----------
    source : InputSource
        Polled at the beginning of each tick, in the loop's thread.
    sinks : sequence of Sink
        Each gets every answer, in order. If one is too slow, the oldest messages in its queue are
        dropped.
    rate_hz : float
        Ticks a second.
    status_every_s : float
        Seconds between two status messages.
    queue : int
        Most messages that wait for a sink.
    cores : sequence of int
        Pin the loop's thread to these; empty for all.
    priority : int
        Run the loop's thread under SCHED_FIFO with this priority, 1 to 99; 0 for the usual
        scheduler. If the system does not allow it, a warning is logged.
    paced : bool
        Whether a tick has a deadline, for which the next one waits. Else a tick begins at once,
        reads all that the source has, takes the time that it needs, and waits for sinks that are
        too slow. So no answer is lost, and answers depend on the inputs alone: for replays at full
        speed.
    after_tick : callable
        Called with each answer, in the loop's thread, once the tick's work is done: for what must
        stop when the planning stops, such as a watchdog. It must not wait. If it raises, that is
        counted.
    """

    @checked(InvalidQueryError)
    def __init__(
        self,
        navigator: Navigator,
        source: InputSource,
        sinks: Sequence[Sink] = (),
        *,
        rate_hz: float = 10.0,
        status_every_s: float = 1.0,
        queue: int = 8,
        cores: Sequence[int] = (),
        priority: int = 0,
        paced: bool = True,
        after_tick: Callable[[PathMessage], None] | None = None,
    ) -> None:
        if not rate_hz > 0.0:
            raise InvalidQueryError(
                f"the rate must be a positive number of ticks a second, got {rate_hz}"
            )
        self.navigator = navigator
        self._source = source
        self.tick_s = 0.0
        """That the last tick took, for `after_tick`."""
        self._stopping = self._hurried = False
        self._ticker = Ticker(1.0 / rate_hz, sleep=self._sleep)
        count_error = navigator.count_error
        self._sinks: list[tuple[Sink, Worker[Output]]] = []
        for sink in sinks:
            waiting = BoundedQueue[Output](queue, patient=self._is_patient)
            guard = Guard(f"the sink {sink.name}", f"sink {sink.name}", count_error)
            self._sinks.append((sink, Worker(sink.publish, waiting, guard)))
        self._status_every_s = status_every_s
        self._paced = paced
        self._cores = tuple(cores)
        self._priority = priority
        self._after_tick = after_tick or (lambda message: None)
        self._source_guard = Guard("the source", "source", count_error)
        self._after_guard = Guard("after_tick", "after_tick", count_error)
        self._histogram = Histogram()
        self._unread: Iterator[Input] = iter(())

    def stop(self) -> None:
        """Finish the tick and leave `run`, soon. May be called from a signal handler or
        any thread.
        """
        self._hurried = True
        self.finish()

    def finish(self) -> None:
        """As `stop`, but without `paced` the sinks are waited for until they have taken all
        answers.
        """
        self._stopping = True

    @checked(InvalidQueryError)
    def run(self, ticks: int | None = None) -> Counters:
        """Run until `stop`, or for so many ticks; the counters at the end. A loop runs once."""
        for _, worker in self._sinks:
            # before the loop's thread gets its core and priority, which threads inherit
            worker.start()
        try:
            with realtime(self._cores, self._priority), _little_garbage():
                self._run_ticks(ticks)
        finally:
            for _, worker in self._sinks:
                worker.close()
        return self.counters()

    def counters(self) -> Counters:
        """Counts so far; from any thread."""
        counting = [sink for sink, _ in self._sinks if hasattr(sink, "lost")]
        return replace(
            self.navigator.counters(),
            overruns=self._ticker.overruns,
            skipped=self._ticker.skipped,
            drops={sink.name: worker.queue.drops for sink, worker in self._sinks},
            lost={sink.name: sink.lost for sink in counting},
            tick_ms=self._histogram.summary_ms(),
            rss_bytes=rss_bytes(),
        )

    def _is_patient(self) -> bool:
        """Whether sinks that are slow are waited for."""
        return not (self._paced or self._hurried)

    def _sleep(self, seconds: float) -> bool:
        """Go on with a search, or sleep, for a moment; whether the loop is to stop."""
        moment_s = min(seconds, _LONGEST_SLEEP_S)
        if moment_s <= _WAKE_S or not self.navigator.go_on(moment_s - _WAKE_S):
            time.sleep(moment_s)
        return self._stopping

    def _run_ticks(self, ticks: int | None) -> None:
        done = 0
        reported = time.monotonic()
        self._ticker.start()
        while not self._stopping and (ticks is None or done < ticks):
            if done and self._paced:
                self._ticker.wait()
                if self._stopping:
                    return
            message = self._tick()
            done += 1
            if time.monotonic() - reported >= self._status_every_s:
                reported = time.monotonic()
                how = f" by {message.origin}" if message.ok else f": {message.reason}"
                text = message.outcome + how
                status = StatusMessage(message.tick, message.outcome, text, self.counters())
                self._publish(status)
            with self._after_guard:
                self._after_tick(message)
        if done and self._paced:  # nobody waits for the next
            self._ticker.ends_late()

    def _tick(self) -> PathMessage:
        began = time.monotonic()
        self._read_inputs(began)
        message = self.navigator.tick(self._ticker.deadline if self._paced else math.inf)
        self._publish(message)
        self.tick_s = time.monotonic() - began
        self._histogram.add(self.tick_s)
        return message

    def _read_inputs(self, began: float) -> None:
        """As many as half a period allows; the rest stays in its iterator and is read first next
        time.
        """
        until = began + _SHARE_FOR_INPUTS * self._ticker.period_s if self._paced else math.inf
        unread = self._unread
        self._unread = iter(())
        with self._source_guard:
            if self._offer(unread, until):
                self._offer(iter(self._source.poll()), until)

    def _offer(self, unread: Iterator[Input], until: float) -> bool:
        """Hand inputs to the navigator; False, and the rest stays unread, if the time is over
        before their end.
        """
        for message in unread:
            self.navigator.offer(message)
            if time.monotonic() > until:
                self._unread = unread
                return False
        return True

    def _publish(self, message: Output) -> None:
        for _, worker in self._sinks:
            worker.queue.put(message, "wait")  # while it is patient; else the oldest is dropped


def handling_signals(loop: Loop) -> AbstractContextManager[None]:
    """SIGTERM and SIGINT stop the loop after its tick. For the main thread."""

    return signal_handlers(
        dict.fromkeys((signal.SIGTERM, signal.SIGINT), lambda number, frame: loop.stop())
    )


@contextmanager
def _little_garbage() -> Iterator[None]:
    """Collect once, then look no more at what is there: each collection within takes well below a
    millisecond.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
