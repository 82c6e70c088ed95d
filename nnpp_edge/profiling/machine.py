"""The machine of a run: what it is, cores to pin to, and who else keeps them busy. What Linux hides is None."""

import os
import platform
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from nnpp_edge import __version__
from nnpp_edge.profiling.report_format import MachineFacts
from nnpp_edge.profiling.sensors import KernelSensors

_X86_FLAGS = ("avx2", "fma", "f16c", "avx512f", "avx512bw", "avx512_vnni", "avx_vnni", "amx_tile", "amx_int8")
_ARM_FLAGS = ("asimd", "asimddp", "i8mm", "sve", "sve2", "bf16")
"""Flags that decide how fast int8 and float kernels are; asimddp is the dot product."""
_PACKAGES = ("numpy", "numba", "onnxruntime", "opencv-python-headless")
_PROC, _SYS = Path("/proc"), Path("/sys")
_IDLE = (3, 4)
"""Columns of /proc/stat that are no work: idle, and waiting for a disk."""
_STEAL = 7
_GUEST = 8
"""From this column on, time that is counted under user and nice already."""


def environment(cores: Sequence[int]) -> MachineFacts:
    """CPU, its flags, governor of the cores, memory, versions and load, ready for JSON."""
    info = _cpuinfo()
    flags = set(info.get("flags", info.get("Features", "")).split())
    return {
        "cpu": info.get("model name") or _device_tree() or info.get("Hardware") or platform.machine(),
        "architecture": platform.machine(),
        "flags": [flag for flag in (*_X86_FLAGS, *_ARM_FLAGS) if flag in flags],
        "cores_online": os.cpu_count(),
        "clock_mhz": _clock_mhz(cores, info),
        "governor": sorted({name for core in cores if (name := _governor(core))}) or None,
        "memory_mb": _memory_mb(),
        "kernel": platform.release(),
        "system": _system(),
        "python": platform.python_version(),
        "packages": {"nnpp-edge": __version__, **{name: _version(name) for name in _PACKAGES}},
        "load_average": [round(each, 2) for each in os.getloadavg()],
    }


@contextmanager
def pinned(cores: Sequence[int]) -> Iterator[tuple[list[int], list[str]]]:
    """Keep every thread of this process on these cores; gives those that it got, and what must be said about it."""
    before = os.sched_getaffinity(0)
    got = sorted(set(cores) & before)
    said = []
    if missing := sorted(set(cores) - before):
        instead = sorted(before - set(got))[: len(missing)]
        got = sorted({*got, *instead})
        said.append(
            f"wanted cores {_listed(cores)}, of which {_listed(missing)} may not be used here: "
            f"runs on {_listed(got)}" + (f", {len(cores) - len(got)} fewer" if len(got) < len(cores) else "")
        )
    _pin(got)
    try:
        yield got, said
    finally:
        _pin(before)


def busy_share(cores: Sequence[int], seconds: float = 0.3) -> float | None:
    """Share of these cores' time that others use at the moment; None where it cannot be known."""
    watch = CoreTimes(cores)
    watch.start()
    time.sleep(seconds)
    watch.stop()
    return watch.others_share()


class CoreTimes:
    """How much of the cores' time this process used, and how much others did, while the watch ran."""

    def __init__(self, cores: Sequence[int]) -> None:
        self.cores = cores
        self.elapsed = self.own = 0.0
        self.busy: float | None = 0.0
        self.stolen: float | None = 0.0
        self._at: tuple[float, float, tuple[float, float] | None] | None = None

    def start(self) -> None:
        """Start or resume the count."""
        self._at = (time.perf_counter(), time.process_time(), core_seconds(self.cores))

    def stop(self) -> None:
        """Add what has passed since `start`."""
        assert self._at is not None
        began, own, before = self._at
        after = core_seconds(self.cores)
        self.elapsed += time.perf_counter() - began
        self.own += time.process_time() - own
        if before is None or after is None or self.busy is None or self.stolen is None:
            self.busy = self.stolen = None
        else:
            self.busy += after[0] - before[0]
            self.stolen += after[1] - before[1]

    def others_share(self) -> float | None:
        """Share of the cores' time that went to other processes, interrupts or a virtual machine's other guests."""
        if self.busy is None or not self.elapsed:
            return None
        return min(max((self.busy - self.own) / (self.elapsed * len(self.cores)), 0.0), 1.0)

    def stolen_share(self) -> float | None:
        """The part of it that the host of a virtual machine took."""
        if self.stolen is None or not self.elapsed:
            return None
        return min(max(self.stolen / (self.elapsed * len(self.cores)), 0.0), 1.0)


