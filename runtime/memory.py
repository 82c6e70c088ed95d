"""Memory that is there before it is needed, and how much there is.

The system backs an array's pages with memory when they are first written to. For a loop that is to keep its rate for
days this is the wrong moment: the first search that comes to a part of the map would wait, and what the process holds
would seem to grow.
"""

import mmap
import resource
import sys
from pathlib import Path

import numpy as np


def touch(*owners: object) -> None:
    """Write to every page of the arrays among these objects' attributes; their values stay.

    Read-only and strided arrays are left out.
    """
    for owner in owners:
        for value in vars(owner).values():
            if isinstance(value, np.ndarray) and value.flags.c_contiguous and value.flags.writeable:
                value.reshape(-1).view(np.uint8)[:: mmap.PAGESIZE] += 0


def free_bytes() -> int:
    """Memory that this process can still take: what the system has, within the limits of its user and its service."""
    free = [1024 * kilobytes for kilobytes in _figures("/proc/meminfo", "MemAvailable:")]
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    if soft != resource.RLIM_INFINITY:
        free += [soft - mmap.PAGESIZE * pages for pages in _figures("/proc/self/statm")]
    for line in _words("/proc/self/cgroup"):
        if line.startswith("0::"):
            group = "/sys/fs/cgroup" + line[3:]
            held = sum(_figures(f"{group}/memory.stat", "anon"))
            free += [most - held for most in _figures(f"{group}/memory.max")]
    return max(min(free, default=sys.maxsize), 0)


def _figures(path: str, name: str = "") -> list[int]:
    """The number after a name in one of the system's files, by default the first; none where there is none."""
    words = _words(path)
    try:
        return [int(words[words.index(name) + 1 if name else 0])]
    except (ValueError, IndexError):
        return []


def _words(path: str) -> list[str]:
    try:
        return Path(path).read_text().split()
    except OSError:
        return []
