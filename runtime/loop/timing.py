"""Time: a fixed rate kept by absolute deadlines, latencies in fixed memory, and what the system
does for a loop.
"""

import logging
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from types import FrameType

import numpy as np

from nnpp_edge.runtime.errors import InvalidQueryError

Handler = Callable[[int, FrameType | None], None] | signal.Handlers

_LOG = logging.getLogger(__name__)
_TURN_S = 0.0005
"""Longest that a tick waits each time for another thread of Python; by default ten times as
long. Beside 80,000 refused inputs a second the 99th percentile of a tick fell from 16 to 6–10
ms."""
_PER_OCTAVE = 16
_OCTAVES = 27
_LEAST_S = 1e-6
"""Of a histogram: from 1 µs to 134 s."""


class Ticker:
    """Deadlines at start + k · period on a monotonic clock: lateness of one tick does not move the
    next.

    The clock reads monotonic seconds; `sleep` sleeps for at most so many, greater than 0. It may
    wake early, and True means: stop waiting.
    """

    def __init__(
        self,
        period_s: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        if not 0.0 < period_s < math.inf:
            raise InvalidQueryError(
                f"the period must be a positive number of seconds, got {period_s}"
            )
        self.period_s = period_s
        self._clock = clock
        self._sleep = sleep
        self.overruns = self.skipped = 0
        """Ticks whose work lasted beyond their deadline; deadlines that passed altogether
        meanwhile.
        """
        self.start()

    def start(self) -> None:
        """Begin to count now: the first deadline is one period away."""
        self._origin = self._clock()
        self._number = 1

    @property
    def deadline(self) -> float:
        """Reading of the clock at which this tick ends."""
        return self._origin + self._number * self.period_s

    def wait(self) -> None:
        """Sleep until the deadline.

        A deadline that has passed is not slept for: the next tick begins at once, and counts on to
        the first deadline that is still ahead.
        """
        if self.ends_late():
            return
        while (left := self.deadline - self._clock()) > 0.0 and self._sleep(left) is not True:
            pass
        self._number += 1

    def ends_late(self) -> bool:
        """Whether the tick that ends now ends after its deadline, which is counted then, with those
        that passed meanwhile.
        """
        late_s = self._clock() - self.deadline
        if late_s <= 0.0:
            return False
        missed = int(late_s // self.period_s)
        self.overruns += 1
        self.skipped += missed
        self._number += 1 + missed
        return True


class Histogram:
    """Counts of durations in buckets that widen by 4.4 %: quantiles are that accurate, and memory
    stays 3.5 kB.
    """

    def __init__(self) -> None:
        self._counts = np.zeros(_PER_OCTAVE * _OCTAVES, np.int64)
        self.count = 0
        self.max_s = self.sum_s = 0.0

    def add(self, seconds: float) -> None:
        """Count a duration; one below 1 µs counts as 1 µs."""
        octaves = math.log2(max(seconds, _LEAST_S) / _LEAST_S)
        self._counts[min(int(_PER_OCTAVE * octaves), len(self._counts) - 1)] += 1
        self.count += 1
        self.sum_s += seconds
        self.max_s = max(self.max_s, seconds)

    def quantile(self, share: float) -> float:
        """Seconds that this share (0 to 1) of the durations does not exceed, to 4.4 %; 0 if there
        are none.
        """
        at = int(np.searchsorted(np.cumsum(self._counts), max(math.ceil(share * self.count), 1)))
        bound: float = _LEAST_S * 2.0 ** ((at + 1) / _PER_OCTAVE)
        return min(bound, self.max_s)

    def summary_ms(self) -> dict[str, float]:
        """``p50``, ``p90``, ``p99``, ``max`` and ``mean`` in milliseconds; 0 if there are none."""
        seconds = {f"p{q}": self.quantile(q / 100.0) for q in (50, 90, 99)}
        seconds |= {"max": self.max_s, "mean": self.sum_s / max(self.count, 1)}
        return {name: 1e3 * value for name, value in seconds.items()}


@contextmanager
def realtime(cores: Sequence[int], priority: int) -> Iterator[None]:
    """Let threads take turns more often, pin this one and raise its priority, as far as is allowed,
    for a while.
    """
    turn_s = sys.getswitchinterval()
    core_set = os.sched_getaffinity(0)
    policy = os.sched_getscheduler(0)
    parameters = os.sched_getparam(0)
    sys.setswitchinterval(_TURN_S)
    if cores:
        with _warned(f"is not pinned to cores {list(cores)}"):
            os.sched_setaffinity(0, cores)
    if priority:
        with _warned(f"does not run under SCHED_FIFO {priority}"):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setaffinity(0, core_set)
            os.sched_setscheduler(0, policy, parameters)
        sys.setswitchinterval(turn_s)


@contextmanager
def _warned(problem: str) -> Iterator[None]:
    """Warn of what the system does not allow."""
    try:
        yield
    except (OSError, ValueError, OverflowError) as error:
        _LOG.warning("the loop %s: %s", problem, error)


@contextmanager
def signal_handlers(handlers: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """Handle signals so for a while. For the main thread."""
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
