import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from nnpp_edge.reproduction.plain_astar import build_graph, search
from nnpp_edge.reproduction.plain_dstar import PlainDStar
from tests import oracles
from tests.strategies import cases


@settings(deadline=None)
@given(cases(), st.integers(0, 2**32 - 1))
def test_after_every_change_of_map_region_and_start_it_finds_what_astar_finds_anew(case, seed):
    assume(case.step_cost == "paper")
    rng, cost, start = np.random.default_rng(seed), case.cost.copy(), case.start
    dstar = PlainDStar(cost, start, case.goal)
    for turn in range(4):
        inside = rng.random(cost.shape) < 0.9 if turn % 2 else np.ones(cost.shape, bool)
        inside[start] = inside[case.goal] = True
        if turn:
            dstar.change(cost, inside)
            dstar.move(start)
        path, anew = dstar.plan(), search(build_graph(cost, inside), start, case.goal)
        assert (path is None) == (anew is None)
        if path is not None and anew is not None:
            assert (path[0], path[-1]) == (start, case.goal)
            wanted = oracles.path_cost(anew, cost)
            assert oracles.path_cost(path, cost) == pytest.approx(wanted, rel=1e-6, abs=1e-9)
            start = path[len(path) // 3]
        row, col = (int(rng.integers(0, side)) for side in cost.shape)
        cost = cost.copy()
        cost[row : row + 3, col : col + 3] = rng.choice([0.0, 0.5, 1.0])
        cost[start] = cost[case.goal] = 0.1


def test_what_has_not_changed_is_not_searched_again():
    cost = np.random.default_rng(1).uniform(0.0, 0.8, (40, 40)).astype(np.float32)
    dstar = PlainDStar(cost, (2, 2), (37, 37))
    path = dstar.plan()
    expanded = dstar.expansions
    assert dstar.change(cost.copy()) == 0
    dstar.move(path[3])
    assert dstar.plan() == path[3:] and dstar.expansions == expanded
    cost[2:4, 8:12] = 1.0
    assert dstar.change(cost) == 8
    dstar.plan()
    assert 0 <= dstar.expansions - expanded < expanded


def test_level_ground_where_all_ways_are_as_long_is_no_trouble():
    rng, cost, start, goal = np.random.default_rng(2), np.zeros((40, 40), np.float32), (1, 1), (38, 37)
    dstar = PlainDStar(cost, start, goal)
    for _ in range(12):
        path, anew = dstar.plan(), search(build_graph(cost), start, goal)
        assert oracles.path_cost(path, cost) == pytest.approx(oracles.path_cost(anew, cost), rel=1e-9)
        start = path[2]
        row, col = (int(rng.integers(4, 34)) for _ in range(2))
        cost = cost.copy()
        cost[row : row + 5, col : col + 2] = 1.0 - cost[row, col]
        cost[start] = cost[goal] = 0.0
        dstar.change(cost)
        dstar.move(start)
