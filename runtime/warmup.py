"""Compiling every kernel before the first plan: at install or at boot, rather than on the way.

What `exercises` compiles stays in the cache folder that `compiled` chose; what a wheel of kernels
or a read-only cache holds is not compiled. Several processes share the work: this one begins with
the first exercise, the others with the last, and none compiles what another is at; so do two
warm-ups at once.
"""

import os
import re
import shutil
import stat
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import msgspec

from nnpp_edge.runtime.compiled import cache, claims, places
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.exercises import exercise, parts
from nnpp_edge.runtime.memory import available_bytes

_FOLDER_NAME = re.compile(r"kernels-.+-[0-9a-f]{8}")
_STILL_IN_USE_S = 3600.0
"""A folder written to within this time may belong to a process that is still running: it is left
alone.
"""
_WATCH_S = 0.5
"""Between two counts of what is compiled."""
VERSIONS = 57
"""Of all kernels, which an empty cache gets: to tell how much of the work is done."""
MOST_JOBS = 4
JOB_BYTES = 700_000_000
"""Processes that compile at once unless told otherwise, and the memory that each is to find
free: measured were 0.90 GB by one, 0.63 and 0.60 by two, and 0.63 and at most 0.44 for each of
the others by four."""


@dataclass(frozen=True)
class Warmth:
    """The outcome of a warm-up."""

    folder: Path
    """Where compiled kernels are kept, or only read from."""
    kernels: int
    """Kernels there, and in other folders that are read."""
    signatures: int
    """Their versions, one for each set of argument types."""
    compiled: int
    """Versions that were compiled this time; the rest was there already."""
    seconds: float
    removed: tuple[Path, ...]
    """Folders of other versions that were deleted."""

    def summary(self) -> dict[str, object]:
        """Ready for JSON."""
        facts: dict[str, object] = msgspec.to_builtins(self, enc_hook=str)
        return facts | {"seconds": round(self.seconds, 3)}


def warm_up(
    *,
    keep_old: bool = False,
    jobs: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Warmth:
    """Compile every kernel into the cache folder; later processes load them from there.

    Parameters
    ----------
    keep_old : bool
        Leave the kernels of other versions where they are. Otherwise their folders are deleted, but
        for those written to within the last hour.
    jobs : int, optional
        Processes that compile at once; by default one for each processor that this one may use,
        four at most, as far as memory is left: one takes 0.9 GB, several about 0.6 each.
    progress : callable, optional
        Called from another thread, twice a second, with the number of versions that are kept.
        `VERSIONS` are all.

    Raises
    ------
    ValueError
        `jobs` is below 1.
    OutputError
        There is no folder to write to, or it cannot be written.
    """
    jobs = default_jobs() if jobs is None else jobs
    if jobs < 1:
        raise ValueError(f"jobs: wanted at least 1, got {jobs}")
    own = places.OWN
    folders = [*filter(None, [own]), *places.READ]
    if not folders:
        raise OutputError(
            "compiled kernels cannot be kept: wanted a folder that only this user can write to, "
            "found none (set NUMBA_CACHE_DIR to such a folder)"
        )
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "compiled kernels cannot be kept")  # an error below
            before = _kept(folders[0])
            shared = claims.shared(own) if own else nullcontext()
            helpers = _helpers(jobs if own else 1)
            with shared, helpers, _watched(folders[0], progress):
                exercise()
            compiled = len(_kept(folders[0]) - before)
        if cache.save_error is not None:
            raise cache.save_error
        removed = () if keep_old or own is None else _remove_old(own)
    except OSError as error:
        raise OutputError(
            f"{folders[0]}: kernels could not be kept ({error.strerror or error})"
        ) from error
    kernels, signatures = cache.count_kept(*folders)
    return Warmth(folders[0], kernels, signatures, compiled, time.perf_counter() - began, removed)


def default_jobs() -> int:
    """Processes that compile at once where nobody says how many."""
    return max(1, min(len(os.sched_getaffinity(0)), MOST_JOBS, available_bytes() // JOB_BYTES))


def _kept(folder: Path) -> set[tuple[str, int]]:
    """Name and age of every version's file."""
    return {(path.name, path.stat().st_mtime_ns) for path in folder.glob("*.nbc")}


@contextmanager
def _watched(folder: Path, progress: Callable[[int], None] | None) -> Iterator[None]:
    """Call `progress` with the number of versions in the folder while what is within runs."""
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(_WATCH_S):
            if progress is not None:
                progress(len(_kept(folder)))

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()


@contextmanager
def _helpers(jobs: int) -> Iterator[None]:
    """Have all but one of `jobs` processes compile as well, until what is within has ended.

    They only take work off this one: whatever becomes of them, it goes through every exercise
    itself.
    """
    code = "from nnpp_edge.runtime.warmup import help_out; help_out({}, {})"
    path = os.pathsep.join(filter(None, sys.path))
    helpers = [
        subprocess.Popen(
            [sys.executable, "-c", code.format(number, jobs)],
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for number in range(1, jobs)
    ]
    try:
        yield
    finally:
        for helper in helpers:
            helper.kill()
        for helper in helpers:
            helper.wait()


def help_out(number: int, jobs: int) -> None:
    """Go through the exercises from the end, as process `number` of `jobs`, each of which begins
    elsewhere.
    """
    assert places.OWN is not None
    with claims.shared(places.OWN):
        backwards = parts()[::-1]
        first = len(backwards) * (number - 1) // jobs
        for part in backwards[first:] + backwards[:first]:
            part()


def _remove_old(folder: Path) -> tuple[Path, ...]:
    """Delete what other versions left beside `folder`; what cannot be deleted stays."""
    removed = []
    for other in sorted(folder.parent.iterdir()):
        info = other.lstat()
        if (
            other != folder
            and stat.S_ISDIR(info.st_mode)
            and _FOLDER_NAME.fullmatch(other.name)
            and info.st_uid == os.geteuid()
            and time.time() - info.st_mtime >= _STILL_IN_USE_S
        ):
            shutil.rmtree(other, ignore_errors=True)
            if not other.exists():
                removed.append(other)
    return tuple(removed)
