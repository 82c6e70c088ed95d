"""Messages over standard input and output: for shell scripts, and for programs that start the loop themselves."""

import os
import select
import struct
import threading
from collections.abc import Iterator

from nnpp_edge.robot.transports.incoming import MailboxSource, Refusals
from nnpp_edge.robot.transports.wire import LIMIT_BYTES, WireError, encode
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.loop.connections import Mailbox
from nnpp_edge.runtime.loop.messages import Output

FRAMINGS = ("lines", "length")
_CHUNK = 1 << 16
_HEADER = struct.Struct(">I")


def framed(payload: bytes, framing: str) -> bytes:
    """A message as it stands in a stream: ended by a newline, or led by its length in 4 bytes, big-endian."""
    return payload + b"\n" if framing == "lines" else _HEADER.pack(len(payload)) + payload


class Framer:
    """Cuts a stream into messages, by ``lines`` or by ``length``. Those of more than `limit` bytes are skipped."""

    def __init__(self, framing: str = "lines", limit: int = LIMIT_BYTES) -> None:
        if framing not in FRAMINGS:
            raise WireError(f"framing must be one of {', '.join(FRAMINGS)}, got {framing!r}")
        self._lines, self._limit = framing == "lines", limit
        self._buffer = bytearray()
        self._skip = 0
        """Bytes still to be skipped; with lines, any number above 0 means up to the next end of a line."""

    def feed(self, chunk: bytes) -> Iterator[bytes | WireError]:
        """The messages that end in `chunk`, and an error in the place of each that is too long."""
        return self._cut_lines(chunk) if self._lines else self._cut_lengths(chunk)

    def end(self) -> Iterator[bytes | WireError]:
        """The rest when the stream has ended: a last line without its end, or an error if a message was cut off."""
        rest, self._buffer = bytes(self._buffer).strip(), bytearray()
        if self._lines and rest and not self._skip:
            yield rest
        elif not self._lines and (rest or self._skip):
            yield WireError("wanted a whole message, got the end of the stream within one")

    @property
    def buffered(self) -> int:
        """Bytes that wait for the end of their message."""
        return len(self._buffer)

    def _cut_lines(self, chunk: bytes) -> Iterator[bytes | WireError]:
        *ends, rest = chunk.split(b"\n")
        for end in ends:
            line, skipped = bytes(self._buffer) + end, self._skip
            self._buffer.clear()
            self._skip = 0
            if len(line) > self._limit and not skipped:
                yield self._too_long(len(line))
            elif (message := line.strip()) and not skipped:
                yield message
        if not self._skip:
            self._buffer += rest
        if len(self._buffer) > self._limit:
            self._skip = 1
            yield self._too_long(len(self._buffer))
            self._buffer.clear()

    def _cut_lengths(self, chunk: bytes) -> Iterator[bytes | WireError]:
        self._buffer += chunk[self._skip :]
        self._skip = max(self._skip - len(chunk), 0)
        while len(self._buffer) >= _HEADER.size:
            (length,) = _HEADER.unpack_from(self._buffer)
            end, too_long = _HEADER.size + length, length > self._limit
            if not too_long and len(self._buffer) < end:
                return
            message = self._too_long(length) if too_long else bytes(memoryview(self._buffer)[_HEADER.size : end])
            self._skip = max(end - len(self._buffer), 0)
            del self._buffer[:end]
            yield message

    def _too_long(self, length: int) -> WireError:
        return WireError(f"wanted a message of at most {self._limit} bytes, got {length} or more")


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


class StdioSink:
    """Writes each answer to a file descriptor; before it the refusals that wait for one."""

    name = "stdout"

    def __init__(self, refusals: Refusals | None = None, *, descriptor: int = 1, framing: str = "lines") -> None:
        self._refusals, self._descriptor, self._framing = refusals, descriptor, framing
        self._broken = False

    def publish(self, message: Output) -> None:
        """Write what waits and the answer. OutputError, once, if the reader has gone."""
        if self._broken:
            return
        faults = self._refusals.waiting() if self._refusals else []
        content = memoryview(b"".join(framed(encode(each), self._framing) for each in (*faults, message)))
        try:
            while content:
                try:
                    content = content[os.write(self._descriptor, content) :]
                except BlockingIOError:
                    select.select([], [self._descriptor], [])
        except BrokenPipeError as error:
            self._broken = True
            raise OutputError("standard output was closed by its reader: nothing more is written to it") from error
