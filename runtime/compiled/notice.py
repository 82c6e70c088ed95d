"""A line for whoever waits, from code that must not print by itself."""

import functools
from collections.abc import Callable

tell: Callable[[str], None] | None = None
"""Where lines go. A program with somebody before it sets this."""


@functools.cache
def say_once(line: str) -> None:
    """Tell this, unless it was said before in this process."""
    if tell is not None:
        tell(line)
