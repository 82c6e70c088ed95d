"""Costs of a way up or down: time or energy of a length on the map and a signed rise.

Every model is a function of the slope, of which a table is made: what a metre on the map costs,
linear between knots at every 1024th and where the function has kinks. Searches, plans and figures
go by it: one formula prices steps. Models price the slope alone: whether a cell can be stood on is
decided by the traversability (or a body's poses).

- ``tobler``: seconds of a hiker (`ToblerCost`).
- ``linear``: so much a metre of the way, a metre climbed and a metre descended, as r.walk
  (`LinearCost`).
- ``time``: seconds of a vehicle whose speed depends on the slope (`TimeCost`).
- ``energy``: joules of a vehicle with a mass, a rolling resistance, an efficiency and a recovery
  (`EnergyCost`).
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnpp_edge.runtime.arguments import ABOVE_0, FROM_0, MOST, check_ranges, checked
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Sides
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.directed import PER_SLOPE, STEEPEST

Float64s = NDArray[np.float64]
Slopes = tuple[float, ...]
_LARGEST_EXPONENT = 60.0
"""Of Tobler's function, so that no wall's cost overflows: 0.6 s · e^60 a metre."""
_FAR_OFF = 1e6
"""Rise a metre up to which no metre is cheaper than the cheapest."""
Table = tuple[Float64s, Float64s, Float64s]
"""Cost of a metre on the map by segments of slopes: (K,) kinks among the knots, (N,) level of
each segment, and (N,) gradient, which counts times the slope. The segments at the ends hold
beyond them too."""


class SlopeCost(ABC):
    """A model of what a way costs. A subclass has the cost of a metre; no kernel has to know it."""

    unit: ClassVar[str] = "s"
    """Of its costs; empty where that is its coefficients'."""
    function: ClassVar[str] = ""
    """Whose it is, as a plan tells it: of models of a walker."""
    symmetric: ClassVar[bool] = False
    """Whether steps cost the same both ways: all is said by `ground`, and `per_m` is the same on
    every slope. Landmarks and any angle serve then, and a cell takes 4 bytes, not 32.
    """

    @property
    def kinks(self) -> Slopes:
        """Slopes, rise a metre, where the cost jumps or its gradient does."""
        return ()

    @abstractmethod
    def per_m(self, slope: Float64s) -> Float64s:
        """Cost of a metre on the map, by the rise a metre; at a jump that of the slopes
        above it.
        """

    def ground(self, dem: Float2D, sides_m: Sides) -> Float2D:
        """How many times as dear a metre is on each cell of a map of heights, (H, W) from 1 up; (0,
        0) where that does not count.

        It may depend on the cell's height and on those of its eight neighbours, as the terms of
        Eq. 1 do (`terrain_terms`). A step's factor is the mean of those of the cells at both ends;
        no metre may cost less than 0 then.
        """
        return np.empty((0, 0), np.float32)

    @cached_property
    def table(self) -> Table:
        """By which all is priced."""
        kinks = np.array([kink for kink in self.kinks if abs(kink) < STEEPEST])
        knots = _knots(kinks)
        first = self.per_m(knots[:-1])
        last = self.per_m(np.nextafter(knots[1:], -math.inf))
        wide = np.diff(knots)  # 0 where a kink lies on another knot: of no slope
        gradient = (last - first) / np.where(wide > 0.0, wide, math.inf)
        return kinks, first - gradient * knots[:-1], gradient

    def cost(self, length_m: ArrayLike, rise_m: ArrayLike) -> Float64s:
        """Cost of ways, by the table; of energy below 0 where more is got back than drawn.

        Parameters
        ----------
        length_m, rise_m : float or (…) float
            Length on the map, above 0, and signed rise. They are broadcast; of two numbers comes
            one.
        """
        kinks, level, gradient = self.table
        length = np.asarray(length_m)
        rise = np.asarray(rise_m)
        last = len(level) - len(kinks) - 1
        steps = rise / length * PER_SLOPE + STEEPEST * PER_SLOPE
        at = np.nan_to_num(steps).clip(0, last).astype(np.int64)
        at = at + (rise[..., None] >= kinks * length[..., None]).sum(-1)
        cost: Float64s = level[at] * length + gradient[at] * rise
        return cost

    @cached_property
    def _worth(self) -> tuple[float, float]:
        """`height_price` and `least_per_m`.

        Of the lines that lie above no knot, gradient and height on level ground of that which is
        highest there. It touches a knot downhill and one uphill, which are sought from far off, or
        that of level ground.
        """
        kinks, level, gradient = self.table
        knots = _knots(kinks)
        at = np.arange(len(level))
        slopes = np.concatenate(((-_FAR_OFF,), knots[:-1], knots[1:], (_FAR_OFF,)))
        at = np.concatenate((at[:1], at, at, at[-1:]))
        costs = level[at] + gradient[at] * slopes
        down = 0
        up = len(slopes) - 1
        lowest = -1
        while True:
            price = (costs[up] - costs[down]) / (slopes[up] - slopes[down])
            left = costs - price * slopes
            before = lowest
            lowest = int(left.argmin())
            if slopes[lowest] == 0.0 or lowest in (before, down, up):
                return float(price), float(left[lowest])
            down, up = (lowest, up) if slopes[lowest] < 0.0 else (down, lowest)

    @property
    def height_price(self) -> float:
        """Worth of a metre of height to searches, which go by cost(length, rise) - height_price ·
        rise.

        A path's cost is the sum of these and the price of the height between its ends, whichever
        way it goes: which path is the cheapest does not depend on it. This is the price by which
        the cheapest metre costs the most: a search knows well what is left then, also where a way
        may cost less than nothing.
        """
        return self._worth[0]

    @property
    def least_per_m(self) -> float:
        """The cheapest metre on the map over all slopes, less what its rise is worth; above 0."""
        return self._worth[1]


