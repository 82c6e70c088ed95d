"""Whether a network is worth keeping: intervals of paired differences, and what follows from them."""

import numpy as np
import pytest

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.profiling.worth import (
    ALIKE,
    BETTER,
    KEEP,
    LEAVE,
    OPEN,
    WORSE,
    Beside,
    Interval,
    beside,
    verdict,
)


def answers(gaps, times_ms):
    return Rows({"gap": gap, "time_ms": ms} for gap, ms in zip(gaps, times_ms, strict=True))


def compared(gap, speed):
    """Beside another planner, by the ends of both intervals."""
    low, high = gap
    slow, fast = speed
    return Beside("corridor", Interval(low, low, high), Interval(slow, slow, fast))


def test_an_interval_holds_the_mean_difference():
    rng = np.random.default_rng(1)
    others = rng.uniform(0.0, 0.04, 400)
    own = others - 0.001 + rng.normal(0.0, 0.01, 400)
    found = beside("edge", answers(own, [2.0] * 400), answers(others, [3.0] * 400))
    gap = found.gap_points
    assert gap.value == pytest.approx(100.0 * (own - others).mean())
    assert gap.low < -0.1 < gap.high
    # 1.96 standard errors to each side
    assert gap.high - gap.low == pytest.approx(3.92 * 100.0 * 0.01 / np.sqrt(400), rel=0.1)
    speed = found.times_as_fast
    assert (speed.value, speed.low, speed.high) == pytest.approx((1.5, 1.5, 1.5))


@pytest.mark.parametrize(
    ("gap", "speed", "wanted"),
    [
        ((-0.3, -0.1), (0.96, 1.0), BETTER),  # closer, and as fast within the tolerance
        ((-0.1, 0.1), (1.1, 1.2), BETTER),
        ((0.1, 0.3), (1.0, 1.02), WORSE),
        ((-0.1, 0.1), (0.7, 0.9), WORSE),
        ((-0.3, -0.1), (0.7, 0.9), WORSE),
        ((0.1, 0.3), (1.1, 1.2), WORSE),
        ((-0.3, 0.1), (0.9, 1.2), ALIKE),
    ],
)
def test_better_is_closer_or_faster_and_neither_farther_nor_slower(gap, speed, wanted):
    assert compared(gap, speed).judgement == wanted


def test_a_network_is_kept_where_it_is_better_than_all_and_left_where_one_is_as_good_for_sure():
    better = compared((-0.3, -0.1), (1.0, 1.0))
    open_yet = compared((-0.3, 0.1), (1.0, 1.0))
    worse = compared((0.1, 0.3), (1.0, 1.0))
    assert verdict([better, better]) == KEEP
    assert verdict([better, open_yet]) == OPEN
    left = f"{LEAVE}, take {worse.other}"
    assert verdict([better, worse]) == verdict([open_yet, worse]) == left
