"""Costs of a way up or down: time or energy of a length on the map and a signed rise.

All models are functions of a way's length on the map and of what it rises, metres; a rise below 0 is a descent.
They price the slope alone: whether a cell can be stood on is decided by the traversability (or a body's poses).

- ``tobler``: seconds of a hiker (`ToblerCost`).
- ``irmischer``: seconds of somebody who finds the way on foot, off paths or on them (`IrmischerCost`).
- ``linear``: so much a metre of the way, a metre climbed and a metre descended, as r.walk (`LinearCost`).
- ``time``: seconds of a vehicle whose speed depends on the slope (`TimeCost`).
- ``energy``: joules of a vehicle with a mass, a rolling resistance, an efficiency and a recovery (`EnergyCost`).
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.directed import ENERGY, LARGEST_EXPONENT, LINEAR, TIME, TOBLER

Float64s = NDArray[np.float64]
Packed = tuple[int, Float64s]
"""A model as the kernels take it, see `kernels.directed`: its number, and its values."""


class SlopeCost(Protocol):
    """A model of what a way costs."""

    unit: ClassVar[str]
    """Of its costs; empty where that is its coefficients'."""

    def cost(self, length_m: ArrayLike, rise_m: ArrayLike) -> Float64s:
        """Cost of ways.

        Parameters
        ----------
        length_m, rise_m : float or (…) float
            Length on the map, above 0, and signed rise. They are broadcast; of two numbers comes one.
        """

    @property
    def height_price(self) -> float:
        """Worth of a metre of height to searches, which go by cost(length, rise) - height_price · rise.

        A path's cost is the sum of these and the price of the height between its ends, whichever way it goes: which
        path is the cheapest does not depend on it. With a good price the cheapest metre costs nearly what a level one
        does, so that a search knows well what is left; and it is above 0 where a way may cost less than nothing.
        """

    @property
    def least_per_m(self) -> float:
        """The cheapest metre on the map over all slopes, less what its rise is worth; above 0."""

    @property
    def packed(self) -> Packed:
        """The model as the kernels take it."""


@checked(InvalidQueryError)
@dataclass(frozen=True)
class ToblerCost:
    """Seconds of a hiker: W = speed · exp(-steepness · |rise / length - best_slope|) of the length on the map.

    Notes
    -----
    W. Tobler, Three presentations on geographical analysis and modeling, NCGIA technical report 93-1, 1993:
    W = 6 exp(-3.5 |S + 0.05|) km/h; off paths 3/5 of it, on horseback 5/4. Heights are worth
    the function's gradient on level ground: as it is convex, no slope has a cheaper metre then.
    """

    top_speed_km_h: float = 6.0
    """On the best slope."""
    steepness: float = 3.5
    best_slope: float = -0.05
    """Rise a metre of length."""
    factor: float = 1.0
    """Of the speed: 0.6 off paths, 1.25 on horseback."""
    unit: ClassVar[str] = "s"

    def __post_init__(self) -> None:
        """Refuse what is no speed: InvalidQueryError."""
        _check(
            self, above_0=("top_speed_km_h", "factor"), not_below_0=("steepness",), between={"best_slope": (-1, 1)}
        )

    def cost(self, length_m: ArrayLike, rise_m: ArrayLike) -> Float64s:
        """Seconds."""
        length = np.asarray(length_m, np.float64)
        off = self.steepness * np.abs(np.asarray(rise_m, np.float64) / length - self.best_slope)
        best = 3.6 / (self.top_speed_km_h * self.factor)
        seconds: Float64s = length * best * np.exp(np.minimum(off, LARGEST_EXPONENT))
        return seconds

    @property
    def height_price(self) -> float:
        """Seconds."""
        return -math.copysign(self.steepness, self.best_slope) * self.least_per_m if self.best_slope else 0.0

    @property
    def least_per_m(self) -> float:
        """Seconds of a level metre."""
        return float(self.cost(1.0, 0.0))

    @property
    def packed(self) -> Packed:
        """As `SlopeCost`."""
        best = 3.6 / (self.top_speed_km_h * self.factor)
        return TOBLER, np.array((best, self.steepness, self.best_slope), np.float64)


