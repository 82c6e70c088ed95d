"""`Planner` from the outside: methods, statuses, several goals, reach, and sizes of maps."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Goal,
    Ground,
    Navigator,
    NetworkModel,
    Origin,
    Planner,
    Pose,
    Status,
)
from nnpp_edge.runtime.errors import ModelError
from tests.strategies import flat, uniform


def test_planners_run_in_parallel_threads():
    def costs_of(cost):
        planner = Planner(cost)
        return [planner.plan((0, 0), (299, 299), method="astar").cost for _ in range(5)]

    costs = [uniform(i, (300, 300)) for i in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(costs_of, costs)) == list(map(costs_of, costs))


def test_near_goals_are_found_by_exact_search_unless_the_way_is_long_and_auto_says_why(network):
    cost = flat(200, 200, 0.2)
    cost[100, 2:] = np.inf
    planner = Planner(cost, model=network)
    for goal, sources, methods in (
        ((80, 110), {"map"}, ("nnpp", "astar")),
        ((101, 150), {"region", "widened", "fallback"}, ("nnpp", "corridor")),
    ):
        by_network, picked = (
            planner.plan((99, 150), goal, method=m, keep_regions=True) for m in ("nnpp", "auto")
        )
        assert by_network.ok and picked.ok and by_network.source in sources
        assert (by_network.method, picked.method) == methods
        assert ("but the way is long" in picked.choice) == (picked.method == "corridor")
        assert (by_network.network_region is None) == (by_network.source == "map")
        assert by_network.choice == picked.reason == ""
    assert picked.summary()["method"] == picked.planner == "corridor"
    moving = DynamicPlanner(cost, (101, 150), model=network)
    moving.move((99, 150))
    assert moving.replan().planner == "corridor"
    always = Planner(cost, model=network, ask_from=0)
    assert always.plan((99, 150), (80, 110), method="nnpp").source == "region"


def test_another_omega_than_the_networks_is_said(network):
    with pytest.warns(UserWarning, match=r"trained for omega = 0\.011"):
        planner = Planner(flat(80, 80, 0.2), omega=0.05, model=network)
        planner.plan((0, 0), (70, 70), method="nnpp")


def test_a_network_is_given_by_its_name_or_file_or_loaded(network, tiny_model, tmp_path):
    cost = uniform(2, (100, 100)) * 0.5
    query = ((5, 5), (90, 80))
    torn = tmp_path / "torn.onnx"
    torn.write_bytes(tiny_model.read_bytes()[:500])
    for bad in (torn, tmp_path / "none.onnx", "no-such-model"):
        with pytest.raises(ModelError):
            Planner(cost, model=bad).plan(*query, method="nnpp")
    wanted = Planner(cost, model=network).plan(*query, method="nnpp")
    for model in (NetworkModel(tiny_model), tiny_model, str(tiny_model)):
        plan = Planner(cost, model=model).plan(*query, method="nnpp")
        np.testing.assert_array_equal(plan.path, wanted.path)
    other = Planner(cost, model="edge").plan(*query, method="nnpp")
    assert other.threshold != wanted.threshold


def test_maps_of_any_size_and_shape(network):
    for shape in ((300, 700), (1024, 300), (97, 1000), (1, 3000), (2000, 1)):
        planner = Planner(uniform(1, shape) * 0.9, model=network)
        ends = (0, 0), (shape[0] - 1, shape[1] - 1)
        exact = planner.plan(*ends, method="astar")
        for method in ("corridor", "nnpp"):
            plan = planner.plan(*ends, method=method)
            assert plan.ok and plan.lower_bound <= exact.cost * (1 + 1e-5)
            assert exact.cost * (1 - 1e-5) <= plan.cost < 1.2 * exact.cost


def test_a_status_says_why(network):
    cost = flat(10, 10)
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
        for method in ("astar", "corridor", "nnpp", "auto"):
            plan = Planner(cost, model=network).plan(start, goal, method=method)
            assert (plan.status, plan.reason) == (status, why)
            assert plan.choice == "" or status in (Status.NO_PATH, Status.OK)
        if status is not Status.GOAL_OUTSIDE_MAP:
            dynamic = DynamicPlanner(np.minimum(cost, 1.0), goal, "astar")
            dynamic.move(start)
            assert dynamic.replan().reason == why
        nav = Navigator(Ground(np.minimum(cost, 1.0)), "astar", snap_radius=0)
        nav.offer(Pose(*start))
        nav.offer(Goal(*goal))
        message = nav.tick()
        origin = Origin.FULL if status is Status.OK else Origin.NONE
        assert (message.outcome, message.origin, message.ok) == (
            status,
            origin,
            status is Status.OK,
        )
        assert bool(message.reason) != message.ok == bool(len(message.path))
    assert Planner(cost).plan((3, 3), (5, 10)).status is Status.START_BLOCKED


# --- on a map that changes


@pytest.mark.parametrize(
    ("method", "base"), [("corridor-dstar", "corridor"), ("nnpp-dstar", "nnpp")]
)
def test_a_search_of_a_region_is_repaired_from_step_to_step(network, method, base):
    cost = uniform(3, (300, 300), 0.3, 0.5)
    planner, fresh = (DynamicPlanner(cost, (280, 280), m, model=network) for m in (method, base))
    expansions = []
    for step in range(6):
        here = 10 + 4 * step
        for each in (planner, fresh):
            each.move((here, here))
            if step:
                each.update(here + 2, here + 2, flat(4, 4, 0.9))
        repaired = planner.replan()
        afresh = fresh.replan()
        assert repaired.ok and repaired.planner == method
        assert repaired.cost <= afresh.cost * (1 + 1e-5)
        expansions.append((repaired.expansions, afresh.expansions))
    assert all(ours < 0.5 * others for ours, others in expansions[1:]), expansions
