"""A price for a vehicle by a plane fitted at the body's scale, from sums and extremes over windows."""

import math

import cv2
import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.terrain.vehicle import Vehicle

_DEAR = np.float32(1.0 - 1e-6)
"""The greatest price below 1."""


def body_fit(
    heights: Float2D, vehicle: Vehicle, sides_m: tuple[float, float], weights: tuple[float, float, float]
) -> Float2D:
    """(H, W) float32 costs in [0, 1), inf where a body of that size would hardly stand.

    Parameters
    ----------
    heights : (H, W) float32
        Metres; not finite where unknown.
    vehicle : Vehicle
        The body.
    sides_m : (float, float)
        Height and width of a cell.
    weights : (float, float, float)
        Of tilt, rise and step in T.

    Notes
    -----
    A plane is fitted by least squares to a square whose side is the mean of the body's. Its inclination stands for
    the body's; the greatest height of a cell under the body above the mean of its own square for the rise; and the
    difference of the extremes of such heights around a cell for the step.
    """
    dy, dx = sides_m
    known = np.isfinite(heights)
    base = np.float32(heights[known].mean()) if known.any() else np.float32(0.0)
    ground = np.where(known, heights - base, np.float32(0.0))
    half = 0.25 * (vehicle.length_m + vehicle.width_m)
    rows, cols = (2 * max(round(half / each), 1) + 1 for each in (dy, dx))
    down = (np.arange(rows, dtype=np.float32) - rows // 2) * np.float32(dy)
    along = (np.arange(cols, dtype=np.float32) - cols // 2) * np.float32(dx)
    border = cv2.BORDER_REPLICATE
    flat_down, flat_along = np.ones(rows, np.float32), np.ones(cols, np.float32)
    gradient_y = cv2.sepFilter2D(ground, -1, flat_along, down / (cols * (down**2).sum()), borderType=border)
    gradient_x = cv2.sepFilter2D(ground, -1, along / (rows * (along**2).sum()), flat_down, borderType=border)
    bumps = ground - cv2.boxFilter(ground, -1, (cols, rows), borderType=border)
    around = np.ones((3, 3), np.uint8)
    rise = cv2.dilate(bumps, np.ones((rows, cols), np.uint8)) / np.float32(vehicle.clearance_m)
    step = (cv2.dilate(bumps, around) - cv2.erode(bumps, around)) / np.float32(vehicle.step_m)
    pitch, roll, most = (math.radians(angle) for angle in vehicle.tilts_deg)
    tilt = np.arctan(np.hypot(gradient_x, gradient_y)) / np.float32(min(most, math.hypot(pitch, roll)))
    terms = tilt, np.maximum(rise, np.float32(0.0)), step
    cost = sum(
        np.float32(weight) * np.minimum(term, np.float32(1.0)) for weight, term in zip(weights, terms, strict=True)
    )
    fails = ~known | (terms[0] > 1.0) | (terms[1] > 1.0) | (terms[2] > 1.0)
    return np.where(fails, np.float32(np.inf), np.minimum(cost, _DEAR)).astype(np.float32)
