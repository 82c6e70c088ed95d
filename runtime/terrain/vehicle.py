"""The robot's body: what it measures, and what it can take. See docs/vehicle.md."""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arguments import ABOVE_0, MOST, Range, check_ranges, checked
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.options import KINDS, Kind

_INSIDE = 1e-9
"""Share by which the wheels may lie outside the body."""
_LARGEST_M = 250.0
_THINNEST = 50.0
_TALLEST = 3.0
_WIDEST_TURN = 100.0
"""Longest side of a body, and by the shorter one; highest clearance and widest turn by the longer
one. What is beyond is in another unit than metres.
"""
_ANGLE = (
    math.nextafter(0.5 * math.pi, 90.0),
    math.nextafter(90.0, 0.0),
    "in degrees, above 1.57 (else radians) and below 90",
)
_SHARE = 0.0, math.nextafter(1.0, 0.0), "a share in [0, 1)"


@checked(InvalidMapError)
@dataclass(frozen=True)
class Vehicle:
    """A body on wheels, or on tracks, each of which is a row of wheels with long contact patches;
    or a disc.

    The wheels are in pairs, symmetric about the body's middle, on `axles` axles that are evenly
    spaced over the wheelbase. A disc has a radius and nothing else: it may not touch impassable
    cells, and needs no elevations.
    """

    length_m: float = 0.0
    """Of the body, along its heading."""
    width_m: float = 0.0
    clearance_m: float = 0.0
    """Height of the belly above the plane of the wheels' contacts."""
    max_tilt_deg: float = 25.0
    """Steepest inclination of the body in any direction, in (0, 90)."""
    max_pitch_deg: float | None = None
    max_roll_deg: float | None = None
    """Steepest inclination along the heading, and across it; None for the tilt's."""
    max_step_m: float | None = None
    """Greatest difference of heights under one wheel's contact patch; None for the clearance."""
    axles: int = 2
    wheelbase_m: float | None = None
    track_m: float | None = None
    """From first axle to last, and from left wheels' middles to right ones'; None for the body less
    a wheel.
    """
    wheel_length_m: float | None = None
    wheel_width_m: float | None = None
    """Of a contact patch, along the heading and across it; None for an eighth of the body's."""
    reserve: float = 0.0
    """Share of every limit of tilt, pitch, roll, step and clearance left free, in [0, 1)."""
    unknown_passes: bool = False
    """Whether unknown cells count as no higher and no lower than those that are known; else none
    may lie below.
    """
    radius_m: float | None = None
    """Of a disc."""
    turning_radius_m: float | None = None
    """Of the sharpest arc that a body drives; None for one that drives straight and turns on the
    spot."""
    turn_cost_m_per_rad: float | None = None
    """Metres of level ground as dear as a turn on the spot by a radian; None for the way that
    each wheel rolls in it: half the diagonal from wheel to wheel."""
    turns_on_spot: bool | None = None
    """Whether a body can turn without rolling on; None for one that drives no arcs."""
    reverse_cost: float | None = None
    """How many times as dear arcs and straight ways are backwards, at least 1; None where it never
    drives so.
    """
    gear_change_m: float = 0.0
    """Metres of level ground as dear as each change from forwards to backwards, or back."""

    def __post_init__(self) -> None:
        if self.as_body is None:
            check_ranges(self, InvalidMapError, radius_m=_metres(_LARGEST_M))
            kind = self.kind
            given = {each.name for each in fields(self) if getattr(self, each.name) != each.default}
            if given - {kind.key}:
                raise InvalidMapError(
                    f"a vehicle with {kind.key} is a {kind.name}: wanted no other values beside "
                    f"{kind.key}"
                )
            return
        for most in (_LARGEST_M, _THINNEST * min(self.length_m, self.width_m)):
            check_ranges(self, InvalidMapError, length_m=_metres(most), width_m=_metres(most))
        longest = max(self.length_m, self.width_m)
        height = _metres(_TALLEST * longest)
        widest = _WIDEST_TURN * longest
        turn_cost = 0.0, widest, f"a number of metres from 0 to {widest:g}"
        check_ranges(
            self,
            InvalidMapError,
            clearance_m=height,
            max_step_m=height,
            turning_radius_m=_metres(widest),
            reverse_cost=(1.0, MOST, "a number of at least 1"),
            wheelbase_m=ABOVE_0,
            track_m=ABOVE_0,
            wheel_length_m=ABOVE_0,
            wheel_width_m=ABOVE_0,
            max_tilt_deg=_ANGLE,
            max_pitch_deg=_ANGLE,
            max_roll_deg=_ANGLE,
            reserve=_SHARE,
            axles=(2, 8, "a whole number from 2 to 8"),
            gear_change_m=turn_cost,
            turn_cost_m_per_rad=turn_cost,
        )
        if self.turning_radius_m is None and (
            self.turns_on_spot is False or self.reverse_cost or self.gear_change_m
        ):
            raise InvalidMapError(
                "a body that turns on the spot alone drives no arcs: wanted a turning_radius_m"
            )
        names = ("wheelbase_m", "track_m")
        sides = (self.length_m, self.width_m)
        for name, apart, contact, most in zip(
            names, self.stance_m, self.contact_m, sides, strict=True
        ):
            if not 0.0 < apart <= (most - contact) * (1.0 + _INSIDE):
                raise InvalidMapError(
                    f"the wheels must lie under the body: {name} must be at most {most:g} m less "
                    "a contact patch of "
                    f"{contact:g} m and more than 0, got {apart:g}"
                )

    @property
    def kind(self) -> Kind:
        """Its kind."""
        return next(kind for kind in KINDS if getattr(self, kind.key) is not None)

    @property
    def as_body(self) -> "Vehicle | None":
        """Itself, if its poses decide where paths may go; else None."""
        return self if self.kind.name == "body" else None

    @property
    def bytes_per_cell(self) -> int:
        """Memory that planning takes, beside a point's.

        For a body a height, a code for each motion, and g and parent of each state: a direction,
        and a gear where a change costs. A disc has a point's map beside its own.
        """
        if self.as_body is None:
            return 12
        motions_of_cell = 16 if self.turning_radius_m is None else 32
        gears = 2 if self.reverse_cost is not None and self.gear_change_m else 1
        return 4 + 2 * motions_of_cell + 8 * gears * 16

    @property
    def can_turn_on_spot(self) -> bool:
        """Whether a body can turn without rolling on."""
        return self.turning_radius_m is None if self.turns_on_spot is None else self.turns_on_spot

    @property
    def contact_m(self) -> tuple[float, float]:
        """Length and width of a wheel's contact patch."""
        return self.wheel_length_m or self.length_m / 8.0, self.wheel_width_m or self.width_m / 8.0

    @property
    def stance_m(self) -> tuple[float, float]:
        """Wheelbase and track."""
        long, wide = self.contact_m
        return self.wheelbase_m or self.length_m - long, self.track_m or self.width_m - wide

    @property
    def wheels_m(self) -> NDArray[np.float64]:
        """(W, 2) middles of the contact patches, ahead of the body's middle and to the
        left of it.
        """
        base, track = self.stance_m
        ahead = np.linspace(-0.5, 0.5, self.axles) * base
        return np.array([(along, side * track) for along in ahead for side in (-0.5, 0.5)])

    @property
    def step_m(self) -> float:
        """Greatest difference of heights under a contact patch."""
        return self.max_step_m or self.clearance_m

    @property
    def tilts_deg(self) -> tuple[float, float, float]:
        """Steepest pitch, roll and tilt."""
        tilt = self.max_tilt_deg
        return self.max_pitch_deg or tilt, self.max_roll_deg or tilt, tilt

    @property
    def allowances(self) -> tuple[float, float, float, float, float]:
        """The most that is allowed of tilt, pitch and roll, degrees, of the difference of heights
        under a wheel and of the ground's rise below the belly, metres: the limits less the reserve.
        """
        pitch, roll, tilt = self.tilts_deg
        used = 1.0 - self.reserve
        return tilt * used, pitch * used, roll * used, self.step_m * used, self.clearance_m * used

    @property
    def turn_m_per_rad(self) -> float:
        """Cost of a turn on the spot by a radian, metres of level ground."""
        return (
            0.5 * math.hypot(*self.stance_m)
            if self.turn_cost_m_per_rad is None
            else self.turn_cost_m_per_rad
        )

    @property
    def reach_m(self) -> float:
        """From the middle to the corners, or of a disc to its edge."""
        return self.radius_m or math.hypot(self.length_m, self.width_m) / 2.0


def _metres(most: float) -> Range:
    """Of a length; what is longer must be in another unit."""
    return math.ulp(0.0), most, f"in metres, above 0 and at most {most:g} for such a vehicle"