@checked(InvalidQueryError)
@dataclass(frozen=True)
class LinearCost:
    """So much a metre on the map, a metre climbed and a metre descended.

    Notes
    -----
    GRASS GIS, r.walk (Aitken 1977, Langmuir 1984, after Naismith's rule): T = a ΔS + b ΔH uphill + c ΔH moderate
    downhill + d ΔH steep downhill, seconds, with walk_coeff 0.72, 6.0, 1.9998, -1.9998 and slope_factor -0.2125 (the
    tangent of 12°). Its ΔH of a descent is below 0, so `down_per_m` is -c and `steep_down_per_m` is -d: a gentle
    descent saves time. Heights are worth what that saves; the cheapest metre is a level one then.
    """

    level_per_m: float = 0.72
    up_per_m: float = 6.0
    """Of a metre climbed, beside the way itself."""
    down_per_m: float = -1.9998
    """Of a metre descended where it is not steep; below 0 where that saves."""
    steep_down_per_m: float = 1.9998
    """Of a metre descended (all of it) where the slope is below `steep_slope`."""
    steep_slope: float = -0.2125
    """Rise a metre of length; a descent beyond it is steep."""
    unit: ClassVar[str] = ""

    def __post_init__(self) -> None:
        """Refuse what would make some way cost nothing, or less: InvalidQueryError."""
        _check(self, above_0=("level_per_m",), not_below_0=("up_per_m", "steep_down_per_m"))
        if not -math.inf < self.steep_slope <= 0.0:
            raise InvalidQueryError(f"steep_slope must be a finite number, at most 0, got {self.steep_slope}")
        gentle = self.level_per_m - self.down_per_m * self.steep_slope
        if not (gentle > 0.0 and self.down_per_m < math.inf):
            raise InvalidQueryError(
                "every way must cost more than 0: wanted level_per_m - down_per_m * steep_slope above 0, got "
                f"{self.level_per_m:g} - {self.down_per_m:g} * {self.steep_slope:g}"
            )

    def cost(self, length_m: ArrayLike, rise_m: ArrayLike) -> Float64s:
        """In the coefficients' unit, seconds for r.walk's."""
        length, rise = np.asarray(length_m, np.float64), np.asarray(rise_m, np.float64)
        down = np.where(rise < self.steep_slope * length, self.steep_down_per_m, self.down_per_m)
        cost: Float64s = length * self.level_per_m + np.where(rise >= 0.0, self.up_per_m * rise, -down * rise)
        return cost[()]

    @property
    def height_price(self) -> float:
        """Savings of a gentle descent, but no more than an ascent takes."""
        return min(max(-self.down_per_m, 0.0), self.up_per_m)

    @property
    def least_per_m(self) -> float:
        """The cheaper of a level metre and one that is just not steep."""
        gentle = self.level_per_m - (self.down_per_m + self.height_price) * self.steep_slope
        return min(self.level_per_m, gentle)

    @property
    def packed(self) -> Packed:
        """As `SlopeCost`."""
        of_slopes = self.up_per_m, self.down_per_m, self.steep_down_per_m, self.steep_slope
        return LINEAR, np.array((self.level_per_m, *of_slopes), np.float64)


