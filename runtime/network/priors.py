"""Prices of ground that nobody has seen: what crossing a block of a coarse map is expected to cost.

A block's price is in units of T a fine cell: a straight step through it costs L + 2 · 255 · ω · price. It is finite, and
may be above 1, up to `MOST_PRICE`, where a block is likely to hold impassable cells: a way through it may turn out to
be a dead end, which costs more than any ground. Blocks of unknown elevation have that price.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.terrain.traversability import Traversability, terrain_terms, traversability_cost
from nnpp_edge.runtime.tuning import BLOCKED_PRICE, MOST_PRICE, SlopePrice

PRIORS = ("mean", "eq1", "slope")


@dataclass(frozen=True, eq=False)
class Seen:
    """What has been seen of each block of a window: (H, W) float32 each, 0 where nothing was."""

    mean: Float2D
    """Mean T of the cells seen, impassable ones as 1."""
    blocked: Float2D
    """Share of the cells seen that is impassable."""
    share: Float2D
    """Share of the block's cells that was seen."""


class Prior(Protocol):
    """A rule for prices."""

    def prices(self, dem: Float2D, seen: Seen | None = None) -> Float2D:
        """Price of each block, (H, W) float32 in [0, `MOST_PRICE`], of a whole coarse map or a window of it.

        `dem` are the blocks' mean elevations in metres, NaN where unknown. Only what is relative in them counts.
        """


def prior_named(name: str, traversability: Traversability, cell_size_m: float, factor: int) -> Prior:
    """The prior of that name, for blocks of `cell_size_m` and `factor` × `factor` cells.

    InvalidQueryError for another name.
    """
    if name == "eq1":
        return CoarseCost(traversability, cell_size_m)
    if name == "slope":
        return CoarseSlope(traversability, cell_size_m, factor)
    if name == "mean":
        return OneMean(CoarseSlope(traversability, cell_size_m, factor))
    raise InvalidQueryError(f"prior must be one of {', '.join(PRIORS)}, got {name!r}")


@dataclass(frozen=True)
class CoarseCost:
    """Eq. 1 on the coarse map, as if its blocks were cells."""

    traversability: Traversability
    cell_size_m: float

    def prices(self, dem: Float2D, seen: Seen | None = None) -> Float2D:
        """As of `Prior`."""
        cost = traversability_cost(dem, self.cell_size_m, self.traversability, warn=False)
        return within(np.where(cost < 1.0, cost, BLOCKED_PRICE), dem)


@dataclass(frozen=True)
class CoarseSlope:
    """The coarse map's slope, calibrated on maps that are known finely.

    With x the slope as a share of the limit φ_s, T is `floor` + `gain` · x, and where slopes are limited the share of
    impassable cells is a logistic function of x, the broader the more cells a block has.
    """

    traversability: Traversability
    cell_size_m: float
    factor: int
    numbers: SlopePrice = SlopePrice()

    def prices(self, dem: Float2D, seen: Seen | None = None) -> Float2D:
        """As of `Prior`."""
        limits, numbers = self.traversability, self.numbers
        slope_deg = np.degrees(terrain_terms(dem, self.cell_size_m)[0])
        x = slope_deg / np.float32(limits.slope_limit_deg)
        price = numbers.floor + numbers.gain * np.minimum(x, 1.0)
        if limits.hard_slope_deg < math.inf:
            width = numbers.spread * math.sqrt(self.factor / 8.0)
            over = (slope_deg / limits.hard_slope_deg - 1.0) / width + 0.9
            price += BLOCKED_PRICE / (1.0 + np.exp(-np.clip(over, -30.0, 30.0)))
        return within(price, dem)


@dataclass(frozen=True)
class OneMean:
    """The mean of another prior's prices for all known blocks."""

    of: Prior

    def prices(self, dem: Float2D, seen: Seen | None = None) -> Float2D:
        """As of `Prior`."""
        known = np.isfinite(dem)
        mean = float(self.of.prices(dem)[known].mean()) if known.any() else MOST_PRICE
        return within(np.full(dem.shape, mean), dem)


def within(price: NDArray[np.floating], dem: Float2D) -> Float2D:
    """Prices in range, `MOST_PRICE` where the elevation is unknown."""
    out: Float2D = np.where(np.isfinite(dem), np.clip(price, 0.0, MOST_PRICE), MOST_PRICE).astype(np.float32)
    return out
