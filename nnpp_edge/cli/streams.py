"""Standard streams that may be closed or full: what is lost on stderr ends nothing, on stdout it is an error."""

import io
import os
import sys

from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.reading import reason


def prepare_streams() -> None:
    """Open what is closed, and replace stdout and stderr by streams whose failures do no harm.

    A closed one would give its number to the next file that is opened, and what a library prints would end in there.
    Streams that a test or another program has put in their place stay.
    """
    for descriptor, mode in ((0, os.O_RDONLY), (1, os.O_RDONLY), (2, os.O_WRONLY)):  # writing to 1 then fails
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, mode)  # gets the lowest number that is free
    if sys.stdout is sys.__stdout__:
        sys.stdout = _text(_Stdout(1, "w", closefd=False))
    if sys.stderr is sys.__stderr__:
        sys.stderr = _text(_Stderr(2, "w", closefd=False))


class _Stderr(io.FileIO):
    """Takes everything, also what cannot be written."""

    def write(self, content: "io.ReadableBuffer", /) -> int:  # type: ignore[name-defined]
        """Write, or do as if."""
        try:
            return super().write(content) or 0
        except OSError:
            return len(memoryview(content).cast("B"))


class _Stdout(io.FileIO):
    """Fails with an OutputError, once: what is left in a buffer fails no second time."""

    _failed = False

    def write(self, content: "io.ReadableBuffer", /) -> int:  # type: ignore[name-defined]
        """Write; OutputError the first time that fails, BrokenPipeError where nobody reads any more."""
        if self._failed:
            return len(memoryview(content).cast("B"))
        try:
            return super().write(content) or 0
        except OSError as error:
            self._failed = True
            if isinstance(error, BrokenPipeError):
                raise
            raise OutputError(f"standard output could not be written ({reason(error)})") from error


def _text(raw: io.FileIO) -> io.TextIOWrapper:
    """As Python makes its own streams; characters that the encoding lacks are escaped."""
    buffered = io.BufferedWriter(raw)
    encoding = sys.__stderr__.encoding if sys.__stderr__ else None
    return io.TextIOWrapper(buffered, encoding, "backslashreplace", line_buffering=True)