@checked(InvalidQueryError)
@dataclass(frozen=True)
class TimeCost:
    """Seconds of a vehicle whose speed on the ground depends on the slope that it goes up or down.

    The speed is linear between the slopes that were measured, and beyond them that of the nearest. Slip on loose
    ground is part of it: what counts is the way made good.
    """

    slope_deg: tuple[float, ...]
    """Inclinations along the way in (-90, 90), ascending; below 0 downhill."""
    speed_m_s: tuple[float, ...]
    """Speed on each of them, metres of ground a second."""
    unit: ClassVar[str] = "s"

    @classmethod
    @checked(InvalidQueryError)
    def of_speed(cls, speed: Callable[[Float64s], Float64s]) -> "TimeCost":
        """The table, at every other percent from -100 to 100, of a speed on the map by the rise a metre."""
        slopes = np.linspace(-1.0, 1.0, 101)
        speeds = speed(slopes)
        if (wrong := ~((speeds > 0.0) & (speeds < math.inf))).any():
            at, found = 100.0 * slopes[wrong][0], speeds[wrong][0]
            raise InvalidQueryError(f"a speed must be above 0 from -100 to 100 %, got {found:g} at {at:.0f} %")
        return cls(tuple(np.degrees(np.arctan(slopes)).tolist()), tuple((speeds * np.hypot(1.0, slopes)).tolist()))

    def __post_init__(self) -> None:
        """Refuse what is no table of speeds: InvalidQueryError."""
        slopes, speeds = self.slope_deg, self.speed_m_s
        if not 1 <= len(slopes) == len(speeds):
            raise InvalidQueryError(
                f"speed_m_s must have a speed for each slope_deg, got {len(speeds)} of {len(slopes)}"
            )
        if not all(-90.0 < slope < 90.0 for slope in slopes) or any(np.diff(slopes) <= 0.0):
            raise InvalidQueryError(f"slope_deg must ascend within (-90, 90) degrees, got {list(slopes)}")
        if 0.0 < max(map(abs, slopes)) <= 0.5 * math.pi:
            raise InvalidQueryError(f"slope_deg must be in degrees, some beyond ±1.57, got {list(slopes)}: radians?")
        if not all(0.0 < speed < math.inf for speed in speeds):
            raise InvalidQueryError(f"speed_m_s must be positive numbers, got {list(speeds)}")

    def speed(self, slope_rad: ArrayLike) -> Float64s:
        """Metres of ground a second on slopes, radians."""
        return np.interp(np.asarray(slope_rad, np.float64), np.radians(self.slope_deg), self.speed_m_s)

    def cost(self, length_m: ArrayLike, rise_m: ArrayLike) -> Float64s:
        """Seconds."""
        length, rise = np.asarray(length_m, np.float64), np.asarray(rise_m, np.float64)
        seconds: Float64s = np.hypot(length, rise) / self.speed(np.arctan2(rise, length))
        return seconds

    @property
    def height_price(self) -> float:
        """Nothing: time never runs back."""
        return 0.0

    @property
    def least_per_m(self) -> float:
        """The cheapest metre over all slopes."""
        slopes = np.radians((-90.0, *self.slope_deg, 90.0))
        speeds = (self.speed_m_s[0], *self.speed_m_s, self.speed_m_s[-1])
        ends = zip(slopes[:-1], slopes[1:], speeds[:-1], speeds[1:], strict=True)
        return 1.0 / max(_fastest(*segment) for segment in ends)

    @property
    def packed(self) -> Packed:
        """As `SlopeCost`."""
        return TIME, np.array((*np.radians(self.slope_deg), *self.speed_m_s), np.float64)


class SpeedCost(ABC):
    """Seconds by a speed on the map that depends on the slope. A subclass has the speed; no kernel has to know it.

    Costs are those of a `table` of the speed, so that searches and figures agree. It has the speed itself at every
    other percent; between two of them it is off by less than 0.1 %, if the speed is as smooth as the one here.
    """

    unit: ClassVar[str] = "s"
    function: ClassVar[str]
    """Whose it is, as a plan tells it."""

    @abstractmethod
    def speed(self, slope: Float64s) -> Float64s:
        """Metres on the map a second, above 0, by the rise a metre of length."""

    @cached_property
    def table(self) -> TimeCost:
        """Speeds on the ground, on slopes up to 45°; beyond, what they are there."""
        return TimeCost.of_speed(self.speed)

    def cost(self, length_m: ArrayLike, rise_m: ArrayLike) -> Float64s:
        """Seconds."""
        return self.table.cost(length_m, rise_m)

    @property
    def height_price(self) -> float:
        """Nothing, as of a `TimeCost`."""
        return self.table.height_price

    @cached_property
    def least_per_m(self) -> float:
        """Seconds of a metre on the best slope."""
        return self.table.least_per_m

    @property
    def packed(self) -> Packed:
        """As `SlopeCost`."""
        return self.table.packed