def _knots(kinks: Float64s) -> Float64s:
    """(N + 1,) slopes between which the segments of a table lie."""
    return np.sort(
        np.append(np.linspace(-STEEPEST, STEEPEST, round(2 * STEEPEST * PER_SLOPE) + 1), kinks)
    )


@checked(InvalidQueryError)
@dataclass(frozen=True)
class ToblerCost(SlopeCost):
    """Seconds of a hiker: W = speed · exp(-steepness · |rise / length - best_slope|) of the length
    on the map.

    Notes
    -----
    W. Tobler, Three presentations on geographical analysis and modeling, NCGIA technical report
    93-1, 1993: W = 6 exp(-3.5 |S + 0.05|) km/h; off paths 3/5 of it, on horseback 5/4.
    """

    top_speed_km_h: float = 6.0
    """On the best slope."""
    steepness: float = 3.5
    best_slope: float = -0.05
    """Rise a metre of length."""
    factor: float = 1.0
    """Of the speed: 0.6 off paths, 1.25 on horseback."""
    function: ClassVar[str] = "Tobler's function"

    def __post_init__(self) -> None:
        """Refuse what is no speed: InvalidQueryError."""
        check_ranges(
            self,
            InvalidQueryError,
            top_speed_km_h=ABOVE_0,
            steepness=FROM_0,
            best_slope=(-1.0, 1.0, "a number from -1 to 1"),
            factor=ABOVE_0,
        )

    @property
    def kinks(self) -> Slopes:
        return (self.best_slope,)

    def per_m(self, slope: Float64s) -> Float64s:
        off = np.minimum(self.steepness * np.abs(slope - self.best_slope), _LARGEST_EXPONENT)
        return 3.6 / (self.top_speed_km_h * self.factor) * np.exp(off)


