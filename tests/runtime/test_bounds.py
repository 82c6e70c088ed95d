"""Lower bounds of paths that searches do not say themselves; those of regions are in `test_robots`."""

import math

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Planner,
    Source,
    Status,
    Vehicle,
)
from nnpp_edge.runtime.planners.joining import ON_IT, nearest_on
from nnpp_edge.runtime.planners.query import Found
from nnpp_edge.runtime.search.astar import Query, Search
from tests import oracles
from tests.pose_oracles import rocks
from tests.strategies import uniform

CLOSE = 1e-5
"""g is kept in float32."""


@pytest.mark.parametrize("ends", [("start",), ("goal",), ("start", "goal")])
def test_the_bound_of_a_bodys_path_leaves_out_turns_on_the_spot_at_its_ends(ends):
    """They count in the search for a given heading; the cost of a path of cells is without them."""
    vehicle = Vehicle(1.3, 0.9, 0.3)
    for seed in range(12):
        dem = rocks(seed, 60, 60, 0.01)
        dem[:14, :14] = dem[44:, 42:] = 0.0  # there it can turn
        planner = Planner.of_elevation(dem, 0.25, vehicle=vehicle, warn=False)
        plans = [
            planner.plan((6, 6), (52, 50), method="astar", **headings)
            for heading in range(0, 360, 45)
            for headings in [{f"{end}_heading_deg": float(heading) for end in ends}]
        ]
        costs = [plan.cost for plan in plans if plan.ok]
        assert all(plan.lower_bound <= min(costs) * (1 + CLOSE) for plan in plans if plan.ok)


def test_the_bound_of_a_mended_path_is_what_a_path_costs_at_the_least():
    """D* Lite does not say what it refused."""
    cost = uniform(2, (120, 120), 0.05, 0.35)
    cost[60, 10:110] = np.inf
    at = (10, 10)
    goal = (110, 110)
    mended = 0
    planner = DynamicPlanner(cost, goal, "corridor-dstar")
    for _ in range(8):
        planner.move(at)
        plan = planner.replan()
        if plan.source is Source.REGION:
            prices = (
                length + 255 * 0.011 * 2.0 * float(cost.min()) for length in (1.0, math.sqrt(2.0))
            )
            assert plan.lower_bound == pytest.approx(
                oracles.octile(cost.shape, goal, *prices)[at], rel=CLOSE
            )
            mended += 1
        at = tuple(plan.path[2].tolist())
        row, col = plan.path[12].tolist()
        cost[row, col] = 0.9
        planner.update(row, col, cost[row : row + 1, col : col + 1])
    assert mended >= 2


@pytest.mark.parametrize(("cost", "bound"), [(1.04, 1.0), (-0.96, -1.0)])
def test_a_path_suffices_within_epsilon_of_its_bound_also_where_energy_is_got_back(cost, bound):
    search = Search(Status.OK, np.zeros((1, 2), np.int32), 0)
    for epsilon, suffices in ((0.03, False), (0.05, True), (math.inf, True)):
        found = Found(search, Source.REGION, cost, lower_bound=bound)
        assert found.suffices(Query((0, 0), (1, 1), epsilon)) == suffices


def test_where_a_path_crosses_itself_a_body_is_in_the_state_with_its_heading():
    path = np.array(((0, 0, 3), (0, 1, 4), (1, 1, 5), (0, 0, 8 + 16)), np.int32)
    assert [nearest_on(path, (0, 0), heading) for heading in (3, 8)] == [(0, ON_IT), (3, ON_IT)]
