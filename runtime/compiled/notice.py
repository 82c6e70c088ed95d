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
    """Tell this once what is within has taken a second, and again after 2, 4, 8… with the time."""
    done = threading.Event()

    def watch(tell: Callable[[str], None]) -> None:
        elapsed_s = AFTER_S
        wait_s = AFTER_S
        while not done.wait(wait_s):
            tell(line if elapsed_s == AFTER_S else f"{line}: {elapsed_s:g} s so far")
            wait_s = elapsed_s
            elapsed_s *= 2.0

    if tell is not None:
        threading.Thread(target=watch, args=(tell,), daemon=True).start()
    try:
        yield
    finally:
        done.set()
