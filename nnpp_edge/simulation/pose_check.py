"""The pose check of docs/vehicle.md in plain NumPy, apart from the planners' kernels: the simulation judges by it."""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.terrain.vehicle import HEADINGS, Footprint, Vehicle, footprint

_ROUNDING = 1e-4
"""Share of a limit by which a figure may exceed it: the planners' figures are float32."""


class PoseCheck:
    """Tells whether a body (no disc) stands on poses of a map with cells of `sides_m` (height, width)."""

    def __init__(self, vehicle: Vehicle, sides_m: tuple[float, float]) -> None:
        self._vehicle = vehicle
        self._prints = [footprint(vehicle, heading, *sides_m) for heading in range(len(HEADINGS))]
        wheels = vehicle.wheels_m
        self._plane: NDArray[np.float64] = np.linalg.pinv(np.column_stack((np.ones(len(wheels)), wheels)))
        self.reach = max(int(np.abs(cells).max()) for each in self._prints for cells in (*each.wheels, each.belly))
        """Cells from a pose to the farthest that lies under it, along rows or columns."""

    def stands(self, heights: Float2D, cells: NDArray[np.integer], heading: int) -> NDArray[np.bool_]:
        """(N,) whether the body stands on each of (N, 2) cells in a heading; heights are (H, W) metres."""
        below, vehicle = self._prints[heading], self._vehicle
        low, high, known = self._under_wheels(heights, cells, below)
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        ahead, left = (np.abs(middle @ slope) + half @ np.abs(slope) for slope in self._plane[1:])
        rise, belly_known = self._rise(heights, cells, below, (middle, half, ahead))
        pitch, roll, tilt = (math.tan(math.radians(angle)) for angle in vehicle.tilts_deg)
        most = 1.0 + _ROUNDING
        passes = (ahead <= pitch * most) & (left <= roll * most) & (np.hypot(ahead, left) <= tilt * most)
        passes &= ((high - low).max(1) <= vehicle.step_m * most) & (rise <= vehicle.clearance_m * most - below.margin)
        if not vehicle.unknown_passes:
            passes &= known & belly_known
        return np.asarray(passes)

    def _under_wheels(
        self, heights: Float2D, cells: NDArray[np.integer], below: Footprint
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """(N, W) least and greatest height under each wheel, NaN where none is known; (N,) whether all are."""
        under = [_heights_at(heights, cells, offsets) for offsets in below.wheels]
        low, high = (np.stack([pick.reduce(each, axis=1) for each in under], 1) for pick in (np.fmin, np.fmax))
        return low, high, np.all([np.isfinite(each).all(1) for each in under], axis=0)

    def _rise(
        self,
        heights: Float2D,
        cells: NDArray[np.integer],
        below: Footprint,
        wheels: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """(N,) metres by which the ground stands above the lowest plane; (N,) whether all of it is known."""
        middle, half, ahead = wheels
        share = np.column_stack((np.ones(len(below.places)), below.places)) @ self._plane
        lowest = middle @ share.T - half @ np.abs(share.T) - below.half_step * ahead[:, None]
        ground = _heights_at(heights, cells, below.belly)
        rise: NDArray[np.float64] = np.fmax.reduce(ground - lowest, axis=1, initial=0.0)
        return rise, np.asarray(np.isfinite(ground).all(1))


def headings_of(path: NDArray[np.integer]) -> NDArray[np.int64]:
    """(N - 1,) number of the heading that each step of a path is along; its cells lie each next to the one before."""
    row, col = np.diff(path, axis=0).astype(np.int64).T
    backwards = (col < 0) | ((col == 0) & (row < 0))
    row, col = np.where(backwards, -row, row), np.where(backwards, -col, col)
    numbers = np.array([[HEADINGS.index((r, c)) if (r, c) in HEADINGS else 0 for c in (0, 1)] for r in (-1, 0, 1)])
    return np.asarray(numbers[row + 1, col])


def _heights_at(heights: Float2D, cells: NDArray[np.integer], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """(N, K) heights of the cells at these offsets from each of N; NaN where unknown or off the map."""
    at = cells[:, None] + offsets
    inside = ((at >= 0) & (at < heights.shape)).all(-1)
    at = np.clip(at, 0, np.array(heights.shape) - 1)
    found = heights[at[..., 0], at[..., 1]].astype(np.float64)
    return np.where(inside & np.isfinite(found), found, np.nan)
