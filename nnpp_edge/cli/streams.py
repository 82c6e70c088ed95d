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
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        own = getattr(sys, f"__{name}__")
        if getattr(sys, name) is own:  # as Python makes its own; characters that the encoding lacks are escaped
            raw = io.BufferedWriter(_Stream(descriptor, "w", closefd=False))
            encoding = own.encoding if own else None
            setattr(sys, name, io.TextIOWrapper(raw, encoding, "backslashreplace", line_buffering=True))


class _Stream(io.FileIO):
    """Takes everything, also what cannot be written; but stdout fails once: what is left in a buffer not again."""

    _failed = False

    def write(self, content: "io.ReadableBuffer", /) -> int:  # type: ignore[name-defined]
        try:
            return super().write(content) or 0
        except OSError as error:
            if self._failed or self.fileno() == 2:
                return len(memoryview(content).cast("B"))
            self._failed = True
            if isinstance(error, BrokenPipeError):  # nobody reads any more
                raise
            raise OutputError(f"standard output could not be written ({reason(error)})") from error
