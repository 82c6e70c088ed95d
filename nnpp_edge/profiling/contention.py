"""Other work beside the planners in a loaded run, as on a robot whose computer has other work."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress

from nnpp_edge.profiling.profile_file import Contention, ProfileError

_BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(10000))"
"""Computes without a pause, and ends with the process that started it."""


@contextmanager
def running(contention: Contention, cores: Sequence[int]) -> Iterator[Callable[[], list[str]]]:
    """Run it on its cores, else on these, until the block ends; gives a function that says what ended too early."""
    words = [contention.command] if contention.command else [(sys.executable, "-c", _BUSY)] * contention.threads
    with ExitStack() as stack:
        started = [stack.enter_context(_process(each, contention.cores or tuple(cores))) for each in words]
        yield lambda: [
            f"{contention.words} ended before the loaded run did, with exit code {process.returncode}"
            for process in started
            if process.poll() is not None
        ][:1]


@contextmanager
def _process(words: Sequence[str], cores: Sequence[int]) -> Iterator[subprocess.Popen[bytes]]:
    """A process and its children on these cores; all are ended with the block."""
    before = os.sched_getaffinity(0)
    with suppress(OSError):  # the machine may lack the cores
        os.sched_setaffinity(0, cores)  # which the process inherits
    try:
        nowhere = subprocess.DEVNULL
        process = subprocess.Popen(words, stdin=nowhere, stdout=nowhere, stderr=nowhere, start_new_session=True)
    except OSError as error:
        raise ProfileError(f"contention.command: {words[0]!r} could not be run ({error.strerror})") from error
    finally:
        os.sched_setaffinity(0, before)
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
