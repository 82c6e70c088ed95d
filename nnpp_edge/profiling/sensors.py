"""Clocks and temperatures while a machine is measured, as far as the kernel tells, and whether it
was throttled.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nnpp_edge.profiling.contest import Facts

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
        zones = sorted((root / "class/thermal").glob("thermal_zone*"))
        kinds = {zone: text_of(zone / "type") or "zone" for zone in zones}
        self._zones = {
            f"{kind} {zone.name.removeprefix('thermal_zone')}": zone for zone, kind in kinds.items()
        }
        trips = {name: min(_trips(folder), default=None) for name, folder in self._zones.items()}
        known = {name: trip for name, trip in trips.items() if trip is not None}
        self.limits = Reading(0.0, self._clocks("cpuinfo_max_freq"), known)
        """The greatest clock of each core, and the temperature of each zone at which the kernel
        slows it.
        """

    def due(self) -> bool:
        """Whether it is time for the next reading."""
        return not self.readings or time.perf_counter() >= self.readings[-1].at_s + EVERY_S

    def read(self) -> Reading:
        """A reading of now; a file that cannot be read is left out."""
        temperatures = {name: _number(folder / "temp") for name, folder in self._zones.items()}
        counts = [
            _number(folder / "thermal_throttle/core_throttle_count")
            for folder in self._cores.values()
        ]
        known = [count for count in counts if count is not None]
        reading = Reading(
            time.perf_counter(),
            self._clocks("scaling_cur_freq"),
            {name: 1e-3 * milli for name, milli in temperatures.items() if milli is not None},
            int(sum(known)) if known else None,
        )
        self.readings.append(reading)
        return reading

    def _clocks(self, file: str) -> dict[str, float]:
        clocks = {core: _number(folder / "cpufreq" / file) for core, folder in self._cores.items()}
        return {core: 1e-3 * khz for core, khz in clocks.items() if khz}


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
    words = []
    clocks = _series(readings, "clock_mhz") if len(readings) > 1 else {}
    for core, values in clocks.items():
        quarter = max(len(values) // 4, 1)
        first, last = (float(np.median(part)) for part in (values[:quarter], values[-quarter:]))
        if last < (1.0 - FALL) * first:
            words.append(f"the clock of core {core} fell from {first:.0f} to {last:.0f} MHz")
    for zone, values in _series(readings, "temperature_c").items() if len(readings) > 1 else ():
        trip = limits.temperature_c.get(zone, float("inf"))
        if met := sum(each >= trip for each in values):
            words.append(
                f"{zone} stood at its trip point of {trip:g} °C in {met} of {len(values)} readings"
            )
    counts = [reading.throttles for reading in readings if reading.throttles is not None]
    if counts and counts[-1] > counts[0]:
        words.append(f"the processor slowed its cores {counts[-1] - counts[0]} times")
    if not words:
        return Throttling()
    # of the core that lacked most of its clock
    missing = [
        1.0 - np.median(each) / max(limits.clock_mhz.get(core, 0.0), *each)
        for core, each in clocks.items()
    ]
    return Throttling("; ".join(words), float(max(missing, default=1.0)))


def sensor_facts(readings: Sequence[Reading], limits: Reading) -> Facts:
    """Facts of the sensors, ready for JSON."""
    found: Facts = {"readings": len(readings), "throttled": throttling(readings, limits).words}
    for key, name in (("clock_mhz", "limit"), ("temperature_c", "trip")):
        found[key] = {
            each: {"first": values[0], "last": values[-1], "min": min(values), "max": max(values)}
            | {name: getattr(limits, key).get(each)}
            for each, values in _series(readings, key).items()
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