@checked(InvalidQueryError)
@dataclass(frozen=True)
class IrmischerCost(SpeedCost):
    """Seconds of somebody who finds the way on foot with a map, off paths or on them.

    Notes
    -----
    I. J. Irmischer and K. C. Clarke, Measuring and modeling the speed of human navigation, Cartography and Geographic
    Information Science 45 (2), 2018, from the tracks of 200 people in wooded country: with the slope s in percent,
    0.11 + 0.67 exp(-(s + 2)² / (2·30²)) m/s off paths, 0.11 + exp(-(s + 5)² / (2·30²)) on them; women 0.95 of it.
    """

    on_path: bool = False
    factor: float = 1.0
    """Of the speed: 0.95 for women."""
    function: ClassVar[str] = "Irmischer and Clarke's function"

    def __post_init__(self) -> None:
        """Refuse what is no speed: InvalidQueryError."""
        _check(self, above_0=("factor",))

    def speed(self, slope: Float64s) -> Float64s:
        """As `SpeedCost`."""
        gain, best = (1.0, -5.0) if self.on_path else (0.67, -2.0)
        return self.factor * (0.11 + gain * np.exp(-((100.0 * slope - best) ** 2) / (2.0 * 30.0**2)))


@checked(InvalidQueryError)
@dataclass(frozen=True)
class EnergyCost:
    """Joules that a vehicle draws, less what it gets back.

    Against its weight and its rolling resistance a vehicle does F = m g (μ length + rise) on a way, as the resistance
    m g μ cos θ along length / cos θ of ground does not depend on the slope. It draws F / efficiency where F is above
    0. Below, it brakes, and gets `recovery` · |F| back. `idle_w` it draws besides, for as long as it goes.

    Notes
    -----
    N. C. Rowe and R. S. Ross, Optimal grid-free path planning across arbitrarily contoured terrain with anisotropic
    friction and gravity effects, IEEE Transactions on Robotics and Automation 6 (5), 1990: on slopes below -atan μ a
    vehicle brakes. Here its drive has an efficiency and a recovery; with that a descent can cost less than nothing.
    A metre of height is worth m g / efficiency. What is left then is what rolling takes on slopes down to -atan μ,
    and more below.
    """

    mass_kg: float
    rolling_resistance: float
    """μ, force a newton of weight: 0.01-0.02 on hard ground, 0.1-0.3 on sand."""
    efficiency: float = 1.0
    """Share of what is drawn that moves the vehicle, in (0, 1]."""
    recovery: float = 0.0
    """Share of what braking takes that is got back, in [0, 1]."""
    gravity_m_s2: float = 9.80665
    idle_w: float = 0.0
    """Power that is drawn all the time, by computers and heaters."""
    speed_m_s: float | None = None
    """On the ground; needed with `idle_w`."""
    unit: ClassVar[str] = "J"

    def __post_init__(self) -> None:
        """Refuse what no vehicle has: InvalidQueryError."""
        _check(
            self,
            above_0=("mass_kg", "rolling_resistance", "gravity_m_s2"),
            not_below_0=("idle_w",),
            between={"efficiency": (0, 1), "recovery": (0, 1)},
        )
        if self.efficiency == 0.0:
            raise InvalidQueryError("efficiency must lie in (0, 1], got 0")
        if self.speed_m_s is not None:
            _check(self, above_0=("speed_m_s",))
        elif self.idle_w:
            raise InvalidQueryError("idle_w needs a speed_m_s: how long a metre takes")

    def cost(self, length_m: ArrayLike, rise_m: ArrayLike) -> Float64s:
        """Joules; below 0 where more is got back than drawn."""
        length, rise = np.asarray(length_m, np.float64), np.asarray(rise_m, np.float64)
        work = self.mass_kg * self.gravity_m_s2 * (self.rolling_resistance * length + rise)
        joules: Float64s = np.maximum(work / self.efficiency, self.recovery * work)
        return joules + self._idle_per_m * np.hypot(length, rise)

    @property
    def _idle_per_m(self) -> float:
        return 0.0 if self.speed_m_s is None else self.idle_w / self.speed_m_s

    @property
    def height_price(self) -> float:
        """Joules that a metre of height takes."""
        return self.mass_kg * self.gravity_m_s2 / self.efficiency

    @property
    def least_per_m(self) -> float:
        """Joules of a level metre, and so of any that does not go down too steeply to roll."""
        return self.height_price * self.rolling_resistance + self._idle_per_m

    @property
    def packed(self) -> Packed:
        """As `SlopeCost`."""
        weight = self.mass_kg * self.gravity_m_s2
        shares = self.rolling_resistance, self.efficiency, self.recovery, self._idle_per_m
        return ENERGY, np.array((weight, *shares), np.float64)


