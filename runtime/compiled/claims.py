"""Who compiles which version of a kernel, while several processes fill one folder.

Each version has a byte of the folder's file of claims, locked by the process that compiles it:
another that needs the same version waits for that byte, and then finds the version kept. The system
unlocks what a process held when it ends, however it ends. On a file system without locks a version
may be compiled twice, which does no harm.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_file: int | None = None


@contextmanager
def shared(folder: Path) -> Iterator[None]:
    """Within, this process compiles nothing for `folder` that another is compiling."""
    global _file
    _file = os.open(
        folder / ".claims", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600
    )
    try:
        yield
    finally:
        os.close(_file)
        _file = None


def take(digest: str) -> None:
    """Wait until no other process compiles the version with this hexadecimal digest."""
    _lock(fcntl.LOCK_EX, digest)


def release(digest: str) -> None:
    """Let others have the version, which is kept or cannot be."""
    _lock(fcntl.LOCK_UN, digest)


def _lock(how: int, digest: str) -> None:
    """As the system does; nothing where nothing is shared."""
    if _file is not None:
        with suppress(OSError):  # a file system without locks
            fcntl.lockf(_file, how, 1, int(digest[:15], 16))
