"""Messages over standard input and output: for shell scripts, and for programs that start the loop themselves."""

import os
import select
import threading

from nnpp_edge.robot.transports.framing import LIMIT_BYTES, Framer, framed
from nnpp_edge.robot.transports.reading import MailboxSource
from nnpp_edge.robot.transports.refusals import FaultQueue, Refusals
from nnpp_edge.robot.transports.wire import encode
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.loop.mailbox import Mailbox
from nnpp_edge.runtime.loop.messages import Output

_CHUNK = 1 << 16


class StdioSource(MailboxSource):
    """Reads messages, framed as by a `Framer`, from a file descriptor in a thread of its own.

    If patches come faster than the loop reads them, reading pauses: the sender waits, and no patch is lost. Each
    message that is refused is added to `refusals`, and the next is read.
    """

    def __init__(
        self,
        refusals: Refusals,
        *,
        descriptor: int = 0,
        framing: str = "lines",
        limit: int = LIMIT_BYTES,
        mailbox: Mailbox | None = None,
    ) -> None:
        super().__init__(refusals, limit, mailbox)
        self._descriptor, self._framer = descriptor, Framer(framing, limit)
        self._thread = threading.Thread(target=self._read, name="nnpp-edge stdin", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with self._reading():
            while chunk := self._chunk():
                for message in self._framer.feed(chunk):
                    self._take(message, "wait")
            for message in self._framer.end():
                self._take(message, "wait")
            self._mailbox.close()

    def _chunk(self) -> bytes:
        while True:
            try:
                return os.read(self._descriptor, _CHUNK)
            except BlockingIOError:  # the parent process made the descriptor non-blocking
                select.select([self._descriptor], [], [])


class StdioSink(FaultQueue):
    """Writes each answer to a file descriptor. Faults wait for the next answer, and are written before it."""

    name = "stdout"

    def __init__(self, *, descriptor: int = 1, framing: str = "lines") -> None:
        super().__init__()
        self._descriptor, self._framing = descriptor, framing
        self._broken = False

    def publish(self, message: Output) -> None:
        """Write the waiting faults and the answer. OutputError, once, if the reader has gone."""
        if self._broken:
            return
        messages = (*self.waiting_faults(), message)
        content = memoryview(b"".join(framed(encode(each), self._framing) for each in messages))
        try:
            while content:
                try:
                    content = content[os.write(self._descriptor, content) :]
                except BlockingIOError:
                    select.select([], [self._descriptor], [])
        except BrokenPipeError as error:
            self._broken = True
            raise OutputError("standard output was closed by its reader: nothing more is written to it") from error
