"""The onboard loop at a fixed rate: poll the source, tick the navigator, hand the answer to the sinks."""

import gc
import logging
import os
import select
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.histogram import Histogram
from nnpp_edge.runtime.loop.messages import Counters, Input, Outcome, Output, PathMessage, StatusMessage
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.ticker import Ticker

_LOG = logging.getLogger(__name__)
_SHARE_FOR_INPUTS = 0.5
"""Of a period; inputs that come faster than they can be taken in wait for the next tick."""
_OCTAVES_TOLD = range(8, 20)
"""Bounds of the histogram that is told, in powers of two of a microsecond: 0.256 to 524 ms."""
_BOUNDS_TOLD = (*(f"{1e-3 * 2**n:g}" for n in _OCTAVES_TOLD), "inf")
_CALM_S = 10.0
"""What has failed counts as working again once it has for so long."""
_GC_EVERY = 64
"""Ticks between two looks at whether there is time to collect garbage."""


class Source(Protocol):
    """Where inputs come from."""

    def poll(self) -> Iterable[Input]:
        """What has come since the last call; must not wait. An iterable may be read on in the next tick."""


class Sink(Protocol):
    """Where answers go. Each sink is served by a thread of its own and may take its time.

    A sink that has an attribute ``lost``, a count of what it could not keep, has it told with the counters.
    """

    name: str

    def publish(self, message: Output) -> None:
        """Send it on. May raise: that is counted, and the next message tried."""