class EnergyMeter:
    """Energy of the processor packages by RAPL; `problem` says why there is none."""

    def __init__(self, folder: Path = _SYS / "class" / "powercap") -> None:
        self.problem = ""
        self._zones: list[tuple[Path, int]] = []
        # packages are intel-rapl:N on AMD too; intel-rapl:N:M are parts of them
        for zone in sorted(folder.glob("intel-rapl:*")):
            if zone.name.count(":") == 1:
                try:
                    (zone / "energy_uj").read_text()
                    self._zones.append((zone / "energy_uj", int((zone / "max_energy_range_uj").read_text())))
                except (OSError, ValueError) as error:
                    self._zones, self.problem = [], f"the counter cannot be read ({_reason(error)})"
                    break
        if not self._zones and not self.problem:
            self.problem = "this machine has no energy counter"

    def read(self) -> list[int]:
        """Microjoules of each package's counter; empty where there is none."""
        return [int(path.read_text()) for path, _ in self._zones]

    def joules(self, before: list[int], after: list[int]) -> float:
        """Energy between two readings; a counter that has wrapped around is one range further."""
        ranges = [size for _, size in self._zones]
        return 1e-6 * sum((b - a) % (size + 1) for a, b, size in zip(before, after, ranges, strict=True))


def _pin(cores: Sequence[int] | set[int]) -> None:
    for thread in Path("/proc/self/task").iterdir():
        with suppress(OSError):  # it may have ended
            os.sched_setaffinity(int(thread.name), cores)


def core_seconds(cores: Sequence[int]) -> tuple[float, float] | None:
    """Seconds that the cores have worked since the machine started, and those stolen among them."""
    wanted = {f"cpu{core}" for core in cores}
    busy = stolen = 0.0
    found = 0
    try:
        with (_PROC / "stat").open() as stat:
            for line in stat:
                if not line.startswith("cpu"):
                    break
                name, *fields = line.split()
                if name in wanted:
                    ticks = [int(each) for each in fields]
                    busy += sum(ticks[:_GUEST]) - sum(ticks[at] for at in _IDLE)
                    stolen += ticks[_STEAL]
                    found += sum(ticks) > 0
    except (OSError, ValueError, IndexError):
        return None
    second = os.sysconf("SC_CLK_TCK")
    return (busy / second, stolen / second) if found == len(wanted) else None


def _cpuinfo() -> dict[str, str]:
    """Fields of /proc/cpuinfo for the first core, and for the board behind all of them."""
    found: dict[str, str] = {}
    with suppress(OSError):
        for line in (_PROC / "cpuinfo").read_text().splitlines():
            key, _, value = line.partition(":")
            if value.strip():
                found.setdefault(key.strip(), value.strip())
    return found


def _device_tree() -> str:
    with suppress(OSError):
        return (_PROC / "device-tree" / "model").read_text().rstrip("\0").strip()
    return ""


def _governor(core: int) -> str | None:
    with suppress(OSError):
        return (_SYS / f"devices/system/cpu/cpu{core}/cpufreq/scaling_governor").read_text().strip()
    return None


def _clock_mhz(cores: Sequence[int], info: dict[str, str]) -> float | None:
    """The greatest clock of the cores; where the kernel does not tell, the one it found at start."""
    limits = KernelSensors(cores, _SYS).limits.clock_mhz
    with suppress(KeyError, ValueError):
        return max(limits.values()) if limits else float(info["cpu MHz"])
    return None


def _system() -> str | None:
    with suppress(OSError):
        return platform.freedesktop_os_release().get("PRETTY_NAME")
    return None


def _memory_mb() -> int | None:
    with suppress(OSError, ValueError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20
    return None


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _listed(cores: Sequence[int]) -> str:
    return ", ".join(map(str, sorted(cores)))


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
