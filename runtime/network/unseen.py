"""Ground that is unseen, as input of a network, and a block's price by its output.

Training takes these from here too, so that what runs is what was trained. Only what is relative in
the elevations is shown: in units of the rise over a block at the limit of the slope.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, Planes
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.tuning import BLOCKED_PRICES, SlopePrice

ANSWERS = 3
"""Of a block: mean T, impassable cells as 1; share of impassable cells; chance that it cannot be
crossed.
"""
MARGIN = 8
"""Blocks at the edge of a window whose answers are taken from another window, where there
is one.
"""
_NUMBERS = SlopePrice()


def expected_by_slope(
    slope: NDArray[np.floating], limits: Traversability, factor: int
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Mean T, impassable cells apart, and share of impassable cells of blocks by their coarse slope
    (rad).

    T rises with the slope up to the limit φ_s. Where slopes are limited the share is a logistic
    function of the slope, the broader the more cells a block has.
    """
    mean = _NUMBERS.floor + _NUMBERS.gain * np.minimum(
        slope / math.radians(limits.slope_limit_deg), 1.0
    )
    if not limits.hard_slope_deg < math.inf:
        return mean, np.zeros_like(mean)
    over = (slope / math.radians(limits.hard_slope_deg) - 1.0) / (
        _NUMBERS.spread * math.sqrt(factor / 8.0)
    ) + 0.9
    return mean, 1.0 / (1.0 + np.exp(-np.clip(over, -30.0, 30.0)))


def encode_unseen(
    dem: Float2D,
    limits: Traversability,
    sides_m: tuple[float, float],
    factor: int,
    out: Planes,
) -> None:
    """Show a window of a coarse map: the channels of each block into `out`, (12, H, W) float32; 0
    where unknown.

    `dem` (H, W) are means over factor × factor cells, metres, NaN where unknown; `sides_m` are a
    block's height and width.
    """
    side_m = math.sqrt(sides_m[0] * sides_m[1])
    known = np.isfinite(dem).astype(np.float32)
    tangent = math.tan(math.radians(limits.slope_limit_deg))
    height = np.nan_to_num(dem / np.float32(side_m * tangent)).astype(np.float32)
    height = (height - np.float32((height * known).sum() / max(known.sum(), 1.0))) * known
    near, wide, far = (_mean(height, known, blocks) for blocks in (3, 7, 15))
    filled = np.where(known > 0.0, height, near)
    edged = np.pad(filled, 1, mode="edge")
    there = np.pad(known, 1)
    by_row, by_col = (np.float32(side_m / side) for side in sides_m)
    down, step_down = _rises(edged, there, by_row)
    across, step_across = (each.T for each in _rises(edged.T, there.T, by_col))
    step = np.maximum(step_down, step_across)
    slope = np.arctan(np.sqrt(down * down + across * across) * np.float32(tangent))
    blocked = expected_by_slope(slope, limits, factor)[1]
    planes = [
        _soft(across),
        _soft(down),
        _soft(4.0 * (height - near)),
        _soft(2.0 * (near - wide)),
        _soft(wide - far),
        np.minimum(slope / math.radians(limits.slope_limit_deg), 2.0) / 2.0,
        _soft(step),
        blocked,
        known,
    ]
    out[: len(planes)] = np.stack(planes) * known
    cell = side_m / factor * tangent / 2.0
    constants = (
        float(limits.hard_slope_deg < math.inf),
        math.log2(factor) / 4.0,
        cell / (1.0 + cell),
    )
    out[len(planes) :] = np.multiply.outer(np.array(constants, np.float32), known)


def _rises(edged: Float2D, there: Float2D, by: np.float32) -> tuple[Float2D, Float2D]:
    """Mean rise from row to row over the neighbours that are there, and the greater step to one of
    the two; of a map with a border.
    """
    steps = np.diff(edged[:, 1:-1], axis=0) * by
    after = there[2:, 1:-1]
    before = there[:-2, 1:-1]
    over_both = steps[1:] * after + steps[:-1] * before
    rise = over_both / np.maximum(after + before, 1.0)
    return rise, np.maximum(np.abs(steps[1:]), np.abs(steps[:-1]))


def prices_of(answers: Planes) -> Float2D:
    """Prices, (H, W) float32, by a network's answers (3, H, W)."""
    by_share, by_chance = BLOCKED_PRICES
    price: Float2D = (
        answers[0] + np.float32(by_share) * answers[1] + np.float32(by_chance) * answers[2]
    )
    return price


def _mean(height: Float2D, known: Float2D, blocks: int) -> Float2D:
    """Mean of the known heights over blocks × blocks."""
    total, count = (
        cv2.boxFilter(
            plane, cv2.CV_32F, (blocks, blocks), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        for plane in (height, known)
    )
    return np.divide(total, np.maximum(count, np.float32(1e-6)), dtype=np.float32)


def _soft(x: NDArray[np.floating]) -> NDArray[np.floating]:
    """Into (-1, 1), finest around 0."""
    soft: NDArray[np.floating] = x / (1.0 + np.abs(x))
    return soft
