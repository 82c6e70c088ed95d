"""Who compiles which version of a kernel, while several processes fill one folder.

Each version has a byte of the folder's file of claims, locked by the process that compiles it: another that needs the
same version waits for that byte, and then finds the version kept. The system unlocks what a process held when it
ends, however it ends. Without a system that locks, a version may be compiled twice, which does no harm.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # not on this system
    fcntl = None  # type: ignore[assignment]

_file: int | None = None


@contextmanager
def shared(folder: Path) -> Iterator[None]:
    """Within, this process compiles nothing for `folder` that another is compiling."""
    global _file
    if fcntl is None:
        yield
        return
    _file = os.open(folder / ".claims", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        yield
    finally:
        os.close(_file)
        _file = None


def take(digest: str) -> bool:
    """Wait until nobody else compiles the version with this hexadecimal digest; False where nothing is shared."""
    if _file is None:
        return False
    with suppress(OSError):  # a file system without locks
        fcntl.lockf(_file, fcntl.LOCK_EX, 1, _byte(digest))
    return True


def release(digest: str) -> None:
    """Let others have the version, which is kept or cannot be."""
    if _file is not None:
        with suppress(OSError):
            fcntl.lockf(_file, fcntl.LOCK_UN, 1, _byte(digest))


def _byte(digest: str) -> int:
    return int(digest[:15], 16)
