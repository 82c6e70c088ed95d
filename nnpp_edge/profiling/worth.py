"""Whether a network of one's own is worth keeping: its answers beside another planner's on the same
queries, with intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nnpp_edge.profiling.intervals import Interval
from nnpp_edge.profiling.rows import Rows

RESAMPLED = 2000
"""Draws of the queries, with replacement, that an interval is made of."""
AS_FAST = 1.05
"""Factor between two planners' times up to which they count as equally fast."""
BETTER = "better"
WORSE = "worse"
ALIKE = "no difference shown"
KEEP = "keep it"
LEAVE = "not worth keeping"
OPEN = "cannot be told, more --queries narrow the intervals"


@dataclass(frozen=True)
class Beside:
    """A planner beside another one, over the same queries."""

    other: str
    gap_points: Interval
    """Its mean gap less the other's, in percentage points of the optimum's cost: below 0 it is
    closer to the optimum.
    """
    times_as_fast: Interval
    """Median over the queries of the other's time over its own."""

    @property
    def judgement(self) -> str:
        """`WORSE` where it is for sure farther or slower, else `BETTER` where it is closer or
        faster.
        """
        gap = self.gap_points
        speed = self.times_as_fast
        if gap.low > 0.0 or speed.high < 1.0 / AS_FAST:
            return WORSE
        return BETTER if gap.high < 0.0 or speed.low > AS_FAST else ALIKE


def beside(other: str, own: Rows, others: Rows) -> Beside:
    """Compare the rows of a planner's answers with those of another one."""
    gaps = np.subtract(own.all("gap"), others.all("gap"))
    faster = np.divide(others.all("time_ms"), own.all("time_ms"))
    drawn = np.random.default_rng(0).integers(len(gaps), size=(RESAMPLED, len(gaps)))
    return Beside(
        other,
        Interval.of(100.0 * gaps.mean(), 100.0 * gaps[drawn].mean(axis=1)),
        Interval.of(np.median(faster), np.median(faster[drawn], axis=1)),
    )


def verdict(found: Sequence[Beside]) -> str:
    """`KEEP` where a network is better than every other planner, `LEAVE` and what to take where it
    is worse than one, else `OPEN`.
    """
    for each in found:
        if each.judgement == WORSE:
            return f"{LEAVE}, take {each.other}"
    return OPEN if ALIKE in {each.judgement for each in found} else KEEP
