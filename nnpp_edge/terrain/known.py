"""Training maps of which blocks are known coarsely: their mean elevations, and what their cells turn out to be."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.network.unseen import Seen, expected_by_slope
from nnpp_edge.runtime.terrain.traversability import Traversability, terrain_terms, traversability_cost
from nnpp_edge.runtime.tuning import SlopePrice

QUARTERS = 4
"""Parts of a block to its side for which the data set holds what is seen there; factors are multiples of it."""
_SPREADS = np.linspace(0.02, 0.3, 57)
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class KnownMaps:
    """M maps of B × B blocks, each of `factor` × `factor` cells."""

    heights: Floats
    """(M, B, B) mean elevation, metres relative to the map's mean."""
    mean: NDArray[np.uint8]
    """(M, 4B, 4B) mean T of parts of blocks, impassable cells as 1, in 255ths."""
    blocked: NDArray[np.uint8]
    """(M, 4B, 4B) share of impassable cells, in 255ths."""
    closed: NDArray[np.uint8]
    """(M, B, B) of the ways across a block, down and to the side, how many its impassable cells close."""
    factor: NDArray[np.int32]
    cell_size_m: Floats
    """(M,) side of a cell."""
    slope_limit_deg: Floats
    hard_slope_deg: Floats
    """(M,) limits of the slope; inf for none."""

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[np.generic]]) -> "KnownMaps":
        """The arrays of these names; others are left out."""
        return cls(*(np.asarray(arrays[field.name]) for field in fields(cls)))

    def __len__(self) -> int:
        """Number of maps."""
        return len(self.heights)

    def shape_of(self, name: str, maps: int) -> tuple[int, ...]:
        """Shape that an array has with so many maps of the same size."""
        return (maps, *getattr(self, name).shape[1:])

    def limits(self, at: int) -> Traversability:
        """Those of the slope of one map."""
        return Traversability(float(self.slope_limit_deg[at]), hard_slope_deg=float(self.hard_slope_deg[at]))

    def seen(self, at: int, mask: NDArray[np.bool_]) -> Seen:
        """Blocks of one map, of whose parts (4B, 4B) these were seen."""
        share = pooled(mask.astype(np.float32))
        parts = np.maximum(share, np.float32(1e-6)) * np.float32(255.0)
        mean, blocked = (
            np.divide(pooled(each[at] * mask), parts, dtype=np.float32) for each in (self.mean, self.blocked)
        )
        return Seen(mean, blocked, share)

    def answers(self, at: int) -> Floats:
        """The answers wanted for one map: (3, B, B) float32."""
        truth = self.seen(at, np.ones(self.mean.shape[1:], np.bool_))
        return np.stack([truth.mean, truth.blocked, self.closed[at].astype(np.float32) / 2.0])


def pooled(parts: NDArray[np.generic]) -> Floats:
    """Means of the parts of blocks."""
    rows, cols = (cells // QUARTERS for cells in parts.shape)
    means: Floats = parts.reshape(rows, QUARTERS, cols, QUARTERS).mean(axis=(1, 3), dtype=np.float32)
    return means


def known_map(
    elevation: Floats, cell_size_m: float, cell_width_m: float, limits: Traversability, factor: int
) -> tuple[object, ...]:
    """The fields of `KnownMaps` for one map."""
    cost = traversability_cost(elevation, cell_size_m, limits, cell_width_m=cell_width_m, warn=False)
    blocked = ~(cost < 1.0)
    side, part = len(elevation) // factor, factor // QUARTERS
    heights = elevation.reshape(side, factor, side, factor).mean(axis=(1, 3))
    parts = (QUARTERS * side, part, QUARTERS * side, part)
    shares = (np.where(blocked, np.float32(1.0), cost), blocked.astype(np.float32))
    quantised = [np.rint(255.0 * each.reshape(parts).mean(axis=(1, 3))).astype(np.uint8) for each in shares]
    known = (np.int32(factor), np.float32(cell_size_m))
    slopes = (np.float32(limits.slope_limit_deg), np.float32(limits.hard_slope_deg))
    return heights - heights.mean(), *quantised, _closed_ways(blocked, factor), *known, *slopes


def _closed_ways(blocked: NDArray[np.bool_], factor: int) -> NDArray[np.uint8]:
    """Of the ways across each block, within it, how many are closed."""
    side = len(blocked) // factor
    blocks = blocked.reshape(side, factor, side, factor).swapaxes(1, 2)
    closed = np.zeros((side, side), np.uint8)
    for row, col in np.argwhere(blocks.any(axis=(2, 3))):
        _, pieces = cv2.connectedComponents((~blocks[row, col]).astype(np.uint8), connectivity=8)
        for first, last in ((pieces[0], pieces[-1]), (pieces[:, 0], pieces[:, -1])):
            closed[row, col] += not np.intersect1d(first[first > 0], last).size
    return closed


def fitted_slope(maps: KnownMaps) -> SlopePrice:
    """The numbers of `expected_by_slope` that fit these maps best, by least squares."""
    shares, means, over = list[Floats](), list[Floats](), list[Floats]()
    for at in range(len(maps)):
        limits, factor = maps.limits(at), int(maps.factor[at])
        slope = terrain_terms(maps.heights[at], float(maps.cell_size_m[at]) * factor)[0]
        answers = maps.answers(at)
        shares.append(np.minimum(slope / math.radians(limits.slope_limit_deg), 1.0).ravel())
        means.append(answers[0].ravel())
        if limits.hard_slope_deg < math.inf:
            errors = [expected_by_slope(slope, limits, factor, SlopePrice(0.0, 0.0, s))[1] for s in _SPREADS]
            over.append(np.array([((each - answers[1]) ** 2).mean() for each in errors], np.float32))
    gain, floor = np.polyfit(np.concatenate(shares), np.concatenate(means), 1)
    spread = float(_SPREADS[np.mean(over, axis=0).argmin()]) if over else SlopePrice().spread
    return SlopePrice(round(float(floor), 3), round(float(gain), 3), round(spread, 3))
