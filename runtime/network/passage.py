"""What a passage network is shown: blocks of a map of heights, and the vehicle's numbers.

All lengths may be multiplied by the same factor without changing which poses pass. So heights are given in shares of
the clearance, gradients in shares of the steepest, and the vehicle's lengths in cells or in shares of one another.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.kernels.blocks import CHANNELS, MIDDLE, UNKNOWN, describe_blocks
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.terrain.vehicle import Vehicle

MOST_CLEARANCES, MOST_GRADIENT = 2.5, 3.0
"""Heights in clearances, and gradients in shares of the steepest, at which bytes are cut off."""
STEPS = UNKNOWN - MIDDLE
MOST_STRETCHED = 1.15
"""Times the shorter side of a cell that the longer may be."""
_SLACK = 1e-3


class Number(NamedTuple):
    """One of the numbers by which a vehicle is described, and the range that networks are trained for."""

    name: str
    low: float
    high: float
    by_ratio: bool = False
    """Whether its logarithm is what counts."""


NUMBERS = (
    Number("length in cells", 3.0, 8.0),
    Number("width / length", 0.5, 1.05),
    Number("wheelbase / length less a wheel's", 0.5, 1.0),
    Number("track / width less a wheel's", 0.5, 1.0),
    Number("wheel length / length", 0.04, 0.3),
    Number("wheel width / width", 0.04, 0.3),
    Number("axles", 2.0, 4.0),
    Number("clearance / length", 0.08, 0.35, by_ratio=True),
    Number("step / clearance", 0.5, 1.5, by_ratio=True),
    Number("steepest gradient", math.tan(math.radians(12.0)), math.tan(math.radians(36.0)), by_ratio=True),
    Number("pitch's gradient / steepest", 0.5, 1.0),
    Number("roll's gradient / steepest", 0.5, 1.0),
)
"""Lengths and limits of a vehicle, without units."""


def vehicle_numbers(vehicle: Vehicle, sides_m: tuple[float, float]) -> NDArray[np.float64]:
    """(12,) float64, see `NUMBERS`, on cells of this height and width."""
    (base, track), (long, wide) = vehicle.stance_m, vehicle.contact_m
    pitch, roll, tilt = (math.tan(math.radians(angle)) for angle in vehicle.tilts_deg)
    return np.array(
        (
            vehicle.length_m / math.sqrt(sides_m[0] * sides_m[1]),
            vehicle.width_m / vehicle.length_m,
            base / (vehicle.length_m - long),
            track / (vehicle.width_m - wide),
            long / vehicle.length_m,
            wide / vehicle.width_m,
            vehicle.axles,
            vehicle.clearance_m / vehicle.length_m,
            vehicle.step_m / vehicle.clearance_m,
            tilt,
            min(pitch / tilt, 1.0),
            min(roll / tilt, 1.0),
        )
    )


def unsuited(vehicle: Vehicle, sides_m: tuple[float, float]) -> str:
    """Why networks are not made for a vehicle on such cells; empty if they are."""
    if max(sides_m) > MOST_STRETCHED * min(sides_m):
        return f"is for cells that are nearly square, got {sides_m[0]:g} × {sides_m[1]:g} m"
    for value, number in zip(vehicle_numbers(vehicle, sides_m).tolist(), NUMBERS, strict=True):
        if not number.low * (1.0 - _SLACK) <= value <= number.high * (1.0 + _SLACK):
            return f"is for vehicles whose {number.name} lies in [{number.low:g}, {number.high:g}], got {value:.3g}"
    return ""


def shown_numbers(numbers: NDArray[np.float64]) -> NDArray[np.float32]:
    """The same from -1 to 1 over each one's range: (12,) float32."""
    shown = []
    for value, number in zip(numbers.tolist(), NUMBERS, strict=True):
        low, high = number.low, number.high
        if number.by_ratio:
            value, low, high = math.log(value), math.log(low), math.log(high)
        shown.append(2.0 * (value - low) / (high - low) - 1.0)
    return np.array(shown, np.float32)


def shown_blocks(
    heights: Float2D, sides_m: tuple[float, float], vehicle: Vehicle, first: Cell, shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """(19, R, C) uint8: what is shown of R × C blocks from block `first` on, which may lie off the map."""
    out = np.empty((CHANNELS, *shape), np.uint8)
    scratch = np.empty((shape[0] + 2, shape[1] + 2), np.float32), np.empty((3, shape[1] + 2), np.float32)
    steepest = math.tan(math.radians(vehicle.tilts_deg[2]))
    down, across = (STEPS / (MOST_GRADIENT * steepest * FACTOR * side) for side in sides_m)
    scales = tuple(np.float32(each) for each in (STEPS / (MOST_CLEARANCES * vehicle.clearance_m), down, across))
    describe_blocks(heights, first, scales, scratch, out)
    return out
