"""Inputs that come from outside while the loop runs: read by threads of their own, each taken whole
or refused.
"""

import logging
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from nnpp_edge.robot.transports.wire import LIMIT_BYTES, Fault, WireError, decode
from nnpp_edge.runtime.errors import one_line
from nnpp_edge.runtime.loop.connections import Mailbox
from nnpp_edge.runtime.loop.workers import CountError, WhenFull

_LOG = logging.getLogger(__name__)
_MOST_FAULTS = 64
_LOGGED = 5
"""Refusals that are logged; further ones are only counted."""


class Refusals:
    """Counts refused inputs, as by `count_error("input")`, and logs the first few. For any thread.

    The newest 64 wait to be answered by the sink that reaches their sender, if there is one.
    """

    def __init__(self, count_error: CountError) -> None:
        self.count_error = count_error
        self._lock = threading.Lock()
        self._faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)
        self.count = 0

    def add(self, error: Exception) -> None:
        """Count a refused input, and let it wait for an answer."""
        with self._lock:
            self.count += 1
            fault = Fault(str(error), self.count)
            self._faults.append(fault)
        self.count_error("input")
        if fault.count <= _LOGGED:
            more = "" if fault.count < _LOGGED else " (further ones are only counted)"
            _LOG.warning("an input was refused: %s%s", error, more)

    def waiting(self) -> list[Fault]:
        """Take out the faults that wait now, oldest first; those that come meanwhile wait on."""
        return [self._faults.popleft() for _ in range(len(self._faults))]


class MailboxSource:
    """A source whose inputs wait in a mailbox: the base of those that threads fill (`Incoming`)."""

    limit = LIMIT_BYTES
    """Of an input, at most."""

    def __init__(self, count_error: CountError) -> None:
        self.refusals = Refusals(count_error)
        """Messages that were refused, for the sink that answers them."""
        self._mailbox = Mailbox()
        self.poll = self._mailbox.read
        """Inputs since the last call."""
        self.failure = ""
        """Why nothing more can be read; empty while all is well."""

    @property
    def ended(self) -> bool:
        """Whether nothing waits and nothing more will come, or reading has failed."""
        return bool(self.failure) or self._mailbox.ended

    def close(self) -> None:
        """Do nothing: the thread that reads ends with the process."""

    def _take(self, content: bytes, when_full: WhenFull, kind: str | None = None) -> int:
        """Put a message into the mailbox, or refuse it; the number of patches dropped for it."""
        try:
            return self._mailbox.put(decode(content, self.limit, kind), when_full=when_full)
        except WireError as error:
            self.refusals.add(error)
            return 0

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Note any error, a lack of memory too, as the failure of the source."""
        try:
            yield
        except BaseException as error:
            self.failure = one_line(error)
