"""A line for the user, from code that must not print by itself: once something has taken
a second.
"""

import functools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

tell: Callable[[str], None] | None = None
"""Where lines go. A program with somebody before it sets this."""
AFTER_S = 1.0


@functools.cache
def say_once(line: str) -> None:
    """Tell this, unless it was said before in this process."""
    if tell is not None:
        tell(line)


def begins(line: str) -> threading.Timer:
    """Tell this once in a second, unless what is returned is cancelled before."""
    timer = threading.Timer(AFTER_S, say_once, (line,))
    timer.daemon = True
    if tell is not None:
        timer.start()
    return timer


@contextmanager
def told_if_slow(line: str) -> Iterator[None]:
    """Tell this if what is within takes more than a second."""
    timer = begins(line)
    try:
        yield
    finally:
        timer.cancel()
