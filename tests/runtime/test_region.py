import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nnpp_edge.runtime.region import RegionFinder
from tests import oracles


@settings(deadline=None, max_examples=300)
@given(st.integers(1, 16), st.integers(0, 2**32), st.sampled_from([4, 256]), st.data())
def test_the_threshold_equals_the_loop_over_thresholds(side, seed, levels, data):
    rng = np.random.default_rng(seed)
    finder = RegionFinder(side)
    probability = (rng.integers(0, levels, (side, side)) / levels).astype(np.float32)
    start, goal = ((data.draw(st.integers(0, side - 1)), data.draw(st.integers(0, side - 1))) for _ in range(2))
    finder.read(probability)
    np.testing.assert_array_equal(finder.levels, np.minimum(probability * 256, 255).astype(np.uint8))
    assert finder.threshold(start, goal) == oracles.threshold_by_loop(finder.levels, start, goal)


def test_a_marked_region_holds_what_is_above_and_both_ends():
    finder = RegionFinder(5)
    probability = np.zeros((5, 5), np.float32)
    probability[2] = 0.5
    finder.read(probability)
    first = finder.mark(128, (0, 0), (2, 4))
    assert (finder.bitmap == first).sum() == 6
    second = finder.mark(129, (0, 0), (2, 4), radius=1)
    assert second != first
    assert (finder.bitmap == second).sum() == 4 + 6
