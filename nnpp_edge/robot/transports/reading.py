"""Inputs that come from outside while the loop runs: read by threads of their own, each taken whole or refused."""

from collections.abc import Iterator
from contextlib import contextmanager

from nnpp_edge.robot.transports.framing import WireError
from nnpp_edge.robot.transports.refusals import Refusals
from nnpp_edge.robot.transports.wire import decode
from nnpp_edge.runtime.loop.ladder import one_line
from nnpp_edge.runtime.loop.mailbox import Mailbox, WhenFull
from nnpp_edge.runtime.loop.messages import Input


class MailboxSource:
    """A source whose inputs, of at most `limit` bytes each, wait in a mailbox."""

    def __init__(self, refusals: Refusals, limit: int, mailbox: Mailbox | None) -> None:
        self._refusals, self._limit, self._mailbox = refusals, limit, mailbox or Mailbox()
        self.failure = ""
        """Why nothing more can be read; empty while all is well."""

    def poll(self) -> Iterator[Input]:
        """Inputs since the last call."""
        return self._mailbox.read()

    @property
    def ended(self) -> bool:
        """Whether nothing waits and nothing more will come, or reading has failed."""
        return bool(self.failure) or self._mailbox.ended

    def _take(self, content: bytes | WireError, when_full: WhenFull, kind: str | None = None) -> int:
        """Put a message into the mailbox, or refuse it; the number of patches dropped for it."""
        try:
            if isinstance(content, WireError):
                raise content
            return self._mailbox.put(decode(content, self._limit, kind), when_full=when_full)
        except WireError as error:
            self._refusals.add(error)
            return 0

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Note any error, a lack of memory too, as the failure of the source."""
        try:
            yield
        except BaseException as error:
            self.failure = one_line(error)
