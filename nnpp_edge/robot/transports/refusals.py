"""Inputs that were refused: counted, logged, and answered."""

import logging
import threading
from collections import deque
from collections.abc import Callable

from nnpp_edge.robot.transports.wire import Fault

_LOG = logging.getLogger(__name__)
_MOST_FAULTS = 64
_LOGGED = 5
"""Refusals that are logged; further ones are only counted."""


class FaultQueue:
    """Faults that wait to be sent with the next answer. Of many the newest 64 are kept. For any thread."""

    def __init__(self) -> None:
        self._faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)

    def answer(self, fault: Fault) -> None:
        """Send a fault with the next answer; does not wait."""
        self._faults.append(fault)

    def waiting_faults(self) -> list[Fault]:
        """The faults that wait now, oldest first, each taken out; any that come meanwhile wait on."""
        return [self._faults.popleft() for _ in range(len(self._faults))]


class Refusals:
    """Counts refused inputs, answers each, and logs the first few. For any thread.

    `count_error` is called with ``input`` for each. `answer` sends the fault to the sender of the input; None if
    there is no way back.
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
