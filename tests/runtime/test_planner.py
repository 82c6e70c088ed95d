import gc
import math
import threading
import weakref

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime import DynamicPlanner, NetworkModel, Planner, Source, Status, Vehicle, plan_path
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, ModelError
from tests import oracles
from tests.strategies import cases

METHODS = ["astar", "corridor", "nnpp", "auto"]


def test_a_wall_that_averages_hide_is_respected():
    cost = np.full((256, 256), 0.1, np.float32)
    cost[128, :] = 1.0
    cost[128, 250] = 0.1
    plan = plan_path(cost, (10, 10), (250, 10), method="corridor")
    assert plan.ok
    assert plan.cost == pytest.approx(plan_path(cost, (10, 10), (250, 10), method="astar").cost, rel=0.05)
    cost[128, 250] = 1.0
    plan = plan_path(cost, (10, 10), (250, 10), method="corridor")
    assert plan.status is Status.NO_PATH
    assert plan.source is Source.FALLBACK


def test_planners_run_in_parallel_threads():
    costs = [np.random.default_rng(i).random((300, 300)).astype(np.float32) for i in range(4)]
    wanted = [plan_path(c, (0, 0), (299, 299), method="astar").cost for c in costs]
    found = [0.0] * 4

    def work(i):
        planner = Planner(costs[i])
        for _ in range(5):
            found[i] = planner.plan((0, 0), (299, 299), method="astar").cost

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == wanted


def test_auto_says_which_it_picked_and_why(network):
    planner = Planner(np.random.default_rng(0).random((200, 200)).astype(np.float32) * 0.9, model=network)
    near, far = planner.plan((0, 0), (9, 9)), planner.plan((0, 0), (190, 190))
    assert (near.method, far.method) == ("astar", "corridor")
    assert near.choice != far.choice and near.reason == far.reason == ""
    assert planner.plan((0, 0), (9, 9), method="astar").choice == ""


def test_near_goals_are_found_by_exact_search_unless_the_way_is_long(network):
    cost = np.full((200, 200), 0.2, np.float32)
    cost[100, 2:] = np.inf
    planner = Planner(cost, model=network)
    for goal, sources, methods in (
        ((80, 110), {"map"}, ("nnpp", "astar")),
        ((101, 150), {"region", "widened", "fallback"}, ("nnpp", "corridor")),
    ):
        by_network, picked = (planner.plan((99, 150), goal, method=m, keep_regions=True) for m in ("nnpp", "auto"))
        assert by_network.ok
        assert picked.ok
        assert by_network.source in sources
        assert (by_network.method, picked.method) == methods
        assert ("but the way is long" in picked.choice) == (picked.method == "corridor")
        assert (by_network.network_region is None) == (by_network.source == "map")
    assert picked.summary()["method"] == picked.planner == "corridor"
    always = Planner(cost, model=network, ask_from=0)
    assert always.plan((99, 150), (80, 110), method="nnpp").source == "region"


def test_another_omega_than_the_networks_is_said(network):
    cost = np.random.default_rng(0).random((80, 80)).astype(np.float32)
    with pytest.warns(UserWarning, match=r"trained for omega = 0\.011"):
        plan_path(cost, (0, 0), (70, 70), method="nnpp", omega=0.05, model=network)


@pytest.mark.parametrize("step_cost", ["paper", "length"])
def test_a_map_without_a_passable_cell_can_open(step_cost):
    planner = Planner(np.full((80, 80), np.nan), step_cost=step_cost)
    assert planner.plan((1, 1), (70, 70)).status is Status.START_BLOCKED
    planner.update(0, 0, np.full((80, 80), 0.5)[:79])
    assert planner.plan((1, 1), (70, 70), method="corridor").ok


@given(cases(24), st.integers(1, 6), st.integers(1, 3), st.data())
def test_the_nearest_of_several_goals_comes_first(case, goals, count, data):
    passable = np.argwhere(np.isfinite(case.cost))
    chosen = [tuple(int(x) for x in passable[data.draw(st.integers(0, len(passable) - 1))]) for _ in range(goals)]
    planner = Planner(case.cost, step_cost=case.step_cost, corner_cutting=case.corner_cutting)
    ranked = planner.nearest(case.start, chosen, count=count, method="astar")
    costs = oracles.dijkstra(case.cost, case.start, case.step_cost, case.corner_cutting)[
        tuple(zip(*chosen, strict=True))
    ]
    wanted = np.sort(costs)[:count]
    assert [plan.ok for _, plan in ranked] == np.isfinite(wanted).tolist()
    assert [plan.cost for _, plan in ranked] == pytest.approx(wanted.tolist(), rel=1e-5, abs=1e-6)
    for at, plan in ranked:
        assert not plan.ok or tuple(plan.path[-1]) == chosen[at]


