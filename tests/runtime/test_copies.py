"""Copies of planners, as a pool of processes makes them: pickled, and by copy.deepcopy."""

import copy
import pickle

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, NetworkModel, Planner

COST = np.random.default_rng(2).random((200, 220)).astype(np.float32)
ENDS = (3, 4), (190, 200)
WAYS = [copy.deepcopy, lambda planner: pickle.loads(pickle.dumps(planner))]


@pytest.mark.parametrize("way", WAYS, ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("model", ["edge", "loaded"])
def test_a_copy_of_a_planner_answers_alike_and_goes_its_own_way(way, model):
    planner = Planner(COST, model=NetworkModel("edge") if model == "loaded" else model)
    planner.update(20, 20, np.ones((30, 3)))
    before = {method: planner.plan(*ENDS, method=method) for method in ("nnpp", "corridor", "astar")}
    other = way(planner)
    for method, plan in before.items():
        again = other.plan(*ENDS, method=method)
        assert (again.cost, again.lower_bound) == (plan.cost, plan.lower_bound)
        assert np.array_equal(again.path, plan.path)
    assert other.update(0, 0, np.ones((200, 2))) == 400
    assert np.array_equal(planner.plan(*ENDS, method="astar").path, before["astar"].path)


@pytest.mark.parametrize("way", WAYS, ids=["deepcopy", "pickle"])
def test_a_copy_of_a_dynamic_planner_follows_the_same_path(way):
    methods = ("dstar", "nnpp-dstar", "corridor-dstar")
    planner = DynamicPlanner(COST, ENDS[1], "auto", also=methods)
    planner.move(ENDS[0])
    for method in methods:
        planner.replan(method=method)
    planner.update(20, 20, np.full((3, 3), 0.4))
    other = way(planner)
    assert (other.goal, other.methods, other.standing().valid) == (ENDS[1], planner.methods, True)
    assert other.standing().cost == pytest.approx(planner.standing().cost)
    assert other.standing().lower_bound <= planner.replan(method="dstar").cost
    assert other.replan(method="dstar").cost == pytest.approx(planner.replan(method="dstar").cost, rel=1e-6)
