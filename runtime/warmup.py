"""Compiling every kernel before the first plan: at install or at boot, rather than on the way.

What `exercises` compiles stays in the cache folder that `compiled` chose; what a wheel of kernels
or a read-only cache holds is not compiled. Several processes share the work: this one begins with
the first exercise, the others with the last, and none compiles what another is at; so do two
warm-ups at once.
"""

import os
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import msgspec

from nnpp_edge.runtime.compiled import cache, claims, places
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.exercises import exercise, parts
from nnpp_edge.runtime.memory import available_bytes

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

    def summary(self) -> dict[str, object]:
        """Ready for JSON."""
        facts: dict[str, object] = msgspec.to_builtins(self, enc_hook=str)
        return facts | {"seconds": round(self.seconds, 3)}


def warm_up(jobs: int | None = None) -> Warmth:
    """Compile every kernel into the cache folder; later processes load them from there.

    Parameters
    ----------
    jobs : int, optional
        Processes that compile at once; by default one for each processor that this one may use,
        four at most, as far as memory is left: one takes 0.9 GB, several about 0.6 each.

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
            with shared, helpers:
                exercise()
            compiled = len(_kept(folders[0]) - before)
        if cache.save_error is not None:
            raise cache.save_error
    except OSError as error:
        raise OutputError(
            f"{folders[0]}: kernels could not be kept ({error.strerror or error})"
        ) from error
    kernels, signatures = cache.count_kept(*folders)
    return Warmth(folders[0], kernels, signatures, compiled, time.perf_counter() - began)


def default_jobs() -> int:
    """Processes that compile at once where nobody says how many."""
    return max(1, min(len(os.sched_getaffinity(0)), MOST_JOBS, available_bytes() // JOB_BYTES))


def _kept(folder: Path) -> set[tuple[str, int]]:
    """Name and age of every version's file."""
    return {(path.name, path.stat().st_mtime_ns) for path in folder.glob("*.nbc")}


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
