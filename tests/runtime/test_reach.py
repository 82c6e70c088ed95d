"""What can be reached, against Dijkstra's algorithm over the whole map."""

import numpy as np
import pytest
from hypothesis import given

from nnpp_edge.runtime import Planner, Vehicle, pose_costs
from nnpp_edge.runtime.errors import InvalidQueryError
from tests import oracles
from tests.strategies import cases


@given(cases(any_size=False))
def test_the_cost_of_getting_anywhere_is_that_of_the_cheapest_path(case):
    planner = Planner(case.cost, step_cost=case.step_cost, corner_cutting=case.corner_cutting)
    wanted = oracles.dijkstra(case.cost, case.start, case.step_cost, case.corner_cutting)
    found = planner.reach(case.start)
    assert np.array_equal(np.isfinite(found), np.isfinite(wanted))
    assert found == pytest.approx(wanted, rel=1e-5)


def test_within_a_cost_the_rest_is_not_reached():
    cost = np.random.default_rng(1).random((30, 40)).astype(np.float32)
    planner = Planner(cost)
    whole, part = planner.reach((3, 4)), planner.reach((3, 4), 20.0)
    assert np.array_equal(np.isfinite(part), whole <= 20.0) and 0 < np.isfinite(part).sum() < cost.size
    assert np.array_equal(part[whole <= 20.0], whole[whole <= 20.0])
    assert planner.reach((3, 4), 0.0).min() == 0.0 and np.isfinite(planner.reach((3, 4), 0.0)).sum() == 1


def test_a_vehicle_reaches_what_its_plans_reach():
    heights = np.random.default_rng(2).uniform(0.0, 0.25, (40, 40)).astype(np.float32)
    vehicle = Vehicle(2.0, 1.5, 0.3, max_tilt_deg=14.0)
    planner = Planner.of_elevation(heights, 1.0, vehicle=vehicle, warn=False)
    stands = np.argwhere(np.isfinite(pose_costs(heights, 1.0, vehicle).min(0)))
    start = tuple(stands[len(stands) // 2].tolist())
    found = planner.reach(start)
    for goal in map(tuple, stands[:: max(len(stands) // 12, 1)].tolist()):
        assert planner.plan(start, goal, method="astar").cost == pytest.approx(float(found[goal]), rel=1e-5)


def test_from_nowhere_nothing_is_reached():
    cost = np.full((10, 10), 0.1, np.float32)
    cost[3, 3] = np.inf
    planner = Planner(cost)
    for start, words in (((3, 3), "is impassable"), ((10, 3), "outside the map"), ((0.5, 1), "two whole numbers")):
        with pytest.raises(InvalidQueryError, match=words):
            planner.reach(start)
    with pytest.raises(InvalidQueryError, match="within"):
        planner.reach((1, 1), -1.0)
