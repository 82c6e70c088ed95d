"""Services of the operating system to the loop: cores, priority, signals, an interruptible sleep, memory in use."""

import logging
import os
import select
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

Handler = Callable[[int, FrameType | None], None] | signal.Handlers

_LOG = logging.getLogger(__name__)
_TURN_S = 0.0005
"""Longest that a tick waits each time for another thread of Python; by default ten times as long. Beside 80,000
refused inputs a second the 99th percentile of a tick fell from 16 to 6–10 ms."""


class InterruptibleSleep:
    """A sleep that another thread or a signal handler ends. An Event's lock is not safe in handlers; a pipe is."""

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)

    def wait(self, seconds: float) -> bool:
        """Sleep for so long, an hour at most; True if woken."""
        return bool(select.select([self._read], [], [], min(seconds, 3600.0))[0])

    def set(self) -> None:
        """End this sleep and all that follow."""
        with suppress(BlockingIOError):
            os.write(self._write, b"!")

    def __del__(self) -> None:
        with suppress(OSError, AttributeError):
            os.close(self._read)
            os.close(self._write)


def be_realtime(cores: Sequence[int], priority: int) -> Callable[[], None]:
    """Let threads take turns more often, pin this one, raise its priority, as far as is allowed; how to undo it."""
    turn_s = sys.getswitchinterval()
    sys.setswitchinterval(_TURN_S)
    undo: list[Callable[[], object]] = [lambda: sys.setswitchinterval(turn_s)]
    if cores:
        try:
            before = os.sched_getaffinity(0)
            os.sched_setaffinity(0, cores)
            undo.append(lambda: os.sched_setaffinity(0, before))
        except (OSError, ValueError, OverflowError) as error:
            _LOG.warning("the loop is not pinned to cores %s: %s", list(cores), error)
    if priority:
        try:
            policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            undo.append(lambda: os.sched_setscheduler(0, policy, parameters))
        except (OSError, ValueError, OverflowError) as error:
            _LOG.warning("the loop does not run under SCHED_FIFO %d: %s", priority, error)

    def restore() -> None:
        for step in reversed(undo):
            with suppress(OSError):
                step()

    return restore


@contextmanager
def signal_handlers(handlers: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """Handle signals so for a while. For the main thread."""
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def rss_bytes() -> int:
    """Resident memory of this process; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0
