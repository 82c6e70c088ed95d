import numpy as np
import pytest

from nnpp_edge.reproduction.episode import make_episode
from nnpp_edge.runtime.errors import InvalidQueryError
from tests import oracles


def test_an_episode_is_the_same_for_the_same_seed_and_can_always_be_walked():
    cost = (np.random.default_rng(1).random((128, 128)) * 0.5).astype(np.float32)
    one, two, other = (make_episode(cost, (5, 5), (120, 120), seed) for seed in (4, 4, 5))
    assert [s.start for s in one.steps] == [s.start for s in two.steps]
    for a, b in zip(one.steps, two.steps, strict=True):
        assert all(
            p[:2] == q[:2] and np.array_equal(p[2], q[2])
            for p, q in zip(a.patches, b.patches, strict=True)
        )
    assert any(
        [p[:2] for p in a.patches] != [p[:2] for p in b.patches]
        for a, b in zip(one.steps, other.steps, strict=False)
    )
    now = cost.copy()
    for step in one.steps:
        for row, col, patch in step.patches:
            now[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
        assert np.isfinite(oracles.dijkstra(np.where(now < 1, now, np.inf), step.start)[one.goal])
    assert len(one.steps) >= 3
    assert any((patch >= 1.0).any() for step in one.steps for *_, patch in step.patches)


def test_an_episode_needs_a_way():
    cost = np.full((60, 60), 0.2, np.float32)
    cost[30] = 1.0
    with pytest.raises(InvalidQueryError, match="can be reached"):
        make_episode(cost, (5, 5), (50, 50), 1)
