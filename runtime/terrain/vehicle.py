"""The robot's body: what it measures, what it can take, and which cells lie under it.

A pose is a cell and one of the four headings of the eight steps, each of which leads both ways. The ground between
the cells' middles is bilinear: its height at a point is a mean of the four cells around it. So a contact patch can
touch no height beyond those of cells whose middles lie less than a cell from it, along rows and along columns.
See docs/vehicle.md for what follows, and `kernels.poses` for the check.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.errors import InvalidMapError

HEADINGS = ((1, 0), (1, 1), (0, 1), (-1, 1))
"""(row, col) of the step along each heading; its reverse has the same."""
_INSIDE = 1e-9
"""Share of a cell by which a middle that lies just a cell away counts as farther."""
_LARGEST_M, _THINNEST, _TALLEST, _WIDEST_TURN = 250.0, 50.0, 3.0, 100.0
"""Longest side of a body, and by the shorter one; highest clearance and widest turn by the longer one. What is beyond
is in another unit than metres.
"""


@checked(InvalidMapError)
@dataclass(frozen=True)
class Vehicle:
    """A body on wheels, or on tracks, each of which is a row of wheels with long contact patches; or a disc.

    The wheels stand in pairs, symmetric about the body's middle, on `axles` axles that are evenly spaced over the
    wheelbase. A disc has a radius and nothing else but a turning radius: it may not touch impassable cells, and needs
    no elevations.
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
    """From first axle to last, and from left wheels' middles to right ones'; None for the body less a wheel."""
    wheel_length_m: float | None = None
    wheel_width_m: float | None = None
    """Of a contact patch, along the heading and across it; None for an eighth of the body's."""
    unknown_passes: bool = False
    """Whether unknown cells count as no higher and no lower than those that are known; else none may lie below."""
    radius_m: float | None = None
    """Of a disc."""
    turning_radius_m: float | None = None
    """Of the sharpest turn on a path freed from the grid; None where the vehicle turns on the spot."""

    def __post_init__(self) -> None:
        if self.radius_m is not None:
            self._check_metres(_LARGEST_M, "radius_m")
            self._check_metres(_WIDEST_TURN * self.radius_m, "turning_radius_m")
            of_a_disc = "radius_m", "turning_radius_m"
            if any(getattr(self, each.name) != each.default for each in fields(self) if each.name not in of_a_disc):
                raise InvalidMapError("a vehicle with a radius is a disc: wanted no other values beside radius_m")
            return
        self._check_metres(_LARGEST_M, "length_m", "width_m")
        self._check_metres(_THINNEST * min(self.length_m, self.width_m), "length_m", "width_m")
        longest = max(self.length_m, self.width_m)
        self._check_metres(_TALLEST * longest, "clearance_m", "max_step_m")
        self._check_metres(_WIDEST_TURN * longest, "turning_radius_m")
        self._check_metres(math.inf, "wheelbase_m", "track_m", "wheel_length_m", "wheel_width_m")
        for name, value in self._given("max_tilt_deg", "max_pitch_deg", "max_roll_deg"):
            if not 0.0 < value < 90.0:
                raise InvalidMapError(f"{name} must lie in (0, 90) degrees, got {value}")
            if value <= 0.5 * math.pi:
                meant = f"{math.degrees(value):.3g}° if that is in radians"
                raise InvalidMapError(f"{name} must be in degrees, above {0.5 * math.pi:.2f}, got {value} ({meant})")
        if type(self.axles) is not int or self.axles not in range(2, 9):
            raise InvalidMapError(f"axles must be a whole number from 2 to 8, got {self.axles}")
        names, sides = ("wheelbase_m", "track_m"), (self.length_m, self.width_m)
        for name, apart, contact, most in zip(names, self.stance_m, self.contact_m, sides, strict=True):
            if not 0.0 < apart <= (most - contact) * (1.0 + _INSIDE):
                raise InvalidMapError(
                    f"the wheels must lie under the body: {name} must be at most {most:g} m less a contact patch of "
                    f"{contact:g} m and more than 0, got {apart:g}"
                )

    def _given(self, *names: str) -> Iterator[tuple[str, float]]:
        return ((name, value) for name in names if (value := getattr(self, name)) is not None)

    def _check_metres(self, most: float, *names: str) -> None:
        """Refuse what is no length, and what is so long for the body that it must be in another unit."""
        for name, value in self._given(*names):
            if not 0.0 < value < math.inf:
                raise InvalidMapError(f"{name} must be a positive number of metres, got {value}")
            if value > most:
                raise InvalidMapError(
                    f"{name} must be in metres, at most {most:g} for such a vehicle, got {value:g} "
                    f"({value / 1000.0:g} m if that is in millimetres)"
                )

    @property
    def is_disc(self) -> bool:
        """Whether nothing but a radius is known."""
        return self.radius_m is not None

    @property
    def contact_m(self) -> tuple[float, float]:
        """Length and width of a wheel's contact patch."""
        long = self.length_m / 8.0 if self.wheel_length_m is None else self.wheel_length_m
        return long, self.width_m / 8.0 if self.wheel_width_m is None else self.wheel_width_m

    @property
    def stance_m(self) -> tuple[float, float]:
        """Wheelbase and track."""
        long, wide = self.contact_m
        base, track = self.wheelbase_m, self.track_m
        return self.length_m - long if base is None else base, self.width_m - wide if track is None else track

    @property
    def wheels_m(self) -> NDArray[np.float64]:
        """(W, 2) middles of the contact patches, ahead of the body's middle and to the left of it."""
        base, track = self.stance_m
        ahead = np.linspace(-0.5, 0.5, self.axles) * base
        return np.array([(along, side * track) for along in ahead for side in (-0.5, 0.5)])

    @property
    def step_m(self) -> float:
        """Greatest difference of heights under a contact patch."""
        return self.clearance_m if self.max_step_m is None else self.max_step_m

    @property
    def tilts_deg(self) -> tuple[float, float, float]:
        """Steepest pitch, roll and tilt."""
        pitch = self.max_tilt_deg if self.max_pitch_deg is None else self.max_pitch_deg
        return pitch, self.max_tilt_deg if self.max_roll_deg is None else self.max_roll_deg, self.max_tilt_deg

    @property
    def reach_m(self) -> float:
        """From the body's middle to its corners."""
        return math.hypot(self.length_m, self.width_m) / 2.0


