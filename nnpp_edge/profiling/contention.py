"""Other work beside the planners in a loaded run, as on a robot whose computer has other work."""

import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Annotated

from msgspec import Meta

from nnpp_edge.profiling.tables import Core, ProfileError, Table

_BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(10000))"
"""Computes without a pause, and ends with the process that started it."""


class Contention(Table, frozen=True):
    """Work that runs beside; by default nothing, and no loaded run is made."""

    threads: Annotated[int, Meta(ge=0, le=1024)] = 0
    """So many that compute without a pause, each a process of its own."""
    command: tuple[str, ...] = ()
    """A program and its words, run without a shell, in place of the threads. It must not end before the run does."""
    cores: tuple[Core, ...] = ()
    """To keep it on; by default the device's."""

    def __post_init__(self) -> None:
        self.check_different("cores")
        self.refuse_unless(not (self.threads and self.command), "threads", "threads or a command, not both")

    @property
    def wanted(self) -> bool:
        """Whether anything runs beside."""
        return bool(self.threads or self.command)

    @property
    def words(self) -> str:
        """In words."""
        return shlex.join(self.command) if self.command else f"{self.threads} busy thread{'s' * (self.threads > 1)}"

    def check(self) -> None:
        """ProfileError if this machine cannot run the command."""
        if self.command and shutil.which(self.command[0]) is None:
            raise ProfileError(f"contention.command: wanted a program that can be run here, got {self.command[0]!r}")


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
