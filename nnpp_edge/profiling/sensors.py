"""Clocks and temperatures while a machine is measured, as far as the kernel tells, and whether it was throttled."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from nnpp_edge.profiling.report_format import SensorFacts

KeyT = TypeVar("KeyT")
SYS = Path("/sys")
EVERY_S = 0.25
"""Between two readings."""
FALL = 0.10
"""Share by which a core's clock may fall in a run."""
_SLOWING = ("passive", "hot", "critical")
"""Kinds of trip point at which the processor is slowed or switched off; at an ``active`` one a fan starts."""


@dataclass(frozen=True)
class Reading:
    """Readings of the kernel at a moment; empty or None where it tells nothing."""

    at_s: float = 0.0
    """By the clock of the calls that are measured."""
    clock_mhz: dict[int, float] = field(default_factory=dict)
    """By core."""
    temperature_c: dict[str, float] = field(default_factory=dict)
    """By thermal zone."""
    throttles: int | None = None
    """How often the processor says it has slowed its cores since the machine started."""


@dataclass(frozen=True)
class Limits:
    """Limits of readings."""

    clock_mhz: dict[int, float] = field(default_factory=dict)
    """The greatest clock of each core."""
    trip_c: dict[str, float] = field(default_factory=dict)
    """The temperature of each thermal zone at which the kernel slows the processor."""


class Sensors(Protocol):
    """Reads clocks and temperatures."""

    limits: Limits

    def read(self) -> Reading:
        """Readings of now; never raises."""


class KernelSensors:
    """The sensors below `root` (``/sys``): cpufreq and the thermal counter of these cores, and all thermal zones."""

    def __init__(self, cores: Sequence[int], root: Path = SYS) -> None:
        self._cores = {core: root / f"devices/system/cpu/cpu{core}" for core in cores}
        self._zones = dict(_zones(root / "class/thermal"))
        clocks = {core: _number(folder / "cpufreq/cpuinfo_max_freq") for core, folder in self._cores.items()}
        trips = {name: min(_trips(folder), default=None) for name, folder in self._zones.items()}
        self.limits = Limits(
            {core: 1e-3 * khz for core, khz in clocks.items() if khz},
            {name: trip for name, trip in trips.items() if trip is not None},
        )

    def read(self) -> Reading:
        """Now; a file that cannot be read is left out."""
        clocks = {core: _number(folder / "cpufreq/scaling_cur_freq") for core, folder in self._cores.items()}
        temperatures = {name: _number(folder / "temp") for name, folder in self._zones.items()}
        counts = [_number(folder / "thermal_throttle/core_throttle_count") for folder in self._cores.values()]
        known = [count for count in counts if count is not None]
        return Reading(
            time.perf_counter(),
            {core: 1e-3 * khz for core, khz in clocks.items() if khz},
            {name: 1e-3 * milli for name, milli in temperatures.items() if milli is not None},
            int(sum(known)) if known else None,
        )


@dataclass
class SensorLog:
    """Readings of a run, none sooner than `every_s` seconds after the one before."""

    sensors: Sensors
    every_s: float = EVERY_S
    clock: Callable[[], float] = time.monotonic
    readings: list[Reading] = field(default_factory=list)
    _next_s: float = float("-inf")

    def due(self) -> bool:
        """Whether it is time for the next reading."""
        return self.clock() >= self._next_s

    def read(self) -> None:
        """Take a reading."""
        self.readings.append(self.sensors.read())
        self._next_s = self.clock() + self.every_s


@dataclass(frozen=True)
class Throttling:
    """Whether the processor was slowed while it was measured."""

    words: str = ""
    """Signs of it; empty where nothing shows."""
    share: float = 0.0
    """Of the greatest clock that was missing; 1 where the clock is not known."""


