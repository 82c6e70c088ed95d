"""Ctrl-C while a kernel is read from its file: it waits until the kernel is whole.

numba's tables would else be left with half of what belongs together, and a later call fail.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class _Held:
    """What is to happen, and what has come meanwhile."""

    def __init__(self) -> None:
        self.handler = signal.getsignal(signal.SIGINT)
        self.came: list[FrameType | None] = []
        signal.signal(signal.SIGINT, lambda number, frame: self.came.append(frame))

    def let_go(self) -> None:
        """Handle what came."""
        signal.signal(signal.SIGINT, self.handler)
        if self.came and callable(self.handler):
            self.handler(signal.SIGINT, self.came[0])


_held: list[_Held] = []


@contextmanager
def waiting() -> Iterator[None]:
    """Within, SIGINT waits for the end, or for `come`."""
    in_main = threading.current_thread() is threading.main_thread()
    # only the main thread is interrupted; a handler that Python does not know cannot be put back
    if not in_main or _held or signal.getsignal(signal.SIGINT) is None:
        yield
        return
    _held.append(_Held())
    try:
        yield
    finally:
        come()


def come() -> None:
    """SIGINT waits no longer: what follows takes long."""
    if threading.current_thread() is threading.main_thread():
        while _held:
            _held.pop().let_go()
