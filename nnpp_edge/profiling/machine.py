"""The machine of a run: its processor and system, pinning to cores, and the load of other
processes. None stands for what Linux does not report.
"""

import math
import os
import platform
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeVar

import numpy as np

from nnpp_edge import __version__
from nnpp_edge.profiling.rows import Facts
from nnpp_edge.profiling.sensors import CLOCKS, Sensors, text_of

ResultT = TypeVar("ResultT")
_X86 = "avx2 fma f16c avx512f avx512bw avx512_vnni avx_vnni amx_tile amx_int8"
_ARM = "asimd asimddp i8mm sve sve2 bf16"  # asimddp is the dot product
_FLAGS = f"{_X86} {_ARM}".split()
"""Flags that decide how fast int8 and float kernels are."""
_PACKAGES = ("numpy", "numba", "onnxruntime", "opencv-python-headless")
_PROC = Path("/proc")
_SYS = Path("/sys")
_IDLE = slice(3, 5)
"""Columns of /proc/stat that are no work: idle, and waiting for a disk."""
_GUEST = 8
"""From this column on, time that is counted under user and nice already."""


def environment(cores: Sequence[int]) -> Facts:
    """CPU, its flags, governor of the cores, memory, versions and load, ready for JSON."""
    architecture = platform.machine()
    # the first core's, and the board's behind all of them
    lines = [line.partition(":") for line in reversed(text_of(_PROC / "cpuinfo").splitlines())]
    info = {key.strip(): value.strip() for key, _, value in lines if value.strip()}
    flags = info.get("flags", info.get("Features", "")).split()

    # what the processor is called: x86 says so, of a board its own name says more
    board = info.get("Model") or text_of(_PROC / "device-tree" / "model").rstrip("\0")
    cpu = board or info.get("Hardware") or info.get("model name") or architecture

    clocks = [*Sensors(cores, _SYS).limits[CLOCKS].values()]
    if not clocks and "cpu MHz" in info:
        clocks = [float(info["cpu MHz"])]
    folder = _SYS / "devices/system/cpu"
    governors = {text_of(folder / f"cpu{core}/cpufreq/scaling_governor") for core in cores}
    system = None
    with suppress(OSError):
        system = platform.freedesktop_os_release().get("PRETTY_NAME")
    return {
        "cpu": cpu,
        "architecture": architecture,
        "flags": [flag for flag in _FLAGS if flag in flags],
        "cores_online": os.cpu_count(),
        "clock_mhz": max(clocks, default=None),
        "governor": sorted(governors - {""}) or None,
        "memory_mb": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20,
        "kernel": platform.release(),
        "system": system,
        "python": platform.python_version(),
        "packages": {"nnpp-edge": __version__} | {name: _version(name) for name in _PACKAGES},
        "load_average": [round(each, 2) for each in os.getloadavg()],
    }


def _version(package: str) -> str | None:
    with suppress(PackageNotFoundError):
        return version(package)
    return None


@contextmanager
def pinned(cores: Sequence[int]) -> Iterator[tuple[list[int], list[str]]]:
    """Keep every thread of this process on these cores, or on others where some may not be used;
    gives the cores in use, and a warning where they are not those wanted.
    """
    before = os.sched_getaffinity(0)
    others = sorted(before - set(cores))
    got = sorted([*(before & set(cores)), *others][: len(cores)])
    said = []
    if got != sorted(cores):
        wanted, instead = (", ".join(map(str, each)) for each in (sorted(cores), got))
        said.append(f"wanted cores {wanted}, not all of which may be used here: runs on {instead}")
    _pin(got)
    try:
        yield got, said
    finally:
        _pin(before)


def _pin(cores: Sequence[int] | set[int]) -> None:
    for thread in Path("/proc/self/task").iterdir():
        with suppress(OSError):  # it may have ended
            os.sched_setaffinity(int(thread.name), cores)


class Disturbance:
    """Processor time taken by others while the planners were measured, in one half of the run."""

    def __init__(self, cores: Sequence[int]) -> None:
        self._cores = cores
        self._sums = np.zeros(4)
        self._left_out = np.zeros(4)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Count what passes meanwhile."""
        began = self._clocks()
        yield
        self._sums += self._clocks() - began

    def leave_out(self, wall_s: float, worked_s: float) -> None:
        """Leave out a call in which this thread may have waited for threads of its own."""
        self._left_out[:2] += wall_s, worked_s

    @contextmanager
    def left_out(self) -> Iterator[None]:
        """Count what passes meanwhile neither as work nor as waiting."""
        began = self._clocks()
        yield
        self.leave_out(*(self._clocks() - began)[:2])

    def facts(self) -> Facts:
        """``waited_share``, of its time that this thread stood still though it had work to do:
        beyond its processor time. ``others_share``, of the cores' time that went to other
        processes, interrupts or a virtual machine's other guests. ``measured_s``.
        """
        elapsed_s, _, own_s, busy_s = self._sums.tolist()
        wall_s, worked_s, _, _ = (self._sums - self._left_out).tolist()
        waited = max(1.0 - worked_s / wall_s, 0.0) if wall_s > 0.0 else 0.0
        others = None
        if elapsed_s and not math.isnan(busy_s):
            share = (busy_s - own_s) / (elapsed_s * len(self._cores))
            others = min(max(share, 0.0), 1.0)
        return {"waited_share": waited, "others_share": others, "measured_s": elapsed_s}

    def _clocks(self) -> np.ndarray:
        """Seconds on the wall, of this thread, of this process, and that the cores worked."""
        busy_s = core_seconds(self._cores)
        own = time.perf_counter(), time.thread_time(), time.process_time()
        return np.array((*own, math.nan if busy_s is None else busy_s))


def core_seconds(cores: Sequence[int]) -> float | None:
    """Seconds that the cores have worked since the machine started; None where the kernel does not
    count them.
    """
    wanted = {f"cpu{core}" for core in cores}
    ticks = 0
    counted = 0
    for line in text_of(_PROC / "stat").splitlines():
        name, *fields = line.split()
        if name not in wanted:
            continue
        times = [int(each) for each in fields]
        ticks += sum(times[:_GUEST]) - sum(times[_IDLE])
        counted += any(times)
    if counted < len(wanted):
        return None
    return ticks / os.sysconf("SC_CLK_TCK")
