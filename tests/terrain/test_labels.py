"""Labels of a training sample, against searches from both ends."""

import numpy as np
import pytest

from nnpp_edge.terrain.labels import EXCESS_STEP, label_queries
from tests import oracles


def test_labels_are_the_optimum_and_the_excess_of_every_block():
    rng = np.random.default_rng(0)
    cost = rng.random((16, 16)).astype(np.float32)
    cost[rng.random((16, 16)) < 0.2] = np.inf
    points = np.argwhere(np.isfinite(cost))[[3, 60, 150]].astype(np.int32)
    labelled = label_queries(cost, points, 4.0, 8, 0.011)
    assert labelled
    for start, goal, path, excess in labelled:
        forward = oracles.dijkstra(cost, start)
        backward = oracles.dijkstra(cost, goal)
        assert oracles.path_cost(path, cost) == pytest.approx(forward[goal], rel=1e-5)
        through = (forward + backward).reshape(8, 2, 8, 2).min(axis=(1, 3))
        wanted = np.minimum((through / forward[goal] - 1) / EXCESS_STEP, 255)
        np.testing.assert_allclose(excess, wanted, atol=0.6)
        assert (excess[path[:, 0] // 2, path[:, 1] // 2] == 0).all()
