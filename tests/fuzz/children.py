"""Work done in a forked process under limits of time and memory, and what became of it.

A fork of a process that has loaded everything costs milliseconds where a fresh interpreter costs a
second.
"""

import contextlib
import gc
import mmap
import os
import resource
import signal
import subprocess
import sys
import time
import traceback
from dataclasses import dataclass

GRACE_S = 15.0  # a process that is interrupted has so long to end


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


ROOMY = Limits(120.0, 120, 8 << 30)


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    `code` is below 0 for the signal that killed it, `peak_bytes` counts from what it began with,
    `late` tells which limit of time it passed, and `interrupted` that it ended by itself once it
    was interrupted.
    """

    code: int = 0
    out: str = ""
    err: str = ""
    wall_s: float = 1.0
    peak_bytes: int = 0
    late: str = ""
    interrupted: bool = False


def run_forked(work, limits, stdin=b""):
    """Let a fork do `work`; interrupt it, then kill it, when it is late."""
    peak = mmap.mmap(-1, 8)  # shared with the fork
    began = time.monotonic()
    sys.stdout.flush()
    sys.stderr.flush()
    child = subprocess.Popen(
        "its preexec_fn never returns, so that no program is executed",
        preexec_fn=lambda: _child(work, limits, peak),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        restore_signals=False,
    )
    late = ""
    try:
        child.communicate(stdin, limits.wall_s)
    except subprocess.TimeoutExpired:
        late = f"it took more than {limits.wall_s:g} s"
        child.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.communicate(timeout=GRACE_S)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)  # it, or what it started and left behind
    out, err = (stream.decode("utf-8", "replace") for stream in child.communicate())
    code = child.returncode
    interrupted = bool(late) and code >= 0
    if code == -signal.SIGXCPU:
        late = f"it took more than {limits.cpu_s} s of processor time"
    grown = int.from_bytes(peak[:], "little")
    return Ended(code, out, err, time.monotonic() - began, grown, late, interrupted)


def _child(work, limits, peak):
    """The forked process. Its exit code is what the interpreter would give a program that ends
    so.
    """
    code = 0
    base = _status_bytes("VmRSS:")
    gc.enable()  # Popen disables it
    os.closerange(3, 1 << 12)  # by one of these Popen learns that the child has begun
    for n, name in enumerate(("stdin", "stdout", "stderr")):
        errors = "backslashreplace" if n == 2 else "strict"
        stream = os.fdopen(n, "w" if n else "r", encoding="utf-8", errors=errors, closefd=False)
        setattr(sys, name, stream)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    space = _status_bytes("VmSize:") + limits.memory_bytes
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (limits.cpu_s, limits.cpu_s + 5))
    resource.setrlimit(resource.RLIMIT_AS, (space, space))
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_bytes, limits.file_bytes))
    try:
        work()
        sys.stdout.flush()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        code = 1
        with contextlib.suppress(BaseException):
            sys.stderr.write(traceback.format_exc())
    finally:
        with contextlib.suppress(BaseException):
            sys.stdout.flush()
            sys.stderr.flush()
        grown = max(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - base, 0)
        peak[:] = grown.to_bytes(8, "little")
        os._exit(code & 0xFF)


def _status_bytes(name):
    with open("/proc/self/status") as file:  # noqa: PTH123
        return next(int(line.split()[1]) * 1024 for line in file if line.startswith(name))
