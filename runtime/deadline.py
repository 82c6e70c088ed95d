"""The time by which a query must be answered: one deadline, which everything that works for the
answer is given.
"""

import math
import time

from nnpp_edge.runtime.errors import InvalidQueryError


class OutOfTimeError(Exception):
    """The deadline of a query has passed. Planners catch it, and answer TIMEOUT."""


class Deadline:
    """When to give up."""

    def __init__(self, at: float = math.inf) -> None:
        self.at = at
        """Reading of `time.monotonic`, which kernels are given, see `kernels.clock`; inf for
        never.
        """
        self.until = at
        """At which a search stops working, to ask whether it `goes_on`."""

    @classmethod
    def within(cls, seconds: float) -> "Deadline":
        """The time so many seconds from now; InvalidQueryError for less than 0 or NaN."""
        if not seconds >= 0.0:
            raise InvalidQueryError(f"time_limit_s must be a number of at least 0, got {seconds}")
        return cls(time.monotonic() + seconds)

    @property
    def left_s(self) -> float:
        """Seconds until then; inf for ever."""
        return self.at - time.monotonic()

    @property
    def passed(self) -> bool:
        """Whether it is too late."""
        return self.left_s <= 0.0

    def goes_on(self) -> bool:
        """Whether a search that stopped may go on now; where it works in slices, after a pause."""
        return not self.passed

    def check(self) -> None:
        """OutOfTimeError if it is too late."""
        if self.passed:
            raise OutOfTimeError


NEVER = Deadline()
"""Without a limit."""