def test_another_network_is_used_whole_or_not_at_all(network, tiny_model, tmp_path):
    cost = np.random.default_rng(2).random((100, 100)).astype(np.float32) * 0.5
    query, method = ((5, 5), (90, 80)), "nnpp"
    planner = Planner(cost, model=network)
    before = planner.plan(*query, method=method)
    torn = tmp_path / "torn.onnx"
    torn.write_bytes(tiny_model.read_bytes()[:500])
    for bad in (torn, tmp_path / "none.onnx", "no-such-model"):
        with pytest.raises(ModelError):
            planner.use_model(bad)
    assert planner.plan(*query, method=method).threshold == before.threshold
    for model in (NetworkModel(tiny_model), tiny_model, str(tiny_model)):
        planner.use_model(model)
        np.testing.assert_array_equal(planner.plan(*query, method=method).path, before.path)
    planner.use_model("edge")
    assert planner.plan(*query, method=method).threshold != before.threshold


def test_maps_of_any_size_and_shape(network):
    for shape in ((300, 700), (1024, 1024), (97, 1000), (1, 3000), (2000, 1)):
        planner = Planner(np.random.default_rng(1).random(shape).astype(np.float32) * 0.9, model=network)
        ends = (0, 0), (shape[0] - 1, shape[1] - 1)
        exact = planner.plan(*ends, method="astar")
        for method in ("corridor", "nnpp"):
            plan = planner.plan(*ends, method=method)
            assert plan.ok and plan.lower_bound <= exact.cost * (1 + 1e-5)
            assert exact.cost * (1 - 1e-5) <= plan.cost < 1.2 * exact.cost


def test_a_status_says_why(network):
    cost = np.zeros((10, 10), np.float32)
    cost[3, 3] = np.nan
    cost[8, 8:] = cost[8:, 8] = 1.0
    for start, goal, status, why in (
        ((-1, 0), (5, 5), Status.START_OUTSIDE_MAP, "start (-1, 0) lies outside the map"),
        ((0, 0), (5, 10), Status.GOAL_OUTSIDE_MAP, "goal (5, 10) lies outside the map"),
        ((3, 3), (5, 5), Status.START_BLOCKED, "start (3, 3) is impassable"),
        ((0, 0), (3, 3), Status.GOAL_BLOCKED, "goal (3, 3) is impassable"),
        ((0, 0), (9, 9), Status.NO_PATH, "no path exists on the known map"),
        ((0, 0), (0, 0), Status.OK, ""),
    ):
        for method in METHODS:
            plan = plan_path(cost, start, goal, method=method, model=network)
            assert (plan.status, plan.reason) == (status, why)
            assert plan.choice == "" or status in (Status.NO_PATH, Status.OK)
        if status is not Status.GOAL_OUTSIDE_MAP:
            dynamic = DynamicPlanner(np.minimum(cost, 1.0), goal, "astar")
            dynamic.move(start)
            assert dynamic.replan().reason == why


def test_what_makes_no_sense_is_refused():
    for cost in (np.zeros((3, 3, 3)), np.zeros((0, 3)), np.full((3, 3), -0.1), np.array([["a"]]), np.array([1, 2])):
        with pytest.raises(InvalidMapError):
            Planner(cost)
    with pytest.raises(InvalidMapError, match=r"from 1\.18e-38 to 1e\+30, got one of 0"):
        Planner(np.zeros((3, 3)), step_cost="length")
    odd = ({"method": "best"}, {"step_cost": "euclid"}, {"omega": -1.0}, {"start": (1.5, 2)}, {"goal": 7})
    for wrong in (*odd, {"epsilon": -0.1}, {"epsilon": math.nan}):
        with pytest.raises(InvalidQueryError):
            plan_path(np.zeros((3, 3)), **{"start": (0, 0), "goal": (2, 2)} | wrong)
    with pytest.raises(InvalidQueryError, match="at least one goal"):
        Planner(np.zeros((4, 4), np.float32)).nearest((0, 0), [])


def test_a_planner_gives_its_memory_back_at_once():
    """Large maps come and go: nothing waits for the collector of garbage in circles."""
    gc.disable()
    try:
        for vehicle in (None, Vehicle(radius_m=1.0), Vehicle(3.0, 2.0, 0.5)):
            planner = Planner.of_elevation(np.zeros((40, 40), np.float32), 1.0, vehicle=vehicle)
            planner.plan((5, 5), (34, 34), method="corridor")
            grid = weakref.ref(planner.state.grid)
            del planner
            assert grid() is None
    finally:
        gc.enable()
