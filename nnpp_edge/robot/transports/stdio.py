"""Messages over standard input and output: for shell scripts, and for programs that start the loop themselves."""

import os
import select
import threading
from collections.abc import Iterator

from nnpp_edge.robot.transports.incoming import MailboxSource, Refusals
from nnpp_edge.robot.transports.wire import LIMIT_BYTES, WireError, encode
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.loop.connections import Mailbox
from nnpp_edge.runtime.loop.messages import Output

_CHUNK = 1 << 16


class Framer:
    """Cuts a stream into messages, each a line. Those of more than `limit` bytes are skipped up to their end."""

    def __init__(self, limit: int = LIMIT_BYTES) -> None:
        self._limit, self._skips = limit, False
        self._buffer = bytearray()

    def feed(self, chunk: bytes) -> Iterator[bytes | WireError]:
        """The messages that end in `chunk`, and an error in the place of each that is too long."""
        *ends, rest = chunk.split(b"\n")
        for end in ends:
            line, skipped = bytes(self._buffer) + end, self._skips
            self._buffer.clear()
            self._skips = False
            if len(line) > self._limit and not skipped:
                yield self._too_long(len(line))
            elif (message := line.strip()) and not skipped:
                yield message
        if not self._skips:
            self._buffer += rest
        if len(self._buffer) > self._limit:
            self._skips = True
            yield self._too_long(len(self._buffer))
            self._buffer.clear()

    def end(self) -> bytes:
        """The last line of a stream that has ended without its end; empty if there is none."""
        rest, self._buffer = bytes(self._buffer).strip(), bytearray()
        return rest

    @property
    def buffered(self) -> int:
        """Bytes that wait for the end of their message."""
        return len(self._buffer)

    def _too_long(self, length: int) -> WireError:
        return WireError(f"wanted a message of at most {self._limit} bytes, got {length} or more")


class StdioSource(MailboxSource):
    """Reads messages, each a line, from a file descriptor in a thread of its own.

    If patches come faster than the loop reads them, reading pauses: the sender waits, and no patch is lost. Each
    message that is refused is added to `refusals`, and the next is read.
    """

    def __init__(
        self,
        refusals: Refusals,
        *,
        descriptor: int = 0,
        limit: int = LIMIT_BYTES,
        mailbox: Mailbox | None = None,
    ) -> None:
        super().__init__(refusals, limit, mailbox)
        self._descriptor, self._framer = descriptor, Framer(limit)
        self._thread = threading.Thread(target=self._read, name="nnpp-edge stdin", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with self._reading():
            while chunk := self._chunk():
                for message in self._framer.feed(chunk):
                    self._take(message, "wait")
            if rest := self._framer.end():
                self._take(rest, "wait")
            self._mailbox.close()

    def _chunk(self) -> bytes:
        while True:
            try:
                return os.read(self._descriptor, _CHUNK)
            except BlockingIOError:  # the parent process made the descriptor non-blocking
                select.select([self._descriptor], [], [])


class StdioSink:
    """Writes each answer as a line to a file descriptor; before it the refusals that wait for one."""

    name = "stdout"

    def __init__(self, refusals: Refusals | None = None, *, descriptor: int = 1) -> None:
        self._refusals, self._descriptor = refusals, descriptor
        self._broken = False

    def publish(self, message: Output) -> None:
        """Write what waits and the answer. OutputError, once, if the reader has gone."""
        if self._broken:
            return
        faults = self._refusals.waiting() if self._refusals else []
        content = memoryview(b"".join(encode(each) + b"\n" for each in (*faults, message)))
        try:
            while content:
                try:
                    content = content[os.write(self._descriptor, content) :]
                except BlockingIOError:
                    select.select([], [self._descriptor], [])
        except BrokenPipeError as error:
            self._broken = True
            raise OutputError("standard output was closed by its reader: nothing more is written to it") from error
