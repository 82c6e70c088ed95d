import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from nnpp_edge.reproduction.plain import PlainDStar, build_graph, search
from nnpp_edge.runtime import Planner
from tests import oracles
from tests.strategies import cases


@settings(deadline=None)
@given(cases())
def test_plain_astar_finds_the_optimum_that_our_exact_astar_finds(case):
    assume(case.step_cost == "paper")
    path = search(build_graph(case.cost), case.start, case.goal)
    plan = Planner(case.cost).plan(case.start, case.goal, method="astar")
    assert (path is not None) == plan.ok
    if path is not None:
        assert (path[0], path[-1]) == (case.start, case.goal)
        assert oracles.path_cost(path, case.cost) == pytest.approx(plan.cost, rel=1e-5, abs=1e-6)


def test_the_graph_of_a_region_holds_its_passable_cells_and_steps_alone():
    cost = np.full((4, 5), 0.25, np.float32)
    cost[1, 1] = np.nan
    inside = np.zeros((4, 5), bool)
    inside[:2, :3] = True
    graph = build_graph(cost, inside)
    cells = {graph.cell(node) for node in graph.edges}
    assert cells == {(0, 0), (0, 1), (0, 2), (1, 0), (1, 2)}
    steps = {graph.cell(node): step for node, step in graph.edges[graph.node((0, 1))]}
    weight = 2 * 0.25 * 255 * 0.011
    assert steps == pytest.approx(
        {(0, 0): 1 + weight, (0, 2): 1 + weight, (1, 0): math.sqrt(2) + weight, (1, 2): math.sqrt(2) + weight}
    )
    assert search(graph, (1, 0), (1, 2)) == [(1, 0), (0, 1), (1, 2)]


@settings(deadline=None)
@given(cases(), st.integers(0, 2**32 - 1))
def test_after_every_change_of_map_region_and_start_dstar_finds_what_astar_finds_anew(case, seed):
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