def throttling(readings: Sequence[Reading], limits: Limits) -> Throttling:
    """Judge the readings of a run.

    Throttled is a run in which a core's clock fell by more than `FALL` (its median over the last quarter of the
    readings, against that over the first), a thermal zone stood at or above its trip point, or the processor counted
    that it had slowed its cores.
    """
    if len(readings) < 2:
        return Throttling()
    words = [*_falls(readings), *_trips_met(readings, limits)]
    counts = [reading.throttles for reading in readings if reading.throttles is not None]
    if len(counts) > 1 and counts[-1] > counts[0]:
        words.append(f"the processor slowed its cores {counts[-1] - counts[0]} times")
    return Throttling("; ".join(words), _missing_share(readings, limits)) if words else Throttling()


def sensor_facts(log: SensorLog) -> SensorFacts:
    """Facts of the sensors, ready for JSON."""
    readings, limits = log.readings, log.sensors.limits
    return SensorFacts(
        readings=len(readings),
        throttled=throttling(readings, limits).words,
        clock_mhz={
            str(core): _range(clocks, "limit", limits.clock_mhz.get(core))
            for core, clocks in _series(readings, lambda reading: reading.clock_mhz).items()
        },
        temperature_c={
            zone: _range(temperatures, "trip", limits.trip_c.get(zone))
            for zone, temperatures in _series(readings, lambda reading: reading.temperature_c).items()
        },
    )


def _falls(readings: Sequence[Reading]) -> Iterator[str]:
    for core, clocks in _series(readings, lambda reading: reading.clock_mhz).items():
        first, last = (float(np.median(part)) for part in _ends(clocks))
        if last < (1.0 - FALL) * first:
            yield f"the clock of core {core} fell from {first:.0f} to {last:.0f} MHz"


def _trips_met(readings: Sequence[Reading], limits: Limits) -> Iterator[str]:
    for zone, temperatures in _series(readings, lambda reading: reading.temperature_c).items():
        trip = limits.trip_c.get(zone, float("inf"))
        if met := sum(each >= trip for each in temperatures):
            yield f"{zone} stood at its trip point of {trip:g} °C in {met} of {len(temperatures)} readings"


def _missing_share(readings: Sequence[Reading], limits: Limits) -> float:
    """Of the clock of the core that lacked most of it, by its median."""
    missing = [
        1.0 - float(np.median(clocks)) / max(limits.clock_mhz.get(core, 0.0), *clocks)
        for core, clocks in _series(readings, lambda reading: reading.clock_mhz).items()
    ]
    return max(missing, default=1.0)


def _series(readings: Sequence[Reading], of: Callable[[Reading], dict[KeyT, float]]) -> dict[KeyT, list[float]]:
    """The readings of each sensor, in order."""
    found: dict[KeyT, list[float]] = {}
    for reading in readings:
        for key, value in of(reading).items():
            found.setdefault(key, []).append(value)
    return found


def _ends(values: Sequence[float]) -> tuple[Sequence[float], Sequence[float]]:
    """The first and the last quarter."""
    count = max(len(values) // 4, 1)
    return values[:count], values[-count:]


def _range(values: Sequence[float], name: str, limit: float | None) -> dict[str, float | None]:
    return {"first": values[0], "last": values[-1], "min": min(values), "max": max(values), name: limit}


def _zones(folder: Path) -> Iterator[tuple[str, Path]]:
    """Thermal zones by kind and number, such as ``x86_pkg_temp 2``."""
    for zone in sorted(folder.glob("thermal_zone*")):
        kind = _text(zone / "type") or "zone"
        yield f"{kind} {zone.name.removeprefix('thermal_zone')}", zone


def _trips(zone: Path) -> Iterator[float]:
    """Temperatures at which the kernel slows the processor; a point at 0 or below is not in use."""
    for kind in zone.glob("trip_point_*_type"):
        milli = _number(zone / kind.name.replace("_type", "_temp"))
        if _text(kind) in _SLOWING and milli is not None and milli > 0.0:
            yield 1e-3 * milli


def _text(path: Path) -> str:
    with suppress(OSError, ValueError):
        return path.read_text().strip()
    return ""


def _number(path: Path) -> float | None:
    with suppress(ValueError):
        return float(_text(path))
    return None
