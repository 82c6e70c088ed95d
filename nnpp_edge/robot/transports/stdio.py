"""Messages over standard input and output: for shell scripts, and for programs that start the loop
themselves.
"""

import io
import os
import sys
import threading
from collections.abc import Iterator
from typing import BinaryIO

from nnpp_edge.robot.transports.incoming import MailboxSource, Refusals
from nnpp_edge.robot.transports.wire import LIMIT_BYTES, encode
from nnpp_edge.robot.transports.wiring import Setup
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.loop.messages import Output
from nnpp_edge.runtime.loop.workers import CountError

_CHUNK = 1 << 16


def messages(stream: BinaryIO, limit: int = LIMIT_BYTES) -> Iterator[bytes]:
    """The lines of a stream, without blank ones; of each of more than `limit` bytes one more than
    these, as `decode` refuses it.
    """
    while line := stream.readline(limit + 1):
        if len(line) <= limit or line.endswith(b"\n"):
            line = line.strip()
        else:
            rest = line
            while rest and not rest.endswith(b"\n"):
                rest = stream.readline(_CHUNK)
        if line:
            yield line


class StdioSource(MailboxSource):
    """Reads messages, each a line, from a file descriptor in a thread of its own.

    If patches come faster than the loop reads them, reading pauses: the sender waits, and no patch
    is lost. Each message that is refused is added to `refusals`, and the next is read.
    """

    def __init__(self, count_error: CountError, *, descriptor: int = 0) -> None:
        super().__init__(count_error)
        os.set_blocking(descriptor, True)  # the parent process may have made it another
        stream = io.BufferedReader(io.FileIO(descriptor, closefd=False), _CHUNK)
        name = "nnpp-edge stdin"
        threading.Thread(target=self._read, args=[stream], name=name, daemon=True).start()

    @classmethod
    def open(cls, place: str, setup: Setup) -> "StdioSource":
        return cls(setup.navigator.count_error)

    def _read(self, stream: BinaryIO) -> None:
        with self._reading():
            for message in messages(stream, self.limit):
                self._take(message, "wait")
            self._mailbox.close()


class StdioSink:
    """Writes each answer as a line to a file descriptor; before it the refusals that wait
    for one.
    """

    name = "stdout"

    def __init__(self, refusals: Refusals | None = None, *, descriptor: int = 1) -> None:
        self._refusals = refusals
        os.set_blocking(descriptor, True)
        self._descriptor = descriptor
        self._broken = False

    @classmethod
    def open(cls, place: str, setup: Setup) -> "StdioSink":
        sys.stdout.flush()
        return cls(setup.source.refusals if isinstance(setup.source, StdioSource) else None)

    def publish(self, message: Output) -> None:
        """Write what waits and the answer. OutputError, once, if the reader has gone."""
        if self._broken:
            return
        faults = self._refusals.waiting() if self._refusals else []
        content = memoryview(b"".join(encode(each) + b"\n" for each in (*faults, message)))
        try:
            while content:
                content = content[os.write(self._descriptor, content) :]
        except BrokenPipeError as error:
            self._broken = True
            raise OutputError(
                "standard output was closed by its reader: nothing more is written to it"
            ) from error

    def close(self) -> None:
        """Leave standard output open."""
