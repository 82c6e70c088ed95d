"""The paper's dynamic scene."""

import numpy as np
import pytest

from nnpp_edge.reproduction.episode import make_episode
from nnpp_edge.runtime.errors import InvalidQueryError
from tests import oracles
from tests.strategies import uniform


def test_an_episode_is_the_same_for_the_same_seed_and_can_always_be_walked():
    cost = uniform(1, (128, 128), 0.0, 0.5)
    one, same, other = (make_episode(cost, (5, 5), (120, 120), seed) for seed in (4, 4, 5))
    assert len(one.steps) >= 3
    assert [step.start for step in one.steps] == [step.start for step in same.steps]
    for at, step in enumerate(one.steps):
        now = one.map_at(at)
        np.testing.assert_array_equal(now, same.map_at(at))
        passable = np.where(now < 1.0, now, np.inf)
        assert np.isfinite(oracles.dijkstra(passable, step.start)[one.goal])
    assert (one.map_at(2) >= 1.0).any()
    assert (one.map_at(2) != other.map_at(2)).any()


def test_where_no_scene_leaves_a_way_the_map_stays():
    cost = np.ones((60, 200), np.float32)
    cost[30] = 0.2  # any obstacle on it blocks the way
    episode = make_episode(cost, (30, 2), (30, 197), 3)
    assert len(episode.steps) >= 4
    for at in range(len(episode.steps)):
        np.testing.assert_array_equal(episode.map_at(at)[30], cost[30])


def test_an_episode_needs_a_way():
    cost = np.full((60, 60), 0.2, np.float32)
    cost[30] = 1.0
    with pytest.raises(InvalidQueryError, match="can be reached"):
        make_episode(cost, (5, 5), (50, 50), 1)