class Loop:
    """Runs until it is stopped. What source, sinks and planner do wrong is counted, and the loop goes on.

    Parameters
    ----------
    navigator : Navigator
        Answers.
    source : Source
        Asked at the begin of each tick, in the loop's thread.
    sinks : sequence of Sink
        Each gets every answer, in order; the oldest that wait are dropped where it is too slow.
    rate_hz : float
        Ticks a second.
    status_every_s : float
        Seconds between two status messages.
    queue : int
        Messages that wait for a sink at most.
    cores : sequence of int
        Pin the loop's thread to these; empty for all.
    priority : int
        Run it under SCHED_FIFO with this priority, 1 to 99; 0 for the usual scheduler. Where the system does not
        allow it, a warning is logged.
    paced : bool
        Whether a tick waits for its deadline. Else the next begins at once, with a whole period to itself; for
        replays that shall not last as long as what they repeat.
    after_tick : callable
        Called with each answer, in the loop's thread, once the tick's work is done. For what must stand still when
        the planning does, such as a watchdog; it must not wait. If it raises, that is counted.
    """

    def __init__(
        self,
        navigator: Navigator,
        source: Source,
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
            raise InvalidQueryError(f"the rate must be a positive number of ticks a second, got {rate_hz}")
        self.navigator, self._source = navigator, source
        self._wake = _Wake()
        self._ticker = Ticker(1.0 / rate_hz, sleep=self._wake.wait)
        self._writers = [_Writer(sink, queue, self.navigator.count_error) for sink in sinks]
        self._status_every_s = status_every_s
        self._cores, self._priority = tuple(cores), priority
        self._paced, self._after_tick = paced, after_tick
        self._source_trouble, self._after_tick_trouble = _Trouble("the source"), _Trouble("what follows a tick")
        self._histogram = Histogram()
        self._stopping = False
        self._reload_wanted = False
        self._reloader: threading.Thread | None = None
        self._waiting: Iterator[Input] = iter(())
        self._collection_s = 0.0
        self._allowed: set[int] = set()
        """Cores that the process might use before the loop's thread was pinned."""

    def stop(self) -> None:
        """Finish the tick and leave `run`. May be called from a signal handler or any thread."""
        self._stopping = True
        self._wake.set()

    def request_reload(self) -> None:
        """Read the model's file again, beside the loop. May be called from a signal handler or any thread."""
        self._reload_wanted = True

    def run(self, ticks: int | None = None) -> Counters:
        """Run until `stop`, or for so many ticks; the counters at the end. A loop runs once."""
        for writer in self._writers:
            writer.start()  # before the loop's thread gets its core and priority, which threads inherit
        self._allowed = os.sched_getaffinity(0)
        before = be_realtime(self._cores, self._priority)
        collecting = gc.isenabled()
        gc.collect()
        gc.freeze()
        gc.disable()
        done, reported = 0, time.monotonic()
        self._ticker.start()
        try:
            while not self._stopping and (ticks is None or done < ticks):
                message = self._tick()
                done += 1
                if time.monotonic() - reported >= self._status_every_s:
                    reported = time.monotonic()
                    self._publish(self._status(message))
                self._finish(message)
                self._collect(done)
                if not self._stopping and (ticks is None or done < ticks):
                    self._ticker.wait() if self._paced else self._ticker.start()
        finally:
            gc.unfreeze()
            if collecting:
                gc.enable()
            before()
            for writer in self._writers:
                writer.close()
        return self.counters()

    def counters(self) -> Counters:
        """What the loop has done so far; from any thread."""
        return replace(
            self.navigator.counters(), overruns=self._ticker.overruns, skipped=self._ticker.skipped,
            drops={writer.name: writer.drops for writer in self._writers}, tick_ms=self._histogram.summary_ms(),
            tick_histogram=dict(zip(_BOUNDS_TOLD, self._histogram.shorter(_OCTAVES_TOLD), strict=True)),
            tick_sum_s=self._histogram.sum_s,
            lost={writer.name: lost for writer in self._writers if (lost := writer.lost) is not None},
            rss_bytes=rss_bytes(),
        )  # fmt: skip

    def _tick(self) -> PathMessage:
        began = time.monotonic()
        self._take_inputs(began)
        if self._reload_wanted and (self._reloader is None or not self._reloader.is_alive()):
            self._reload_wanted = False
            self._reloader = threading.Thread(target=self._reload, name="nnpp-edge reload", daemon=True)
            self._reloader.start()
        message = self.navigator.tick(self._ticker.deadline)
        self._publish(message)
        self._histogram.add(time.monotonic() - began)
        return message

    def _take_inputs(self, began: float) -> None:
        """As many as half a period allows; the rest waits in its iterator, and is taken first next time."""
        until = began + _SHARE_FOR_INPUTS * self._ticker.period_s
        try:
            for message in self._waiting:
                self.navigator.offer(message)
                if time.monotonic() > until:
                    return
            self._waiting = iter(self._source.poll())
            for message in self._waiting:
                self.navigator.offer(message)
                if time.monotonic() > until:
                    break
        except Exception:
            self._source_trouble.began()
            self.navigator.count_error("source")
            self._waiting = iter(())
        else:
            self._source_trouble.ended()

    def _reload(self) -> None:
        with suppress(OSError):  # this thread, and the network's, must not inherit the loop's core and priority
            os.sched_setaffinity(0, self._allowed)
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        try:
            self.navigator.reload()
        except Exception as error:
            _LOG.warning("the model stays as it is: %s", error)

    def _publish(self, message: Output) -> None:
        for writer in self._writers:
            writer.put(message)

    def _status(self, last: PathMessage) -> StatusMessage:
        counters = self.counters()
        text = f"{last.outcome} by {last.origin}" if last.outcome is Outcome.OK else f"{last.outcome}: {last.reason}"
        return StatusMessage(last.tick, last.outcome, text, counters)

    def _finish(self, message: PathMessage) -> None:
        if self._after_tick is None:
            return
        try:
            self._after_tick(message)
        except Exception:
            self._after_tick_trouble.began()
            self.navigator.count_error("after_tick")
        else:
            self._after_tick_trouble.ended()

    def _collect(self, done: int) -> None:
        """Collect garbage where the idle time is enough for it."""
        if done % _GC_EVERY == 0 and self._ticker.remaining() > 2.0 * self._collection_s:
            began = time.monotonic()
            gc.collect()
            self._collection_s = time.monotonic() - began
        elif done % _GC_EVERY == 0:
            self._collection_s *= 0.9


class _Writer:
    """A sink's queue, and the thread that empties it."""

    def __init__(self, sink: Sink, most: int, failed: Callable[[str], None]) -> None:
        self.name = sink.name
        self.drops = 0
        self._sink, self._failed, self._most = sink, failed, most
        self._trouble = _Trouble(f"the sink {self.name}")
        self._queue: deque[Output] = deque()
        self._news = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._work, name=f"nnpp-edge sink {sink.name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    @property
    def lost(self) -> int | None:
        """Messages that the sink took and could not keep, if it counts them."""
        return getattr(self._sink, "lost", None)

    def put(self, message: Output) -> None:
        with self._news:
            if len(self._queue) >= self._most:
                self._queue.popleft()
                self.drops += 1
            self._queue.append(message)
            self._news.notify()

    def close(self, patience_s: float = 1.0) -> None:
        """Let what waits be sent, for so long; a sink that hangs is left behind."""
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
                self._trouble.began()
                self._failed(f"sink {self.name}")
            else:
                self._trouble.ended()


class _Trouble:
    """Logs the first of failures, with its traceback, and when there were no more for a while."""

    def __init__(self, who: str) -> None:
        self._who = who
        self._times, self._last = 0, 0.0

    def began(self) -> None:
        """It failed; to be called where the exception is handled."""
        if not self._times:
            _LOG.warning("%s failed; more of the same is counted, not logged", self._who, exc_info=True)
        self._times, self._last = self._times + 1, time.monotonic()

    def ended(self) -> None:
        """It did what it should."""
        if self._times and time.monotonic() - self._last >= _CALM_S:
            _LOG.warning("%s works again, after %d failures", self._who, self._times)
            self._times = 0


class _Wake:
    """A sleep that another thread or a signal handler ends. An Event's lock is not safe in handlers; a pipe is."""

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)

    def wait(self, seconds: float) -> bool:
        """Sleep for so long; True if woken."""
        return bool(select.select([self._read], [], [], seconds)[0])

    def set(self) -> None:
        """End this sleep and all that follow."""
        with suppress(BlockingIOError):
            os.write(self._write, b"!")

    def __del__(self) -> None:
        with suppress(OSError, AttributeError):
            os.close(self._read)
            os.close(self._write)


