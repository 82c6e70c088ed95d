"""Where one message ends and the next begins in a stream of bytes."""

import struct
from collections.abc import Iterator

from nnpp_edge.runtime.loop.messages import InvalidMessageError

LIMIT_BYTES = 16 << 20
"""Of a message; room for a patch of 1700 × 1700 cells in base64."""
JSON_BYTES = 128 << 10
"""Of a message besides a patch's base64; room for 128 × 128 cells as lists. No other thread runs while JSON is
decoded: 9 ms at most for so much; 16 MiB of lists took 1 s and 1 GB."""
FRAMINGS = ("lines", "length")
_HEADER = struct.Struct(">I")


class WireError(InvalidMessageError):
    """Bytes that are no message; one line says what was wanted and what came."""


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
        self._searched = 0
        self._skip = 0
        """Bytes still to be skipped; with lines, any number above 0 means up to the next end of a line."""

    def feed(self, chunk: bytes) -> Iterator[bytes | WireError]:
        """The messages that end in `chunk`, and an error in the place of each that is too long."""
        self._buffer += chunk
        yield from self._cut_lines() if self._lines else self._cut_lengths()

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

    def _cut_lines(self) -> Iterator[bytes | WireError]:
        while (at := self._buffer.find(b"\n", self._searched)) >= 0:
            line = self._copy(0, at).strip()
            del self._buffer[: at + 1]
            self._searched = 0
            if self._skip:
                self._skip = 0
            elif at > self._limit:
                yield self._too_long(at)
            elif line:
                yield line
        if len(self._buffer) > self._limit and not self._skip:
            self._skip = 1
            yield self._too_long(len(self._buffer))
        if self._skip:
            self._buffer.clear()
        self._searched = len(self._buffer)

    def _cut_lengths(self) -> Iterator[bytes | WireError]:
        while True:
            skipped = min(self._skip, len(self._buffer))
            del self._buffer[:skipped]
            self._skip -= skipped
            if self._skip or len(self._buffer) < _HEADER.size:
                return
            (length,) = _HEADER.unpack_from(self._buffer)
            if length > self._limit:
                self._skip = _HEADER.size + length
                yield self._too_long(length)
                continue
            end = _HEADER.size + length
            if len(self._buffer) < end:
                return
            message = self._copy(_HEADER.size, end)
            del self._buffer[:end]
            yield message

    def _copy(self, begin: int, end: int) -> bytes:
        with memoryview(self._buffer) as view:
            return bytes(view[begin:end])

    def _too_long(self, length: int) -> WireError:
        return WireError(f"wanted a message of at most {self._limit} bytes, got {length} or more")
