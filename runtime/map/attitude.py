"""How a vehicle stands along a path: what the pose check found, in numbers for people."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.terrain.vehicle import HEADINGS, Vehicle, footprint


class Attitudes(NamedTuple):
    """Of each cell of a path, in the heading in which it is left, the last as it is arrived at; (N,) float64 each."""

    pitch_deg: NDArray[np.float64]
    """Of the plane of the wheels in the middle of their heights' ranges; nose up is positive."""
    roll_deg: NDArray[np.float64]
    """Likewise; left side up is positive."""
    tilt_deg: NDArray[np.float64]
    """The most that the body can be inclined, whatever heights within their ranges the wheels touch."""
    clearance_m: NDArray[np.float64]
    """The least that is left between belly and ground, likewise, on the half steps around the cell too."""


def attitudes(heights: Float2D, sides_m: tuple[float, float], vehicle: Vehicle, path: NDArray[np.int32]) -> Attitudes:
    """How the vehicle stands on each cell of a path (N, 2), on heights (H, W) in metres.

    Each cell lies beside the one before; a single one counts as left along the first heading. inf or NaN where
    unknown cells lie below, unless these pass.
    """
    steps = np.diff(path, axis=0)
    steps = np.concatenate((steps, steps[-1:] if len(steps) else np.array([HEADINGS[0]])))[: len(path)]
    return Attitudes(*attitudes_of(heights, sides_m, vehicle, path, steps))


def attitudes_of(
    heights: Float2D,
    sides_m: tuple[float, float],
    vehicle: Vehicle,
    path: NDArray[np.int32],
    steps: NDArray[np.int32],
) -> NDArray[np.float64]:
    """(4, N) as `attitudes`, of cells (N, 2) that are each left by a step (N, 2)."""
    found = np.full((4, len(path)), np.nan)
    margin = int(max(vehicle.reach_m + 2.0 * max(sides_m), 0.0) / min(sides_m)) + 3
    ground = np.pad(np.asarray(heights, np.float64), margin, constant_values=np.nan)
    for heading, direction in enumerate(HEADINGS):
        along = (steps == direction).all(1)
        chosen = along | (steps == np.negative(direction)).all(1)
        if not chosen.any():
            continue
        sign = np.where(along[chosen], 1.0, -1.0)
        found[:, chosen] = _stand(ground, path[chosen] + margin, heading, sides_m, vehicle)
        found[:2, chosen] *= sign
    return found


def _stand(
    ground: NDArray[np.float64],
    cells: NDArray[np.int64],
    heading: int,
    sides_m: tuple[float, float],
    vehicle: Vehicle,
) -> NDArray[np.float64]:
    """(4, N) pitch and roll in degrees along the heading, greatest tilt, and clearance, of poses of one heading."""
    below = footprint(vehicle, heading, *sides_m)

    def under(offsets: NDArray[np.int64]) -> NDArray[np.float64]:
        heights: NDArray[np.float64] = ground[
            cells[:, None, 0] + offsets[None, :, 0], cells[:, None, 1] + offsets[None, :, 1]
        ]
        return heights

    extremes = np.fmin if vehicle.unknown_passes else np.minimum, np.fmax if vehicle.unknown_passes else np.maximum
    low, high = (
        np.array([extreme.reduce(under(offsets), axis=1) for offsets in below.wheels]) for extreme in extremes
    )
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    wheels = vehicle.wheels_m
    solved = np.linalg.pinv(np.column_stack((np.ones(len(wheels)), wheels)))
    level, along, across = solved @ middle
    _, spread_along, spread_across = np.abs(solved) @ half
    steepest = np.abs(along) + spread_along
    tilt = np.degrees(np.arctan(np.hypot(steepest, np.abs(across) + spread_across)))
    shares = np.abs(np.column_stack((np.ones(len(below.places)), below.places)) @ solved)
    plane = level[:, None] + np.outer(along, below.places[:, 0]) + np.outer(across, below.places[:, 1])
    rise = under(below.belly) - plane + (shares @ half).T
    reduced = extremes[1].reduce(rise, axis=1) + below.half_step * steepest + below.margin
    clearance = vehicle.clearance_m - np.maximum(reduced, 0.0)
    return np.stack((np.degrees(np.arctan(along)), np.degrees(np.arctan(across)), tilt, clearance))
