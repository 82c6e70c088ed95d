"""Memory: how much is left, and how to have it before it is needed.

The system backs an array's pages with memory when they are first written to. For a loop that is to keep its rate for
days this is the wrong moment: the first search that comes to a part of the map would wait, and what the process holds
would seem to grow.
"""

import mmap
import resource
from collections.abc import Iterator
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


def available_bytes() -> int:
    """Memory that this process may still take: the least of what machine, control groups and its own limit leave."""
    found = [_number(line) * 1024 for line in _lines(Path("/proc/meminfo")) if line.startswith("MemAvailable:")]
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        found.append(limit - _number(_lines(Path("/proc/self/statm"))[0]) * mmap.PAGESIZE)
    return max(0, min([*found, *_left_in_groups()], default=1 << 62))


def _left_in_groups() -> Iterator[int]:
    """What each control group around this process leaves: pages of files that can be dropped count as free."""
    root = Path("/sys/fs/cgroup")
    group = root / next((line[4:] for line in _lines(Path("/proc/self/cgroup")) if line.startswith("0::/")), "")
    for folder in (group, *group.parents):
        if root not in (folder, *folder.parents):
            return
        limit, used = _lines(folder / "memory.max"), _lines(folder / "memory.current")
        if limit and used and limit[0].isdecimal():
            files = [_number(line) for line in _lines(folder / "memory.stat") if line.startswith("inactive_file ")]
            yield int(limit[0]) - int(used[0]) + sum(files)


def _lines(path: Path) -> list[str]:
    """A file of the system, line by line; nothing where it is not there."""
    try:
        return path.read_text().splitlines()
    except OSError:
        return []


def _number(line: str) -> int:
    """The first number in a line."""
    return next(int(word) for word in line.split() if word.isdecimal())
