"""Work done in a forked process under limits of time and memory, and what became of it.

A fork of a process that has loaded everything costs milliseconds where a fresh interpreter costs a
second. The process that forks must have no threads of its own.
"""

import contextlib
import mmap
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

FORK = multiprocessing.get_context("fork")
GRACE_S = 15.0  # a process that is interrupted has so long to end
MOST_READ = 4 << 20  # bytes that are kept of each stream


@dataclass(frozen=True)
class Limits:
    """What a process may take: time, processor time, address space beyond the parent's, bytes of a
    file it writes.

    `wall_s` is wide, as other programs run on the machine too. A low `file_bytes` plays a full
    disk.
    """

    wall_s: float = 60.0
    cpu_s: int = 25
    memory_bytes: int = 2 << 30
    file_bytes: int = 256 << 20


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    `code` is below 0 for the signal that killed it, `peak_bytes` counts from what it began with,
    `late` tells which limit of time it passed, and `interrupted` that it ended by itself once it
    was interrupted.
    """

    code: int
    out: bytes
    err: bytes
    wall_s: float
    peak_bytes: int
    late: str
    interrupted: bool


def run_forked(
    work: Callable[[], int],
    limits: Limits,
    *,
    streams: tuple[str, str, str] = ("null", "pipe", "pipe"),
    stdin: bytes = b"",
) -> Ended:
    """Let a fork do `work`, whose value is the exit code; interrupt it, then kill it, when it is
    late.

    `streams` are what stdin, stdout and stderr are: ``null``, ``pipe``, ``closed``, ``full`` (a
    device without room) or ``broken`` (a pipe that nobody reads). What comes through pipes is
    returned; `stdin` goes into one.
    """
    # shared with the fork
    peak = mmap.mmap(-1, 8)
    content = {}
    pipes = {n: os.pipe() for n in range(3) if streams[n] == "pipe"}
    sys.stdout.flush()
    sys.stderr.flush()
    child = FORK.Process(target=_child, args=(work, limits, peak, streams, pipes))
    began = time.monotonic()
    child.start()
    for n, pair in pipes.items():
        os.close(pair[n > 0])
    if 0 in pipes:
        with contextlib.suppress(BrokenPipeError), os.fdopen(pipes[0][1], "wb", buffering=0) as end:
            end.write(stdin[: 1 << 16])  # at most what fits without a reader

    def read(n: int) -> None:
        with os.fdopen(pipes[n][0], "rb") as end:
            content[n] = end.read(MOST_READ)
            while end.read(1 << 20):
                pass

    readers = [threading.Thread(target=read, args=(n,)) for n in pipes if n]
    for reader in readers:
        reader.start()
    child.join(limits.wall_s)
    late = f"it took more than {limits.wall_s:g} s" if child.is_alive() else ""
    if late:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child.pid or 0, signal.SIGINT)
        child.join(GRACE_S)
    in_time = not child.is_alive()
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child.pid or 0, signal.SIGKILL)  # it, or what it started and left behind
    for thread in (child, *readers):
        thread.join()
    code = child.exitcode or 0
    if code == -signal.SIGXCPU:
        late = f"it took more than {limits.cpu_s} s of processor time"
    took = time.monotonic() - began
    by_itself = bool(late) and in_time and code >= 0
    grown = int.from_bytes(peak[:], "little")
    return Ended(code, content.get(1, b""), content.get(2, b""), took, grown, late, by_itself)


def _child(
    work: Callable[[], int],
    limits: Limits,
    peak: mmap.mmap,
    streams: tuple[str, str, str],
    pipes: dict[int, tuple[int, int]],
) -> None:
    """The forked process; never returns."""
    code = 70
    base = _status_bytes("VmRSS:")
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        space = _status_bytes("VmSize:") + limits.memory_bytes
        for name, least, most in (
            (resource.RLIMIT_CORE, 0, 0),
            (resource.RLIMIT_CPU, limits.cpu_s, limits.cpu_s + 5),
            (resource.RLIMIT_AS, space, space),
            (resource.RLIMIT_FSIZE, limits.file_bytes, limits.file_bytes),
        ):
            resource.setrlimit(name, (least, most))
        _connect(streams, pipes)
        code = work()
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):
                stream.flush()
    except BaseException:
        with contextlib.suppress(BaseException):
            os.write(2, traceback.format_exc().encode("utf-8", "replace"))
    finally:
        grown = max(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - base, 0)
        peak[:] = grown.to_bytes(8, "little")
        os._exit(code & 0xFF)


def _connect(streams: tuple[str, str, str], pipes: dict[int, tuple[int, int]]) -> None:
    """Make the standard streams what they are to be, for Python and for libraries in C."""
    ends: dict[int, int] = {n: pair[n > 0] for n, pair in pipes.items()}
    for n, kind in enumerate(streams):
        if kind == "broken":
            read, ends[n] = os.pipe()
            os.close(read)
        elif kind in ("full", "null"):
            ends[n] = os.open("/dev/full" if kind == "full" else "/dev/null", os.O_RDWR)
    kept = {n: os.dup(end) for n, end in ends.items()}  # above 2, whatever is closed
    for n in range(3):
        with contextlib.suppress(OSError):
            os.close(n)
        if n in kept:
            os.dup2(kept[n], n)
    for end in {
        *kept.values(),
        *ends.values(),
        *(end for pair in pipes.values() for end in pair),
    } - {0, 1, 2}:
        os.close(end)

    def stream(n: int, mode: str) -> Any:
        errors = "backslashreplace" if n == 2 else "strict"
        return open(n, mode, encoding="utf-8", errors=errors, closefd=False) if n in ends else None

    sys.stdin = stream(0, "r")
    sys.stdout = stream(1, "w")
    sys.stderr = stream(2, "w")
    sys.__stdin__ = sys.stdin  # type: ignore[misc]
    sys.__stdout__ = sys.stdout  # type: ignore[misc]
    sys.__stderr__ = sys.stderr  # type: ignore[misc]


def _status_bytes(name: str) -> int:
    with open("/proc/self/status") as file:  # noqa: PTH123
        return next(int(line.split()[1]) * 1024 for line in file if line.startswith(name))