@checked(InvalidQueryError)
@dataclass(frozen=True)
class LinearCost(SlopeCost):
    """Cost for each metre on the map, metre climbed and metre descended.

    Notes
    -----
    GRASS GIS, r.walk (Aitken 1977, Langmuir 1984, after Naismith's rule): T = a ΔS + b ΔH uphill +
    c ΔH moderate downhill + d ΔH steep downhill, seconds, with walk_coeff 0.72, 6.0, 1.9998,
    -1.9998 and slope_factor -0.2125 (the tangent of 12°). Its ΔH of a descent is below 0, so
    `down_per_m` is -c and `steep_down_per_m` is -d: a gentle descent saves time.
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
        check_ranges(
            self,
            InvalidQueryError,
            level_per_m=ABOVE_0,
            up_per_m=FROM_0,
            steep_down_per_m=FROM_0,
            steep_slope=(-MOST, 0.0, "a number of at most 0"),
        )
        gentle = self.level_per_m - self.down_per_m * self.steep_slope
        if not (gentle > 0.0 and self.down_per_m < math.inf):
            raise InvalidQueryError(
                "every way must cost more than 0: wanted level_per_m - down_per_m * steep_slope "
                "above 0, got "
                f"{self.level_per_m:g} - {self.down_per_m:g} * {self.steep_slope:g}"
            )

    @property
    def kinks(self) -> Slopes:
        return (self.steep_slope,)

    def per_m(self, slope: Float64s) -> Float64s:
        down = np.where(slope < self.steep_slope, self.steep_down_per_m, self.down_per_m)
        return self.level_per_m + np.where(slope >= 0.0, self.up_per_m, -down) * slope


@checked(InvalidQueryError)
@dataclass(frozen=True)
class TimeCost(SlopeCost):
    """Seconds of a vehicle whose speed on the ground depends on the slope that it goes up or down.

    The speed is linear between the slopes that were measured, and beyond them that of the nearest.
    Slip on loose ground is part of it: what counts is the way made good.
    """

    slope_deg: tuple[float, ...]
    """Inclinations along the way in (-90, 90), ascending; below 0 downhill."""
    speed_m_s: tuple[float, ...]
    """Speed on each of them, metres of ground a second."""

    def __post_init__(self) -> None:
        """Refuse what is no table of speeds: InvalidQueryError."""
        slopes = self.slope_deg
        speeds = self.speed_m_s
        if not 1 <= len(slopes) == len(speeds):
            raise InvalidQueryError(
                f"speed_m_s must have a speed for each slope_deg, got {len(speeds)} of "
                f"{len(slopes)}"
            )
        if not all(-90.0 < slope < 90.0 for slope in slopes) or any(np.diff(slopes) <= 0.0):
            raise InvalidQueryError(
                f"slope_deg must ascend within (-90, 90) degrees, got {list(slopes)}"
            )
        if 0.0 < max(map(abs, slopes)) <= 0.5 * math.pi:
            raise InvalidQueryError(
                f"slope_deg must be in degrees, some beyond ±1.57, got {list(slopes)}: radians?"
            )
        if not all(0.0 < speed < math.inf for speed in speeds):
            raise InvalidQueryError(f"speed_m_s must be positive numbers, got {list(speeds)}")

    @property
    def kinks(self) -> Slopes:
        return tuple(np.tan(np.radians(self.slope_deg)).tolist())

    def per_m(self, slope: Float64s) -> Float64s:
        return np.hypot(1.0, slope) / np.interp(
            np.arctan(slope), np.radians(self.slope_deg), self.speed_m_s
        )


@checked(InvalidQueryError)
@dataclass(frozen=True)
class EnergyCost(SlopeCost):
    """Joules that a vehicle uses, less the energy that it recovers.

    Against its weight and its rolling resistance a vehicle does F = m g (μ length + rise) on a way,
    as the resistance m g μ cos θ along length / cos θ of ground does not depend on the slope. It
    draws F / efficiency where F is above 0. Below, it brakes, and gets `recovery` · |F| back.
    `idle_w` it draws besides, for as long as it goes.

    Notes
    -----
    N. C. Rowe and R. S. Ross, Optimal grid-free path planning across arbitrarily contoured terrain
    with anisotropic friction and gravity effects, IEEE Transactions on Robotics and Automation 6
    (5), 1990: on slopes below -atan μ a vehicle brakes. Here its drive has an efficiency and a
    recovery; with that a descent can cost less than nothing.
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
        check_ranges(
            self,
            InvalidQueryError,
            mass_kg=ABOVE_0,
            rolling_resistance=ABOVE_0,
            efficiency=(math.ulp(0.0), 1.0, "a number in (0, 1]"),
            recovery=(0.0, 1.0, "a number from 0 to 1"),
            gravity_m_s2=ABOVE_0,
            idle_w=FROM_0,
            speed_m_s=ABOVE_0,
        )
        if self.idle_w and self.speed_m_s is None:
            raise InvalidQueryError("idle_w needs a speed_m_s: how long a metre takes")

    @property
    def kinks(self) -> Slopes:
        return (-self.rolling_resistance,)

    def per_m(self, slope: Float64s) -> Float64s:
        work = self.mass_kg * self.gravity_m_s2 * (self.rolling_resistance + slope)
        idle_per_m = 0.0 if self.speed_m_s is None else self.idle_w / self.speed_m_s
        return np.maximum(work / self.efficiency, self.recovery * work) + idle_per_m * np.hypot(
            1.0, slope
        )


SLOPE_COSTS: dict[str, type[SlopeCost]] = {
    "tobler": ToblerCost,
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
    """Costs of slopes for a vehicle: the optional table ``[mobility]`` of its file, one table a
    model.
    """

    tobler: ToblerCost = ToblerCost()
    linear: LinearCost = LinearCost()
    time: TimeCost | None = None
    energy: EnergyCost | None = None

    def under(self, gravity_m_s2: float) -> "Mobility":
        """This model under another gravity, on which energy depends."""
        energy = self.energy and replace(self.energy, gravity_m_s2=gravity_m_s2)
        return replace(self, energy=energy)

    def model(self, step_cost: str) -> SlopeCost:
        """The model of that ``step_cost``; InvalidQueryError where there is none, or its table is
        missing.
        """
        if step_cost not in SLOPE_COSTS:
            raise InvalidQueryError(
                f"step_cost must be one of paper, {', '.join(SLOPE_COSTS)}, got {step_cost!r}"
            )
        found: SlopeCost | None = getattr(self, step_cost)
        if found is None:
            wanted = (
                "slope_deg and speed_m_s"
                if step_cost == "time"
                else "mass_kg and rolling_resistance"
            )
            raise InvalidQueryError(
                f"step_cost={step_cost!r} needs a table [mobility.{step_cost}] with {wanted}, "
                "such as the shipped "
                "vehicles have (--mobility small-rover, or load_mobility)"
            )
        return found