SLOPE_COSTS: dict[str, type[SlopeCost]] = {
    "tobler": ToblerCost,
    "irmischer": IrmischerCost,
    "linear": LinearCost,
    "time": TimeCost,
    "energy": EnergyCost,
}
"""The step costs that go by the slope, by name."""


def unit_of(step_cost: str) -> str:
    """Of costs by any step cost; empty where they have none."""
    return SLOPE_COSTS[step_cost].unit if step_cost in SLOPE_COSTS else ""


@checked(InvalidQueryError)
@dataclass(frozen=True)
class Mobility:
    """How a vehicle gets up and down: the optional table ``[mobility]`` of its file, one table a model."""

    tobler: ToblerCost = field(default_factory=ToblerCost)
    linear: LinearCost = field(default_factory=LinearCost)
    time: TimeCost | None = None
    energy: EnergyCost | None = None
    irmischer: IrmischerCost = field(default_factory=IrmischerCost)

    def under(self, gravity_m_s2: float) -> "Mobility":
        """This model under another gravity, on which energy depends."""
        return self if self.energy is None else replace(self, energy=replace(self.energy, gravity_m_s2=gravity_m_s2))

    def model(self, step_cost: str) -> SlopeCost:
        """The model of that ``step_cost``; InvalidQueryError where there is none, or its table is missing."""
        if step_cost not in SLOPE_COSTS:
            raise InvalidQueryError(f"step_cost must be one of paper, {', '.join(SLOPE_COSTS)}, got {step_cost!r}")
        found: SlopeCost | None = getattr(self, step_cost)
        if found is None:
            wanted = "slope_deg and speed_m_s" if step_cost == "time" else "mass_kg and rolling_resistance"
            raise InvalidQueryError(
                f"step_cost={step_cost!r} needs a table [mobility.{step_cost}] with {wanted}, such as the shipped "
                "vehicles have (--mobility small-rover, or load_mobility)"
            )
        return found


def slope_cost_of(step_cost: str, mobility: Mobility | None = None) -> SlopeCost | None:
    """The model that a map of elevations is planned on by; None for ``paper``, whose steps cost alike both ways.

    InvalidQueryError for a step cost that there is none of, or whose model needs a mobility.
    """
    if step_cost == "paper":
        return None
    return (mobility or Mobility()).model(step_cost)


def _fastest(low: float, high: float, speed_low: float, speed_high: float) -> float:
    """Most metres on the map a second between two slopes, radians, between which the speed on the ground is linear.

    The logarithm of cos θ · speed(θ) is concave: its greatest value lies where the derivative changes its sign.
    """
    gain = (speed_high - speed_low) / (high - low)
    first, last = low, high
    for _ in range(64):
        middle = 0.5 * (first + last)
        if gain * math.cos(middle) > (speed_low + gain * (middle - low)) * math.sin(middle):
            first = middle
        else:
            last = middle
    return math.cos(first) * (speed_low + gain * (first - low))


def _check(
    model: object,
    *,
    above_0: tuple[str, ...] = (),
    not_below_0: tuple[str, ...] = (),
    between: dict[str, tuple[int, int]] | None = None,
) -> None:
    """InvalidQueryError for the first value of a model that is out of range."""
    for names, least, wanted in ((above_0, math.ulp(0.0), "above 0"), (not_below_0, 0.0, "at least 0")):
        for name in names:
            if not least <= (value := getattr(model, name)) < math.inf:
                raise InvalidQueryError(f"{name} must be a number {wanted}, got {value}")
    for name, (low, high) in (between or {}).items():
        if not low <= (value := getattr(model, name)) <= high:
            raise InvalidQueryError(f"{name} must lie from {low} to {high}, got {value}")