class Footprint(NamedTuple):
    """The cells that a pose of one heading takes to check, as (row, col) from the pose's own."""

    wheels: list[NDArray[np.int64]]
    belly: NDArray[np.int64]
    """(N, 2) cells that bound the heights under each wheel, and the ground below the body."""
    places: NDArray[np.float64]
    """(N, 2) metres, where the belly's cells lie: ahead of the body's middle and to the left of it."""
    half_step: float
    """Half the length of a step along the heading, metres."""
    margin: float
    """By how much the belly may come lower on the way to the next cell than the poses' own gradients say, metres."""


def footprint(vehicle: Vehicle, heading: int, dy: float, dx: float) -> Footprint:
    """Cells under the body, where a cell has `dy` × `dx` metres.

    On its way from a cell to the next the body is at most half a step from a checked pose. The belly's cells are
    those under it all along that half step, both ways. Wheels need that along diagonals alone: between two cells of
    a row (or of a column) every wheel's height is (1 - s) a + s b, with a among its heights at one pose and b at the
    other, and the body's inclination is linear in them. The belly then needs a margin, which docs/vehicle.md proves.
    """
    row, col = HEADINGS[heading]
    step = math.hypot(row * dy, col * dx)
    ahead, half_step, diagonal = np.array((row * dy, col * dx)) / step, 0.5 * step, bool(row and col)
    left = np.array((-ahead[1], ahead[0]))  # rows go down
    long, wide = vehicle.contact_m
    wheel = 0.5 * long + half_step * diagonal, 0.5 * wide
    wheels = [_cells_near(along * ahead + side * left, ahead, wheel, dy, dx) for along, side in vehicle.wheels_m]
    belly = _cells_near(np.zeros(2), ahead, (0.5 * vehicle.length_m + half_step, 0.5 * vehicle.width_m), dy, dx)
    metres = belly * (dy, dx)
    steepest = math.tan(math.radians(min(vehicle.tilts_deg[0], vehicle.tilts_deg[2])))
    margin = 0.0 if diagonal else step / 16.0 * steepest
    return Footprint(wheels, belly, np.stack((metres @ ahead, metres @ left), 1), half_step, margin)


def _cells_near(
    middle: NDArray[np.float64], ahead: NDArray[np.float64], half: tuple[float, float], dy: float, dx: float
) -> NDArray[np.int64]:
    """(N, 2) cells whose middles lie less than a cell, along rows and along columns, from some point of a rectangle.

    The rectangle's sides lie along `ahead`, (row, col) of length 1, and across it, `half` as long to each side. It
    meets the open box around a middle unless one of the four directions of their sides parts them.
    """
    left = np.array((-ahead[1], ahead[0]))  # rows go down
    extent = np.abs(ahead) * half[0] + np.abs(left) * half[1] + (dy, dx)
    low, high = np.floor((middle - extent) / (dy, dx)), np.ceil((middle + extent) / (dy, dx))
    rows, cols = (np.arange(first, last + 1) for first, last in zip(low, high, strict=True))
    cells = np.stack(np.meshgrid(rows, cols, indexing="ij"), -1).reshape(-1, 2)
    apart = np.abs(cells * (dy, dx) - middle)
    inside = (apart < extent - _INSIDE * min(dy, dx)).all(1)
    for axis, reach in ((ahead, half[0]), (left, half[1])):
        box = abs(axis[0]) * dy + abs(axis[1]) * dx
        inside &= np.abs((cells * (dy, dx) - middle) @ axis) < reach + box - _INSIDE * min(dy, dx)
    found: NDArray[np.int64] = cells[inside].astype(np.int64)
    return found
