"""Clocks and temperatures while a machine is measured, as far as the kernel tells, and whether it
was throttled.
"""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nnpp_edge.profiling.rows import Facts

EVERY_S = 0.25
"""Between two readings."""
FALL = 0.10
"""Share by which a core's clock may fall in a run."""
_SLOWING = ("passive", "hot", "critical")
"""Kinds of trip point at which the processor is slowed or switched off; at an ``active`` one a fan
starts.
"""


@dataclass(frozen=True)
class Reading:
    """Readings of the kernel at a moment; empty or None where it tells nothing."""

    at_s: float = 0.0
    """By the clock of the calls that are measured."""
    clock_mhz: dict[str, float] = field(default_factory=dict)
    """By core."""
    temperature_c: dict[str, float] = field(default_factory=dict)
    """By thermal zone."""
    throttles: int | None = None
    """How often the processor says it has slowed its cores since the machine started."""


class Sensors:
    """The sensors below `root`: cpufreq and the thermal counter of these cores, and all thermal
    zones.

    Readings are kept, and none is `due` sooner than `EVERY_S` seconds after the one before.
    """

    def __init__(self, cores: Sequence[int], root: Path = Path("/sys")) -> None:
        self.readings: list[Reading] = []
        self._cores = {str(core): root / f"devices/system/cpu/cpu{core}" for core in cores}
        self._zones: dict[str, Path] = {}
        for zone in sorted((root / "class/thermal").glob("thermal_zone*")):
            kind = text_of(zone / "type") or "zone"
            self._zones[f"{kind} {zone.name.removeprefix('thermal_zone')}"] = zone
        points = {name: list(_trips(zone)) for name, zone in self._zones.items()}
        trips = {name: min(slowing) for name, slowing in points.items() if slowing}
        self.limits = Reading(0.0, self._clocks("cpuinfo_max_freq"), trips)
        """The greatest clock of each core, and the temperature of each zone at which the kernel
        slows it.
        """

    def due(self) -> bool:
        """Whether it is time for the next reading."""
        return not self.readings or time.perf_counter() >= self.readings[-1].at_s + EVERY_S

    def read(self) -> Reading:
        """A reading of now; a file that cannot be read is left out."""
        temperatures = _thousandths(self._zones, "temp")
        counts = _thousandths(self._cores, "thermal_throttle/core_throttle_count").values()
        throttles = round(1e3 * sum(counts)) if counts else None
        clocks = self._clocks("scaling_cur_freq")
        reading = Reading(time.perf_counter(), clocks, temperatures, throttles)
        self.readings.append(reading)
        return reading

    def _clocks(self, file: str) -> dict[str, float]:
        """MHz of each core by a file of cpufreq."""
        clocks = _thousandths(self._cores, f"cpufreq/{file}")
        return {core: mhz for core, mhz in clocks.items() if mhz}


@dataclass(frozen=True)
class Throttling:
    """Whether the processor was slowed while it was measured."""

    words: str = ""
    """Signs of it; empty where nothing shows."""
    share: float = 0.0
    """Of the greatest clock that was missing; 1 where the clock is not known."""


def throttling(readings: Sequence[Reading], limits: Reading) -> Throttling:
    """Signs in the readings of a run: a clock that fell, a trip point that was met, a counter that
    rose.

    A clock fell where its median over the last quarter of the readings is below that over the first
    by `FALL`.
    """
    if len(readings) < 2:
        return Throttling()
    words = []
    missing = []
    for core, values in _series(readings, "clock_mhz").items():
        quarter = max(len(values) // 4, 1)
        first = float(np.median(values[:quarter]))
        last = float(np.median(values[-quarter:]))
        if last < (1.0 - FALL) * first:
            words.append(f"the clock of core {core} fell from {first:.0f} to {last:.0f} MHz")
        missing.append(1.0 - np.median(values) / max(limits.clock_mhz.get(core, 0.0), *values))
    for zone, values in _series(readings, "temperature_c").items():
        trip = limits.temperature_c.get(zone, math.inf)
        met = sum(each >= trip for each in values)
        if met:
            words.append(
                f"{zone} stood at its trip point of {trip:g} °C in {met} of {len(values)} readings"
            )
    counts = [reading.throttles for reading in readings if reading.throttles is not None]
    if counts and counts[-1] > counts[0]:
        words.append(f"the processor slowed its cores {counts[-1] - counts[0]} times")
    # of the core that lacked most of its clock
    share = float(max(missing, default=1.0)) if words else 0.0
    return Throttling("; ".join(words), share)


def sensor_facts(readings: Sequence[Reading], limits: Reading) -> Facts:
    """Facts of the sensors, ready for JSON."""
    found: Facts = {"readings": len(readings), "throttled": throttling(readings, limits).words}
    for key, name in (("clock_mhz", "limit"), ("temperature_c", "trip")):
        most = getattr(limits, key)
        found[key] = {
            sensor: {
                "first": values[0],
                "last": values[-1],
                "min": min(values),
                "max": max(values),
                name: most.get(sensor),
            }
            for sensor, values in _series(readings, key).items()
        }
    return found


def _series(readings: Sequence[Reading], key: str) -> dict[str, list[float]]:
    """The readings of each sensor of a kind, in order."""
    found: dict[str, list[float]] = {}
    for reading in readings:
        for sensor, value in getattr(reading, key).items():
            found.setdefault(sensor, []).append(value)
    return found


def _trips(zone: Path) -> Iterator[float]:
    """Temperatures at which the kernel slows the processor; a point at 0 or below is not in use."""
    for kind in zone.glob("trip_point_*_type"):
        milli = _number(zone / kind.name.replace("_type", "_temp"))
        if text_of(kind) in _SLOWING and milli is not None and milli > 0.0:
            yield 1e-3 * milli


def text_of(path: Path) -> str:
    """A file of the kernel's, stripped; empty where it cannot be read."""
    with suppress(OSError, ValueError):
        return path.read_text().strip()
    return ""


def _number(path: Path) -> float | None:
    with suppress(ValueError):
        return float(text_of(path))
    return None


def _thousandths(folders: Mapping[str, Path], file: str) -> dict[str, float]:
    """A thousandth of the number in this file of each folder, where it can be read."""
    numbers = {name: _number(folder / file) for name, folder in folders.items()}
    return {name: 1e-3 * number for name, number in numbers.items() if number is not None}