@contextmanager
def handling_signals(loop: Loop) -> Iterator[None]:
    """SIGTERM and SIGINT stop the loop after its tick, SIGHUP reads the model again. For the main thread."""
    handlers: dict[signal.Signals, Callable[[int, Any], None]] = {
        signal.SIGTERM: lambda number, frame: loop.stop(),
        signal.SIGINT: lambda number, frame: loop.stop(),
        signal.SIGHUP: lambda number, frame: loop.request_reload(),
    }
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def be_realtime(cores: Sequence[int], priority: int) -> Callable[[], None]:
    """Pin this thread and raise its priority, as far as the system allows; how to undo it."""
    undo: list[Callable[[], None]] = []
    if cores:
        try:
            before = os.sched_getaffinity(0)
            os.sched_setaffinity(0, cores)
            undo.append(lambda: os.sched_setaffinity(0, before))
        except (OSError, ValueError) as error:
            _LOG.warning("the loop is not pinned to cores %s: %s", list(cores), error)
    if priority:
        try:
            policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            undo.append(lambda: os.sched_setscheduler(0, policy, parameters))
        except (OSError, ValueError) as error:
            _LOG.warning("the loop does not run under SCHED_FIFO %d: %s", priority, error)

    def restore() -> None:
        for step in reversed(undo):
            with suppress(OSError):
                step()

    return restore


def rss_bytes() -> int:
    """Resident memory of this process; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0
