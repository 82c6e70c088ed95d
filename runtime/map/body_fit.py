"""A price for a vehicle by a plane fitted at the body's scale, from sums and extremes over windows."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.terrain.vehicle import Vehicle

_DEAR = np.float32(1.0 - 1e-6)
"""The greatest price below 1."""
_PASSES = (6.56, -6.12, -0.58, -5.18, -3.36, -2.87)
_COSTS = (0.108, 0.965, 0.129, -0.077, 0.12, 0.353)
_HOPELESS = np.float32(60.0)
"""Logarithm of the odds against a pose from which on the chance is as good as 0, lest the odds overflow."""
_HARDLY = 0.1
"""Chance up to which a cell counts as impassable."""


def body_fit(heights: Float2D, vehicle: Vehicle, sides_m: tuple[float, float]) -> Float2D:
    """(H, W) float32 costs in [0, 1), inf where a body of that size would hardly stand.

    Parameters
    ----------
    heights : (H, W) float32
        Metres; not finite where unknown.
    vehicle : Vehicle
        The body.
    sides_m : (float, float)
        Height and width of a cell.

    Notes
    -----
    A plane is fitted by least squares to a square whose side is the mean of the body's, by sums over windows. The
    chance that a pose passes is a logistic function, and T a linear one, of shares of the limits: the plane's
    gradient, how far cells under the body lie above and below the means of their own squares, the greatest difference
    of heights within 3 × 3 cells under the body, and the root mean square of those distances. Their coefficients were
    fitted to the poses of three vehicles on the train tiles, without rocks and with up to a tenth of the ground
    covered; see docs/decisions.md.
    """
    dy, dx = sides_m
    known = np.isfinite(heights)
    base = np.float32(heights[known].mean()) if known.any() else np.float32(0.0)
    ground = np.where(known, heights - base, np.float32(0.0))
    half = 0.25 * (vehicle.length_m + vehicle.width_m)
    rows, cols = (2 * max(round(half / each), 1) + 1 for each in (dy, dx))
    down = (np.arange(rows, dtype=np.float32) - rows // 2) * np.float32(dy)
    along = (np.arange(cols, dtype=np.float32) - cols // 2) * np.float32(dx)
    border, under, around = cv2.BORDER_REPLICATE, np.ones((rows, cols), np.uint8), np.ones((3, 3), np.uint8)
    flat_down, flat_along = np.ones(rows, np.float32), np.ones(cols, np.float32)
    gradient_y = cv2.sepFilter2D(ground, -1, flat_along, down / (cols * (down**2).sum()), borderType=border)
    gradient_x = cv2.sepFilter2D(ground, -1, along / (rows * (along**2).sum()), flat_down, borderType=border)
    bumps = ground - cv2.boxFilter(ground, -1, (cols, rows), borderType=border)
    steps = cv2.dilate(cv2.dilate(ground, around) - cv2.erode(ground, around), under)
    spread = np.sqrt(cv2.boxFilter(bumps * bumps, -1, (cols, rows), borderType=border))
    pitch, roll, most = (math.radians(angle) for angle in vehicle.tilts_deg)
    terms = (
        np.hypot(gradient_x, gradient_y) / np.float32(math.tan(min(most, math.hypot(pitch, roll)))),
        cv2.dilate(bumps, under) / np.float32(vehicle.clearance_m),
        -cv2.erode(bumps, under) / np.float32(vehicle.clearance_m),
        steps / np.float32(vehicle.step_m),
        spread / np.float32(vehicle.clearance_m),
    )
    against = np.minimum(-_weighed(terms, _PASSES), _HOPELESS)
    chance = np.float32(1.0) / (np.float32(1.0) + np.exp(against))
    cost = np.clip(_weighed(terms, _COSTS), np.float32(0.0), _DEAR)
    return np.where(known & (chance > _HARDLY), cost, np.float32(np.inf)).astype(np.float32)


def _weighed(terms: tuple[NDArray[np.floating], ...], coefficients: tuple[float, ...]) -> Float2D:
    total: Float2D = np.full(terms[0].shape, coefficients[0], np.float32)
    for term, coefficient in zip(terms, coefficients[1:], strict=True):
        total += np.float32(coefficient) * term.astype(np.float32)
    return total
