"""Numbers along the way: a path's length on the ground, its climb and slopes, and the time and energy it takes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.map.slope_cost import Mobility, SlopeCost

Line = NDArray[np.int32] | NDArray[np.float64]
"""(N, 2) row and column: cells of a path, or way points between them."""
Heights = NDArray[np.float32] | NDArray[np.float64]
_ON_FOOT = Mobility()


class Numbers(NamedTuple):
    """Of a whole path; NaN where no height is known."""

    length_m: float
    """On the level."""
    ground_length_m: float
    """On the ground, up and down its slopes."""
    climb_m: float
    """Sum of all rises."""
    descent_m: float
    """Sum of all falls, counted positive."""
    steepest_up_deg: float
    """Inclination of the steepest rise between two points, 0 if there is none."""
    steepest_down_deg: float
    """Likewise of the steepest fall, counted positive."""
    time_s: float
    """By the vehicle's speeds; where these are not known, of a hiker by Tobler's function."""
    energy_j: float
    """By the vehicle's model; NaN where it has none."""

    @classmethod
    def unknown(cls) -> "Numbers":
        """Where there is no path, or no height is known."""
        return cls(*[math.nan] * len(cls._fields))


@dataclass(frozen=True, eq=False)
class Along:
    """A line over the ground, point by point from start to goal.

    Attributes
    ----------
    points : (N, 2) float64
        Row and column: a path's cells. Of way points, these and each place between two of them where the line crosses
        a row or a column of cells' middles: between two points the ground is then as good as even.
    heights_m : (N,) float64
        Of the ground, bilinear between the cells' middles. Where one is not known, what lies between the known ones
        before and behind; NaN where none is known.
    sides_m : (float, float)
        Height and width of a cell.
    mobility : Mobility
        By what time and energy are computed.
    """

    points: NDArray[np.float64]
    heights_m: NDArray[np.float64]
    sides_m: tuple[float, float]
    mobility: Mobility = _ON_FOOT

    @classmethod
    def of(cls, line: Line, heights: Heights, sides_m: tuple[float, float], mobility: Mobility = _ON_FOOT) -> "Along":
        """A line over a map of heights (H, W), metres, NaN where unknown."""
        points = crossings(line)
        return cls.through(points, heights_at(heights, points), sides_m, mobility)

    @classmethod
    def through(
        cls,
        points: Line,
        heights_m: Heights,
        sides_m: tuple[float, float],
        mobility: Mobility = _ON_FOOT,
    ) -> "Along":
        """A line whose heights (N,) are known, but for NaN."""
        points, heights = np.asarray(points, np.float64), np.array(heights_m, np.float64)
        known = np.isfinite(heights)
        if known.any() and not known.all():
            at = _apart(points, sides_m).cumsum()
            heights = np.interp(at, at[known], heights[known])
        return cls(points, heights, sides_m, mobility)

    @cached_property
    def steps_m(self) -> NDArray[np.float64]:
        """(N,) from the point before, on the level; 0 for the first."""
        return _apart(self.points, self.sides_m)

    @cached_property
    def rises_m(self) -> NDArray[np.float64]:
        """(N,) above the point before; 0 for the first."""
        return np.diff(self.heights_m, prepend=self.heights_m[:1])

    @cached_property
    def distance_m(self) -> NDArray[np.float64]:
        """(N,) from the start, on the level."""
        return self.steps_m.cumsum()

    @cached_property
    def ground_m(self) -> NDArray[np.float64]:
        """(N,) from the start, on the ground."""
        return np.hypot(self.steps_m, self.rises_m).cumsum()

    @cached_property
    def time_s(self) -> NDArray[np.float64]:
        """(N,) seconds from the start."""
        return self._by(self.mobility.time or self.mobility.tobler)

    @cached_property
    def energy_j(self) -> NDArray[np.float64]:
        """(N,) joules from the start; NaN where the vehicle has no model of its energy."""
        if self.mobility.energy is None:
            return np.full(len(self.points), math.nan)
        return self._by(self.mobility.energy)

    def _by(self, model: SlopeCost) -> NDArray[np.float64]:
        """What a model says of the way to each point; points may coincide."""
        costs, moves = np.zeros(len(self.points)), self.steps_m > 0.0
        costs[moves] = model.cost(self.steps_m[moves], self.rises_m[moves])
        return costs.cumsum()

    @cached_property
    def numbers(self) -> Numbers:
        """Of the whole line; of one without a point all are NaN."""
        if not len(self.points):
            return Numbers.unknown()
        rises, steps = self.rises_m, self.steps_m
        slopes = np.degrees(np.arctan2(rises, steps))
        return Numbers(
            float(self.distance_m[-1]),
            float(self.ground_m[-1]),
            float(np.maximum(rises, 0.0).sum()),
            float(np.maximum(-rises, 0.0).sum()),
            float(np.maximum(slopes, 0.0).max()),
            float(np.maximum(-slopes, 0.0).max()),
            float(self.time_s[-1]),
            float(self.energy_j[-1]),
        )


def crossings(line: Line) -> NDArray[np.float64]:
    """(M, 2) the points of a line (N, 2), and where it crosses a row or a column of cells' middles between them.

    A path's cells stay what they are: their steps cross none.
    """
    points = np.asarray(line, np.float64).reshape(-1, 2)
    if len(points) < 2 or np.issubdtype(line.dtype, np.integer):
        return points
    pieces = [points[:1]]
    for begin, end in zip(points[:-1], points[1:], strict=True):
        at = [1.0]
        for first, last in zip(begin.tolist(), end.tolist(), strict=True):
            low, high = math.ceil(min(first, last)), math.floor(max(first, last))
            at += [(whole - first) / (last - first) for whole in range(low, high + 1) if first != last]
        shares = np.unique(np.clip(at, 0.0, 1.0))
        shares = shares[shares > 0.0][:, None]
        pieces.append(begin + shares * (end - begin))
    return np.concatenate(pieces)


def joined(lines: Sequence[Line]) -> Line:
    """One line of several, each of which begins where the one before ends."""
    found: Line = np.concatenate([lines[0], *(line[1:] for line in lines[1:])])
    return found


def _apart(points: NDArray[np.float64], sides_m: tuple[float, float]) -> NDArray[np.float64]:
    """(N,) metres from the point before, on the level."""
    apart: NDArray[np.float64] = np.hypot(*(np.diff(points, axis=0, prepend=points[:1]) * sides_m).T)
    return apart


def heights_at(heights: Heights, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) heights of a map (H, W) at places (N, 2), bilinear between the cells' middles.

    NaN where a height that counts is unknown; beyond the middles at the rim, the rim's.
    """
    low = np.clip(np.floor(points).astype(np.int64), 0, np.array(heights.shape) - 1)
    if (low == points).all():
        return heights[low[:, 0], low[:, 1]].astype(np.float64)
    high = np.minimum(low + 1, np.array(heights.shape) - 1)
    down, right = np.clip(points - low, 0.0, 1.0).T
    found = np.zeros(len(points))
    for row, share_of_row in ((low[:, 0], 1.0 - down), (high[:, 0], down)):
        for col, share_of_col in ((low[:, 1], 1.0 - right), (high[:, 1], right)):
            share = share_of_row * share_of_col
            found += np.where(share > 0.0, share * heights[row, col], 0.0)
    return found
