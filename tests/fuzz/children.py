"""Work done in a forked process under limits of time and memory, and what became of it.

A fork of a process that has loaded everything costs milliseconds where a fresh interpreter costs a second. The
process that forks must have no threads of its own.
"""

import contextlib
import faulthandler
import mmap
import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

GRACE_S = 15.0  # a process that is interrupted has so long to end
MOST_READ = 4 << 20  # bytes that are kept of each stream


@dataclass(frozen=True)
class Limits:
    """What a process may take: time, processor time, address space beyond the parent's, bytes of a file it writes.

    `wall_s` is wide, as other programs run on the machine too. A low `file_bytes` plays a full disk.
    """

    wall_s: float = 60.0
    cpu_s: int = 25
    memory_bytes: int = 2 << 30
    file_bytes: int = 256 << 20


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    `code` is below 0 for the signal that killed it, `peak_bytes` counts from what it began with, `late` tells which
    limit of time it passed, and where it then was, and `interrupted` that it ended by itself once it was interrupted.
    """

    code: int
    out: bytes = b""
    err: bytes = b""
    wall_s: float = 0.0
    peak_bytes: int = 0
    late: str = ""
    interrupted: bool = False


def run_forked(
    work: Callable[[], int],
    limits: Limits,
    *,
    streams: tuple[str, str, str] = ("null", "pipe", "pipe"),
    stdin: bytes = b"",
    trace: Path | None = None,
) -> Ended:
    """Let a fork do `work`, whose value is the exit code.

    Parameters
    ----------
    streams : (str, str, str)
        What stdin, stdout and stderr are: ``null``, ``pipe``, ``closed``, ``full`` (a device without room) or
        ``broken`` (a pipe that nobody reads). What comes through pipes is returned; `stdin` goes into one.
    trace : Path
        File for the stacks of a process that passes its limit of time.
    """
    base = mmap.mmap(-1, 8)  # shared with the fork
    pipes = {n: os.pipe() for n in range(3) if streams[n] == "pipe"}
    if 0 in pipes:
        os.set_blocking(pipes[0][1], False)
        with contextlib.suppress(BlockingIOError):  # at most what fits without a reader
            os.write(pipes[0][1], stdin[: 1 << 16])
    sys.stdout.flush()
    sys.stderr.flush()
    began = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _child(work, limits, base, streams, pipes, trace)
    for end in [pipes[n][n > 0] for n in pipes] + ([pipes[0][1]] if 0 in pipes else []):
        os.close(end)
    return _watch(pid, began, limits, {read: n for n, (read, _) in pipes.items() if n}, base, trace)


def _child(
    work: Callable[[], int],
    limits: Limits,
    base: mmap.mmap,
    streams: tuple[str, str, str],
    pipes: dict[int, tuple[int, int]],
    trace: Path | None,
) -> None:
    """The forked process; never returns."""
    code = 70
    try:
        base[:] = _status_bytes("VmRSS:").to_bytes(8, "little")
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if trace is not None:
            faulthandler.register(signal.SIGUSR2, file=trace.open("wb"), all_threads=True)
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
    for end in {*kept.values(), *ends.values(), *(end for pair in pipes.values() for end in pair)} - {0, 1, 2}:
        os.close(end)

    def stream(n: int, mode: str) -> Any:
        errors = "backslashreplace" if n == 2 else "strict"
        return open(n, mode, encoding="utf-8", errors=errors, closefd=False) if n in ends else None

    sys.stdin, sys.stdout, sys.stderr = stream(0, "r"), stream(1, "w"), stream(2, "w")
    sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr  # type: ignore[misc]


def _watch(
    pid: int, began: float, limits: Limits, readers: dict[int, int], base: mmap.mmap, trace: Path | None
) -> Ended:
    """Read what a process writes until it ends; interrupt it, then kill it, when it is late."""
    content = {n: bytearray() for n in (1, 2)}
    late, interrupted_at, found = "", 0.0, 0

    def read(patience_s: float) -> bool:
        ready = select.select(list(readers), [], [], patience_s)[0]
        for end in ready:
            chunk = os.read(end, 1 << 16)
            content[readers[end]] += chunk[: MOST_READ - len(content[readers[end]])]
            if not chunk:
                os.close(end)
                del readers[end]
        return bool(ready)

    while not found:
        read(0.002)
        found, status, usage = os.wait4(pid, os.WNOHANG)
        now = time.monotonic()
        if not found and not late and now - began > limits.wall_s:
            late, interrupted_at = f"it took more than {limits.wall_s:g} s", now
            if trace is not None:
                os.kill(pid, signal.SIGUSR2)
                time.sleep(0.2)
            os.kill(pid, signal.SIGINT)
        elif not found and late and now - interrupted_at > GRACE_S:
            os.killpg(pid, signal.SIGKILL)
            late += " and did not end when it was interrupted"
            interrupted_at = float("inf")
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # what it started and left behind
    while read(0.0):
        pass
    for end in readers:
        os.close(end)
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGXCPU:
        late = f"it took more than {limits.cpu_s} s of processor time"
    if late and trace is not None and trace.exists():
        late += "\n" + trace.read_text(errors="replace")[-3000:]
    peak = max(usage.ru_maxrss * 1024 - int.from_bytes(base[:], "little"), 0)
    by_itself = 0.0 < interrupted_at < float("inf") and code >= 0
    took = time.monotonic() - began
    return Ended(code, bytes(content[1]), bytes(content[2]), took, peak, late, interrupted=by_itself)


def _status_bytes(name: str) -> int:
    with open("/proc/self/status") as file:  # noqa: PTH123
        return next(int(line.split()[1]) * 1024 for line in file if line.startswith(name))
