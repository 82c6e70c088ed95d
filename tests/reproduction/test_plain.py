import math

import numpy as np
import pytest
from hypothesis import assume, given, settings

from nnpp_edge.reproduction.plain import build_graph, search
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
