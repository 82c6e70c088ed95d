"""Memory: how much is left, what planning takes, and how to have it before it is needed, or not
before.

The system backs an array's pages with memory when they are first written to. In a loop that is to
keep its rate for days, the first search that comes to a part of the map would wait, and the process
would seem to grow.
"""

import ctypes
import itertools
import math
import mmap
import os
import resource
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import InvalidMapError

DIRECTED_BYTES_PER_CELL = 38
"""More where steps cost by the slope: eight costs 32, those of coarse levels 6."""
PLANNER_BYTES_PER_CELL = 16
"""That a planner takes beside the cost map: weights 4, search memory 8, coarse levels 4."""
_ALWAYS_FITS = 1 << 22
"""Cells of a map that is planned on without asking for room first: that takes as long as a short
plan.
"""
MOST_CELLS = 2_000_000_000
"""Of a map: cells within its border have numbers of 32 bits."""
_MAP_NORESERVE = 0x4000
"""Of Linux; Python's `mmap` has it from 3.13 on."""
_PR_SET_THP_DISABLE = 41
Number = TypeVar("Number", bound=np.generic)


def touch(*owners: object) -> None:
    """Write to every page of these objects' arrays, but for read-only and strided ones; their
    values stay.
    """
    for owner in owners:
        for value in vars(owner).values():
            if isinstance(value, np.ndarray) and value.flags.c_contiguous and value.flags.writeable:
                value.reshape(-1).view(np.uint8)[:: mmap.PAGESIZE] += 0


def virtual_zeros(count: int, dtype: type[Number]) -> NDArray[Number]:
    """Zeros that take memory where they are written to, a small page at a time, and nowhere else.

    For arrays of a whole map's size of which a search touches a strip. MemoryError where the system
    promises no memory that it does not have.
    """
    size = count * np.dtype(dtype).itemsize
    try:
        memory = mmap.mmap(-1, size, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _MAP_NORESERVE)
    except OSError as error:
        raise MemoryError(f"{size / 1e9:.1f} GB of address space are not available") from error
    with suppress(AttributeError, OSError):  # a system without huge pages
        memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype, count)


@contextmanager
def small_pages() -> Iterator[None]:
    """Have the system back this process's arrays with small pages for a while: where a strip of
    one is touched, a huge page of 2 MiB would bring the rows beside it along."""
    prctl = getattr(ctypes.CDLL(None), "prctl", None)  # not on every system
    if prctl:
        prctl(_PR_SET_THP_DISABLE, 1, 0, 0, 0)
    try:
        yield
    finally:
        if prctl:
            prctl(_PR_SET_THP_DISABLE, 0, 0, 0, 0)


def filed_zeros(shape: tuple[int, ...], dtype: type[Number]) -> NDArray[Number]:
    """Zeros in a temporary file that has no name: of a map larger than memory, whose pages the
    system writes there and drops where it needs the room. OSError where the disk has none.
    """
    with tempfile.TemporaryFile() as file:
        # else a disk that is full would be met when a page is written, which ends the process
        os.posix_fallocate(file.fileno(), 0, math.prod(shape) * np.dtype(dtype).itemsize)
        return np.asarray(np.memmap(file, dtype, "w+", shape=shape))


def is_filed(array: object) -> bool:
    """Whether an array lies in a file and what is written to it there, as from `filed_zeros`."""
    while isinstance(array, np.ndarray):
        if isinstance(array, np.memmap):
            return bool(array.mode != "c")
        array = array.base
    return False


def release(array: NDArray[Number], count: int) -> None:
    """Give the pages of an array's first elements back to the system: of one from `virtual_zeros`,
    which are 0 then, or from `filed_zeros`, which stay in the file.
    """
    whole_pages = count * array.itemsize // mmap.PAGESIZE * mmap.PAGESIZE
    mapping_of(array).madvise(mmap.MADV_DONTNEED, 0, whole_pages)


def mapping_of(array: NDArray[Number]) -> mmap.mmap:
    """The pages that an array from `virtual_zeros` or `filed_zeros` lies in."""
    owner: object = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    mapping = owner.obj if isinstance(owner, memoryview) else owner
    assert isinstance(mapping, mmap.mmap)
    return mapping


def check_planner_fits(
    shape: tuple[int, int], more_per_cell: int = 0, *, filed: bool = False
) -> None:
    """InvalidMapError where the memory that is left cannot hold a planner of a map of this shape,
    unless that lies in a file, or where it has more cells than have numbers.

    `more_per_cell` are bytes beside those of a point's planner. All that is reserved counts: a
    search takes it where it first comes, and one of the whole map takes all of it.
    """
    cells = math.prod(shape)
    if cells <= _ALWAYS_FITS:
        return
    if cells > MOST_CELLS:
        raise InvalidMapError(f"wanted a map of at most {MOST_CELLS} cells, got {shape}")
    if filed:
        return
    wanted = cells * (PLANNER_BYTES_PER_CELL + more_per_cell)
    room = available_bytes()
    if wanted > room:
        raise InvalidMapError(
            f"wanted {wanted / 1e9:.1f} GB of memory to plan on {shape[0]} × {shape[1]} cells, "
            f"got {room / 1e9:.1f} GB: plan on a smaller part"
        )


def peak_bytes(process: int | str = "self") -> int:
    """The most memory that a process, by its number, has held at once; 0 where the system does not
    say.
    """
    return _held_bytes(process, "VmHWM:")


def rss_bytes() -> int:
    """Resident memory of this process; 0 where the system does not say."""
    return _held_bytes("self", "VmRSS:")


def available_bytes(system: Path = Path("/")) -> int:
    """Memory that this process may still take: the least of what machine, control groups and its
    own limit leave.

    `system` is where the system's own files lie, ``/proc`` and ``/sys``.
    """
    found = [1024 * free for free in _numbers(system / "proc/meminfo", "MemAvailable:")]
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        found.append(limit - next(_numbers(Path("/proc/self/statm"))) * mmap.PAGESIZE)
    return max(0, min([*found, *_left_in_groups(system)], default=1 << 62))


def _left_in_groups(system: Path) -> Iterator[int]:
    """Memory that each control group around this process leaves; pages of files that can be dropped
    are free.
    """
    for _, kind, name in (line.split(":", 2) for line in _lines(system / "proc/self/cgroup")):
        root = system / "sys/fs/cgroup"
        files = ("memory.max", "memory.current", "inactive_file ")
        if "memory" in kind.split(","):
            # version 1; from within a container, the name may be that outside of it
            root /= "memory"
            files = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file ")
        elif kind:
            continue
        group = root / name.lstrip("/")
        for folder in (each for each in (group, *group.parents) if each.is_relative_to(root)):
            limit, used = (next(_numbers(folder / file), None) for file in files[:2])
            if limit is not None and used is not None:
                yield limit - used + sum(_numbers(folder / "memory.stat", files[2]))


def _held_bytes(process: int | str, entry: str) -> int:
    """An entry, in kB, of a process's status."""
    return 1024 * next(_numbers(Path(f"/proc/{process}/status"), entry), 0)


def _lines(path: Path) -> list[str]:
    """A file of the system, line by line; nothing where it is not there."""
    try:
        return path.read_text().splitlines()
    except OSError:
        return []


def _numbers(path: Path, start: str = "") -> Iterator[int]:
    """The first number, where there is one, in each line of a system's file that begins so."""
    for line in _lines(path):
        if line.startswith(start):
            yield from itertools.islice((int(word) for word in line.split() if word.isdecimal()), 1)
