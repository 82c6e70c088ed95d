"""Numbers along the way: a path's length on the ground, its climb and slopes, and the time and
energy it takes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Float32s, Floats, Int32
from nnpp_edge.runtime.cells import Sides
from nnpp_edge.runtime.robots.slope.cost import Mobility, SlopeCost

Line = Int32 | Floats
"""(N, 2) row and column: cells of a path, or way points between them."""
Heights = Float32s | Floats
UNTOLD = Mobility()
"""Of a robot of which nothing is said."""
_APART = 0.4
"""Rows or columns between two places on a way between two way points, at most."""


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
    """By the vehicle's speeds; else of a walker by the step cost; NaN where that is none."""
    energy_j: float
    """By the vehicle's model; NaN where it has none."""

    @classmethod
    def unknown(cls) -> "Numbers":
        """Where there is no path, or no height is known."""
        return cls(*[math.nan] * len(cls._fields))


@dataclass(frozen=True, eq=False)
class Along:
    """A line over the ground, point by point from start to goal.

    Heights are read when it is made, all else is computed when it is asked for. Places are a path's
    cells; of way points, these and some between them: between two places the ground is then as good
    as even.
    """

    places: Line
    sampled_m: Heights
    sides_m: Sides
    mobility: Mobility = UNTOLD
    walker: SlopeCost | None = None

    @classmethod
    def of(
        cls,
        line: Line,
        heights: Heights,
        sides_m: Sides,
        mobility: Mobility | None = None,
    ) -> "Along":
        """A line over heights (H, W), metres, NaN where unknown."""
        places = places_along(line)
        return cls(places, heights_at(heights, places), sides_m, mobility or UNTOLD)

    def back(self) -> "Along":
        """This line from goal to start."""
        return replace(self, places=self.places[::-1], sampled_m=self.sampled_m[::-1])

    @cached_property
    def points(self) -> Floats:
        """(N, 2) the places."""
        return np.asarray(self.places, np.float64)

    @cached_property
    def heights_m(self) -> Floats:
        """(N,) of the ground; where unknown, between the known ones before and behind; NaN where
        none is known.
        """
        heights = np.array(self.sampled_m, np.float64)
        known = np.isfinite(heights)
        if known.any() and not known.all():
            at = self.distance_m
            heights = np.interp(at, at[known], heights[known])
        return heights

    @cached_property
    def steps_m(self) -> Floats:
        """(N,) from the point before, on the level; 0 for the first."""
        apart: Floats = np.hypot(
            *(np.diff(self.points, axis=0, prepend=self.points[:1]) * self.sides_m).T
        )
        return apart

    @cached_property
    def rises_m(self) -> Floats:
        """(N,) above the point before; 0 for the first."""
        return np.diff(self.heights_m, prepend=self.heights_m[:1])

    @cached_property
    def distance_m(self) -> Floats:
        """(N,) from the start, on the level."""
        return self.steps_m.cumsum()

    @cached_property
    def ground_m(self) -> Floats:
        """(N,) from the start, on the ground."""
        return np.hypot(self.steps_m, self.rises_m).cumsum()

    @cached_property
    def time_s(self) -> Floats:
        """(N,) seconds from the start; NaN where nobody's speed is known."""
        return self._by(self.mobility.time or self.walker)

    @property
    def time_by(self) -> str:
        """Whose time that is, in words; empty where it is nobody's."""
        if self.mobility.time is not None:
            return "at the vehicle's speeds"
        return "" if self.walker is None else f"on foot, by {self.walker.function}"

    @cached_property
    def energy_j(self) -> Floats:
        """(N,) joules from the start; NaN where the vehicle has no model of its energy."""
        return self._by(self.mobility.energy)

    def _by(self, model: SlopeCost | None) -> Floats:
        """A model's sum on the way to each point, NaN without a model; points may coincide."""
        if model is None:
            return np.full(len(self.points), math.nan)
        costs = np.zeros(len(self.points))
        moves = self.steps_m > 0.0
        costs[moves] = model.cost(self.steps_m[moves], self.rises_m[moves])
        return costs.cumsum()

    @cached_property
    def slopes_deg(self) -> Floats:
        """(N,) inclination of the way from the point before, below 0 downhill; NaN where no height
        is known.
        """
        return np.degrees(np.arctan2(self.rises_m, self.steps_m))

    @cached_property
    def numbers(self) -> Numbers:
        """Of the whole line; of one without a point all are NaN."""
        if not len(self.points):
            return Numbers.unknown()
        rises = self.rises_m
        slopes = self.slopes_deg
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


def places_along(line: Line) -> Line:
    """(M, 2) the points of a line (N, 2), and places on the way between them, no farther apart than
    `_APART`.

    A path's cells stay what they are.
    """
    if len(line) < 2 or line.dtype.kind == "i":
        return line.reshape(-1, 2)
    lengths = np.abs(np.diff(line, axis=0)).max(1)
    counts = np.maximum(np.ceil(lengths / _APART), 1.0).astype(np.int64)
    # numbers of points, with fractions on the way to the next
    shares = [number + np.arange(count) / count for number, count in enumerate(counts)]
    at = np.concatenate((*shares, [len(counts)]))
    return np.column_stack([np.interp(at, np.arange(len(line)), axis) for axis in line.T])


def joined(lines: Sequence[Line]) -> Line:
    """One line of several, each of which begins where the one before ends."""
    return np.concatenate([lines[0], *(line[1:] for line in lines[1:])])


def heights_at(heights: Heights, points: Line) -> Floats:
    """(N,) heights of a map (H, W) at places (N, 2), bilinear between the cells' middles, or of its
    cells (int).

    NaN where a height that counts is unknown; beyond the middles at the rim, the rim's.
    """
    if points.dtype.kind == "i":
        of_cells: Floats = heights[tuple(points.T)].astype(np.float64)
        return of_cells
    last = np.array(heights.shape) - 1
    low = np.clip(np.floor(points).astype(np.int32), 0, last)
    high = np.minimum(low + 1, last)
    down, right = np.clip(points - low, 0.0, 1.0).T
    found = np.zeros(len(points))
    for row, share_of_row in ((low[:, 0], 1.0 - down), (high[:, 0], down)):
        for col, share_of_col in ((low[:, 1], 1.0 - right), (high[:, 1], right)):
            share = share_of_row * share_of_col
            found += np.where(share > 0.0, share * heights[row, col], 0.0)
    return found
