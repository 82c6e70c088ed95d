"""A fixed rate, kept by absolute deadlines."""

import math
import time
from collections.abc import Callable

from nnpp_edge.runtime.errors import InvalidQueryError


class Ticker:
    """Deadlines at start + k · period on a monotonic clock: lateness of one tick does not move the next.

    The clock reads monotonic seconds; `sleep` sleeps for at most so many, greater than 0. It may wake early, and True
    means: stop waiting.
    """

    def __init__(
        self,
        period_s: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        if not 0.0 < period_s < math.inf:
            raise InvalidQueryError(f"the period must be a positive number of seconds, got {period_s}")
        self.period_s = period_s
        self._clock, self._sleep = clock, sleep
        self.overruns = 0
        """Ticks whose work lasted beyond their deadline."""
        self.skipped = 0
        """Deadlines that passed altogether meanwhile."""
        self.restarts = 0
        """Times that the clock jumped back by more than a period, and counting began anew."""
        self.start()

    def start(self) -> None:
        """Begin to count now: the first deadline is one period away."""
        self._origin, self._number = self._clock(), 1

    @property
    def deadline(self) -> float:
        """Reading of the clock at which this tick ends."""
        return self._origin + self._number * self.period_s

    def remaining(self) -> float:
        """Seconds to the deadline; below 0 once it has passed."""
        return self.deadline - self._clock()

    def wait(self) -> int:
        """Sleep until the deadline; the number of deadlines that had passed unused before.

        A deadline that has passed is not slept for: the next tick begins at once, and counts on to the first
        deadline that is still ahead.
        """
        missed = 0
        if self.remaining() < 0.0:
            self.overruns += 1
            missed = int(-self.remaining() // self.period_s)
            self.skipped += missed
        else:
            while (left := self.remaining()) > 0.0:
                if left > 1.5 * self.period_s:  # the clock was set back
                    self.restarts += 1
                    self.start()
                    left = self.period_s
                if self._sleep(left) is True:
                    break
        self._number += 1 + missed
        return missed
