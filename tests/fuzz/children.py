"""Work done in a forked process under limits of time and memory, and what became of it.

A fork of a process that has loaded everything costs milliseconds where a fresh interpreter costs a second. The
process that forks must have no threads of its own: `threads` counts them.
"""

import contextlib
import mmap
import os
import resource
import selectors
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

GRACE_S = 15.0
"""A process that is interrupted has so long to end."""


@dataclass(frozen=True)
class Limits:
    """What a process may take."""

    wall_s: float = 60.0
    """Wide, as other programs run on the machine too: it finds what waits for ever."""
    cpu_s: int = 25
    """Processor time; it finds what computes for ever."""
    memory_bytes: int = 2 << 30
    """Address space beyond the parent's: more is refused to it."""
    file_bytes: int = 256 << 20
    """Size of a file that it may write; less plays a full disk."""


@dataclass(frozen=True)
class Ended:
    """How a process ended."""

    code: int
    """Exit code; below 0, the signal that killed it."""
    out: bytes = b""
    err: bytes = b""
    wall_s: float = 0.0
    peak_bytes: int = 0
    """Memory beyond what it began with, at most."""
    late: str = ""
    """Which limit of time it passed, and where it then was; empty if none."""
    interrupted: bool = False
    """It passed the limit, and ended by itself once it was interrupted."""


def threads() -> int:
    """Threads of this process, those of libraries too."""
    return len(list(Path("/proc/self/task").iterdir()))


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
    space = _address_bytes() + limits.memory_bytes
    pipes = {n: os.pipe() for n in range(3) if streams[n] == "pipe"}
    if 0 in pipes and stdin:
        _fill(pipes[0][1], stdin)
    sys.stdout.flush()
    sys.stderr.flush()
    began = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _child(work, limits, space, base, streams, pipes, trace)
    for n, (read, write) in pipes.items():
        os.close(read if n == 0 else write)
    if 0 in pipes:
        os.close(pipes[0][1])
    return _watch(pid, began, limits, {n: read for n, (read, _) in pipes.items() if n}, base, trace)


def _fill(descriptor: int, content: bytes) -> None:
    """Put bytes into a pipe, at most what fits without a reader."""
    os.set_blocking(descriptor, False)
    with contextlib.suppress(BlockingIOError):
        os.write(descriptor, content[: 1 << 16])


def _child(
    work: Callable[[], int],
    limits: Limits,
    space: int,
    base: mmap.mmap,
    streams: tuple[str, str, str],
    pipes: dict[int, tuple[int, int]],
    trace: Path | None,
) -> None:
    """The forked process; never returns."""
    code = 70
    try:
        base[:] = _resident_bytes().to_bytes(8, "little")
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if trace is not None:
            import faulthandler

            faulthandler.register(signal.SIGUSR2, file=trace.open("wb"), all_threads=True)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (limits.cpu_s, limits.cpu_s + 5))
        resource.setrlimit(resource.RLIMIT_AS, (space, space))
        resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_bytes, limits.file_bytes))
        _connect(streams, pipes)
        code = work()
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                with contextlib.suppress(OSError, ValueError):
                    stream.flush()
    except BaseException:
        import traceback

        with contextlib.suppress(BaseException):
            os.write(2, traceback.format_exc().encode("utf-8", "replace"))
    finally:
        os._exit(code & 0xFF)


def _connect(streams: tuple[str, str, str], pipes: dict[int, tuple[int, int]]) -> None:
    """Make the standard streams what they are to be, for Python and for libraries in C."""
    ends: list[int | None] = []
    for n, kind in enumerate(streams):
        if kind == "pipe":
            ends.append(pipes[n][0 if n == 0 else 1])
        elif kind == "broken":
            read, write = os.pipe()
            os.close(read)
            ends.append(write)
        else:
            device = "/dev/full" if kind == "full" else "/dev/null"
            ends.append(None if kind == "closed" else os.open(device, os.O_RDWR))
    for n, end in enumerate(ends):
        if end is None:
            with contextlib.suppress(OSError):
                os.close(n)
        elif end != n:
            os.dup2(end, n)
    for end in {end for end in ends if end is not None and end > 2} | {e for pair in pipes.values() for e in pair}:
        with contextlib.suppress(OSError):
            os.close(end)

    def stream(n: int, mode: str) -> Any:
        if streams[n] == "closed":
            return None
        errors = "backslashreplace" if n == 2 else "strict"
        return open(n, mode, encoding="utf-8", errors=errors, closefd=False)

    sys.stdin, sys.stdout, sys.stderr = stream(0, "r"), stream(1, "w"), stream(2, "w")
    sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr  # type: ignore[misc]


def _watch(
    pid: int, began: float, limits: Limits, readers: dict[int, int], base: mmap.mmap, trace: Path | None
) -> Ended:
    """Read what a process writes until it ends; interrupt it, then kill it, when it is late."""
    content: dict[int, bytearray] = {1: bytearray(), 2: bytearray()}
    late, interrupted_at, status, usage = "", 0.0, 0, None
    with selectors.DefaultSelector() as selector:
        for n, read in readers.items():
            os.set_blocking(read, False)
            selector.register(read, selectors.EVENT_READ, n)
        while True:
            _drain(selector, content, 0.002)
            found, status, usage = os.wait4(pid, os.WNOHANG)
            if found:
                _drain(selector, content, 0.0)
                break
            now = time.monotonic()
            if not late and now - began > limits.wall_s:
                late = f"it took more than {limits.wall_s:g} s"
                if trace is not None:
                    os.kill(pid, signal.SIGUSR2)
                    time.sleep(0.2)
                os.kill(pid, signal.SIGINT)
                interrupted_at = now
            elif late and now - interrupted_at > GRACE_S:
                os.killpg(pid, signal.SIGKILL)
                late += " and did not end when it was interrupted"
                interrupted_at = float("inf")
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # what it started and left behind
    for read in readers.values():
        os.close(read)
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGXCPU:
        late = f"it took more than {limits.cpu_s} s of processor time"
    if late and trace is not None and trace.exists():
        late += "\n" + trace.read_text(errors="replace")[-3000:]
    peak = max(usage.ru_maxrss * 1024 - int.from_bytes(base[:], "little"), 0) if usage else 0
    by_itself = bool(interrupted_at) and interrupted_at < float("inf") and code >= 0
    return Ended(
        code, bytes(content[1]), bytes(content[2]), time.monotonic() - began, peak, late, interrupted=by_itself
    )


def _drain(selector: selectors.BaseSelector, content: dict[int, bytearray], patience_s: float) -> None:
    """Read what is there. Of each stream the first megabytes are kept."""
    if not selector.get_map():
        time.sleep(patience_s)
        return
    for key, _ in selector.select(patience_s):
        while True:
            try:
                chunk = os.read(key.fd, 1 << 16)
            except BlockingIOError:
                break
            if not chunk:
                selector.unregister(key.fd)
                break
            if len(content[key.data]) < 4 << 20:
                content[key.data] += chunk


def _status_bytes(field: str) -> int:
    with open("/proc/self/status") as file:  # noqa: PTH123
        line = next(line for line in file if line.startswith(field))
    return int(line.split()[1]) * 1024


def _resident_bytes() -> int:
    return _status_bytes("VmRSS:")


def _address_bytes() -> int:
    return _status_bytes("VmSize:")
