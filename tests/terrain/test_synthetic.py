import numpy as np
import pytest

from nnpp_edge.terrain.synthetic import synthetic_terrain


@pytest.mark.parametrize("size", [2, 3, 12, 14, 16, 40])
def test_synthetic_terrain_may_be_small(size):
    for seed in range(10):
        heights = synthetic_terrain(np.random.default_rng(seed), size, 5.0)
        assert heights.shape == (size, size) and heights.dtype == np.float32 and np.isfinite(heights).all()
