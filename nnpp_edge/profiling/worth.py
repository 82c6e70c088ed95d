"""Whether a network of one's own is worth keeping: its answers beside another planner's on the same
queries, with intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.contest import Row

RESAMPLED = 2000
"""Draws of the queries, with replacement, that an interval is made of."""
AS_FAST = 1.05
"""Factor between two planners' times up to which they count as equally fast."""
KEEP = "keep it"
LEAVE = "not worth keeping"
OPEN = "cannot be told"
BETTER = "better"
WORSE = "worse"
TRADE = "closer but slower, or faster but farther"
ALIKE = "no difference shown"


@dataclass(frozen=True)
class Interval:
    """A figure, and between what it lies at 95 %, had other queries been drawn on this ground."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Beside:
    """A planner beside another one, over the same queries."""

    other: str
    queries: int
    gap_points: Interval
    """Its mean gap less the other's, in percentage points of the optimum's cost: below 0 it is
    closer to the optimum.
    """
    times_as_fast: Interval
    """The other's summed times over its own."""

    @property
    def judgement(self) -> str:
        """What the intervals show: `BETTER` where it is closer or faster and not the opposite of
        the other.
        """
        gap = self.gap_points
        speed = self.times_as_fast
        gains = (gap.high < 0.0, speed.low > AS_FAST)
        losses = (gap.low > 0.0, speed.high < 1.0 / AS_FAST)
        if any(gains):
            return TRADE if any(losses) else BETTER
        return WORSE if any(losses) else ALIKE


def beside(other: str, own: Sequence[Row], others: Sequence[Row], seed: int = 0) -> Beside:
    """Compare rows of `profiling.evaluate.answers` with those of another planner, which are of the
    same queries in the same order.
    """
    pairs = zip(own, others, strict=True)
    columns = [
        (ours["gap"] - theirs["gap"], ours["time_ms"], theirs["time_ms"]) for ours, theirs in pairs
    ]
    figures = np.array(columns).T
    count = figures.shape[1]
    drawn = np.random.default_rng(seed).integers(count, size=(RESAMPLED, count))
    gap, own_ms, other_ms = figures.mean(axis=1)
    resampled = figures[:, drawn].mean(axis=-1)
    return Beside(
        other,
        count,
        _interval(100.0 * gap, 100.0 * resampled[0]),
        _interval(other_ms / own_ms, resampled[2] / resampled[1]),
    )


def _interval(value: float, drawn: NDArray[np.float64]) -> Interval:
    low, high = np.quantile(drawn, (0.025, 0.975))
    return Interval(float(value), float(low), float(high))


def verdict(found: Sequence[Beside]) -> str:
    """`KEEP` where a network is better than every other planner, `OPEN` where more queries might
    show that, else `LEAVE`.
    """
    judgements = {each.judgement for each in found}
    if judgements == {BETTER}:
        return KEEP
    return OPEN if judgements <= {BETTER, ALIKE} else LEAVE
