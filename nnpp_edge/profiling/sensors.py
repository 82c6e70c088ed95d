"""Clocks and temperatures while a machine is measured, as far as the kernel tells, and whether it
was throttled.
"""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nnpp_edge.profiling.rows import Facts

EVERY_S = 0.25
"""Between two readings."""
FALL = 0.10
"""Share by which a core's clock may fall in a run."""
CLOCKS = "clock_mhz"
TEMPERATURES = "temperature_c"
THROTTLES = "throttles"
"""Kinds of sensors: of each core and zone, and how often a core says that it was slowed since the
machine started.
"""
_SLOWING = ("passive", "hot", "critical")
"""Kinds of trip point at which the processor is slowed or switched off; at an ``active`` one a fan
starts.
"""


Readings = dict[str, list[float]]
"""By sensor."""


class Throttling(NamedTuple):
    """Whether the processor was slowed while it was measured."""

    words: str = ""
    """Signs of it; empty where nothing shows."""
    share: float = 0.0
    """Of the greatest clock that was missing; 1 where the clock is not known."""


class Sensors:
    """The sensors below `root`: cpufreq and the thermal counter of these cores, and all thermal
    zones.

    `readings` are of each kind those of each sensor that could be read, in order; none is `due`
    sooner than `EVERY_S` seconds after the one before. `limits` are the greatest clock of each
    core, and the temperature of each zone at which the kernel slows it.
    """

    def __init__(self, cores: Sequence[int], root: Path = Path("/sys")) -> None:
        self.readings: dict[str, Readings] = {CLOCKS: {}, TEMPERATURES: {}, THROTTLES: {}}
        self._due_s = -math.inf
        self._cores = {str(core): root / f"devices/system/cpu/cpu{core}" for core in cores}
        self._zones: dict[str, Path] = {}
        for zone in sorted((root / "class/thermal").glob("thermal_zone*")):
            kind = text_of(zone / "type") or "zone"
            self._zones[f"{kind} {zone.name.removeprefix('thermal_zone')}"] = zone
        points = {name: list(_trips(zone)) for name, zone in self._zones.items()}
        trips = {name: min(slowing) for name, slowing in points.items() if slowing}
        clocks = _numbers(self._cores, "cpufreq/cpuinfo_max_freq", 1e-3)
        self.limits = {CLOCKS: clocks, TEMPERATURES: trips}

    def due(self) -> bool:
        """Whether it is time for the next reading."""
        return time.perf_counter() >= self._due_s

    def read(self) -> None:
        """Read all sensors; a file that cannot be read is left out."""
        self._due_s = time.perf_counter() + EVERY_S
        told = {
            CLOCKS: _numbers(self._cores, "cpufreq/scaling_cur_freq", 1e-3),
            TEMPERATURES: _numbers(self._zones, "temp", 1e-3),
            THROTTLES: _numbers(self._cores, "thermal_throttle/core_throttle_count"),
        }
        for kind, values in told.items():
            for sensor, value in values.items():
                self.readings[kind].setdefault(sensor, []).append(value)

    def facts(self) -> Facts:
        """Facts of the sensors, ready for JSON."""
        found: Facts = {"throttled": self.throttling().words}
        for kind in (CLOCKS, TEMPERATURES):
            readings = self.readings[kind].items()
            found[kind] = {name: {"min": min(each), "max": max(each)} for name, each in readings}
        return found

    def throttling(self) -> Throttling:
        """Signs in the readings: a clock that fell, a trip point that was met, a counter that rose.

        A clock fell where its median over the last quarter of the readings is below that over the
        first by `FALL`.
        """
        words = []
        missing = []
        for core, values in self.readings[CLOCKS].items():
            quarter = max(len(values) // 4, 1)
            first, typical, last = map(np.median, (values[:quarter], values, values[-quarter:]))
            if last < (1.0 - FALL) * first:
                words.append(f"the clock of core {core} fell from {first:.0f} to {last:.0f} MHz")
            missing.append(1.0 - typical / max(self.limits[CLOCKS].get(core, 1.0), *values))
        for zone, values in self.readings[TEMPERATURES].items():
            trip = self.limits[TEMPERATURES].get(zone, math.inf)
            if met := sum(each >= trip for each in values):
                where = f"{zone} stood at its trip point of {trip:g} °C"
                words.append(f"{where} in {met} of {len(values)} readings")
        counts = self.readings[THROTTLES].values()
        slowed = sum(values[-1] - values[0] for values in counts)
        if slowed > 0:
            words.append(f"the processor slowed its cores {slowed:.0f} times")
        # of the core that lacked most of its clock
        share = float(max(missing, default=1.0)) if words else 0.0
        return Throttling("; ".join(words), share)


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


def _numbers(folders: Mapping[str, Path], file: str, scale: float = 1.0) -> dict[str, float]:
    """The number in this file of each folder, where it can be read, times `scale`."""
    numbers = {name: _number(folder / file) for name, folder in folders.items()}
    return {name: scale * number for name, number in numbers.items() if number is not None}
