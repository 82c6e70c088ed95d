"""Prices of ground that nobody has seen: what crossing a block of a coarse map is expected to cost.

A block's price is in units of T a fine cell: a straight step through it costs L + 2 · 255 · ω · price. It is finite.
Where a block is likely to hold impassable cells it is above 1, up to `MOST_PRICE`: a way through it may turn out to
be a dead end, which costs more than any ground. Blocks of unknown elevation have that price.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import InvalidQueryError, ModelError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.unseen import MARGIN, Seen, encode_unseen, expected_by_slope, prices_of
from nnpp_edge.runtime.terrain.traversability import Traversability, terrain_terms, traversability_cost
from nnpp_edge.runtime.tuning import BLOCKED_PRICE, MOST_PRICE

PRIORS = ("network", "slope", "eq1", "mean")


class Prior(Protocol):
    """A rule for prices."""

    def prices(self, dem: Float2D, seen: Seen | None = None) -> Float2D:
        """Price of each block, (H, W) float32 in [0, `MOST_PRICE`], of a whole coarse map or a window of it.

        `dem` are the blocks' mean elevations in metres, NaN where unknown. Only what is relative in them counts.
        """


def prior_named(
    name: str, traversability: Traversability, cell_size_m: float, factor: int, model: str | Path = "unseen"
) -> Prior:
    """The prior of that name, for blocks of `cell_size_m` and `factor` × `factor` cells.

    InvalidQueryError for another name; ModelError where the network's `model` cannot be loaded or is another kind.
    """
    if name == "network":
        return NetworkPrior(model, traversability, cell_size_m, factor)
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
    """The coarse map's slope, calibrated on maps that are known finely; see `expected_by_slope`."""

    traversability: Traversability
    cell_size_m: float
    factor: int

    def prices(self, dem: Float2D, seen: Seen | None = None) -> Float2D:
        """As of `Prior`."""
        slope = terrain_terms(dem, self.cell_size_m)[0]
        mean, blocked = expected_by_slope(slope, self.traversability, self.factor)
        return within(mean + BLOCKED_PRICE * blocked, dem)


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


class NetworkPrior:
    """A network that is shown the coarse map and what has been seen nearby."""

    def __init__(self, model: str | Path, traversability: Traversability, cell_size_m: float, factor: int) -> None:
        self.network = NetworkModel(model)
        if self.network.metadata.encoding != "unseen":
            raise ModelError(f"{self.network.path}: wanted a network that prices unseen ground, got another")
        self._shown_by = traversability, cell_size_m, factor
        side = self.network.metadata.input_size
        self._dem = np.empty((side, side), np.float32)

    def prices(self, dem: Float2D, seen: Seen | None = None) -> Float2D:
        """As of `Prior`; maps larger than the network's input are shown to it window by window."""
        out = np.empty(dem.shape, np.float32)
        side = len(self._dem)
        for top, row, rows in windows(dem.shape[0], side):
            for left, col, cols in windows(dem.shape[1], side):
                part = slice(top, top + side), slice(left, left + side)
                answers = self._answers(
                    dem[part], seen and Seen(*(a[part] for a in (seen.mean, seen.blocked, seen.share)))
                )
                inner = slice(row - top, row - top + rows), slice(col - left, col - left + cols)
                out[row : row + rows, col : col + cols] = prices_of(answers[(slice(None), *inner)])
        return within(out, dem)

    def _answers(self, dem: Float2D, seen: Seen | None) -> NDArray[np.float32]:
        """Of a window of at most the network's size, (3, S, S)."""
        rows, cols = dem.shape
        self._dem[:] = np.nan
        self._dem[:rows, :cols] = dem
        padded = None
        if seen is not None:
            padded = Seen(*np.zeros((3, *self._dem.shape), np.float32))
            for own, given in zip(padded.planes, seen.planes, strict=True):
                own[:rows, :cols] = given
        encode_unseen(self._dem, padded, *self._shown_by, self.network.inputs["input"][0])
        return self.network.answers()


def windows(cells: int, side: int) -> Iterator[tuple[int, int, int]]:
    """Windows of `side` that cover a length: where each begins, and from where how many of its cells are taken."""
    done, step = 0, side - 2 * MARGIN
    while done < cells:
        begin = max(0, min(done - MARGIN, cells - side)) if done else 0
        end = cells if begin + side >= cells else (begin + MARGIN + step)
        yield begin, done, end - done
        done = end
