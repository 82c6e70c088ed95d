"""Other work beside the planners in a loaded run, as on a robot whose computer has other work."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from nnpp_edge.profiling.profile_file import Contention, ProfileError

_BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(10000))"
"""Computes without a pause, and ends with the process that started it."""


def check(contention: Contention) -> None:
    """ProfileError if this machine cannot run the command."""
    if contention.command and shutil.which(contention.command[0]) is None:
        raise ProfileError(f"contention.command: wanted a program that can be run, got {contention.command[0]!r}")


@contextmanager
def running(contention: Contention) -> Iterator[Callable[[], list[str]]]:
    """Run it on this thread's cores until the block ends; gives a function that says what ended too early."""
    commands = [contention.command] if contention.command else [(sys.executable, "-c", _BUSY)] * contention.threads
    nowhere, started = subprocess.DEVNULL, list[subprocess.Popen[bytes]]()
    try:
        for words in commands:
            process = subprocess.Popen(words, stdin=nowhere, stdout=nowhere, stderr=nowhere, start_new_session=True)
            started.append(process)
        yield lambda: [
            f"{contention.words} ended before the loaded run did, with exit code {process.returncode}"
            for process in started
            if process.poll() is not None
        ][:1]
    finally:
        for process in started:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
