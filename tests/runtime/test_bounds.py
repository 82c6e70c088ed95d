"""The certified bound: whatever the method, no path costs less than a plan's lower bound."""

import math
from collections import Counter

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from nnpp_edge.runtime import (
    DynamicPlanner,
    Method,
    NetworkModel,
    Planner,
    Source,
    Vehicle,
)
from tests import oracles
from tests.pose_oracles import rocks
from tests.strategies import uniform

CLOSE = 1e-5
"""g is kept in float32."""


@pytest.fixture(scope="module")
def network():
    """The shipped network: the tiny one of other tests leaves no optimum out."""
    return NetworkModel("edge")


def maps(step_cost, count, seed):
    """Maps of 60 to 120 cells a side, with walls, on which regions are smaller than the map.

    On every other one costs are nearly equal but for a swamp: there bounds are tight, and one that
    is too high shows.
    """
    rng = np.random.default_rng(seed)
    for number in range(count):
        shape = tuple(rng.integers(60, 120, 2))
        cost = rng.random(shape) ** rng.choice([0.5, 2.0]) * 0.9
        if number % 2:
            hills = gaussian_filter(cost, rng.choice([1.0, 3.0, 8.0]))
            cost = 0.02 * (hills - hills.min()) / np.ptp(hills)
            rows, cols = np.ogrid[
                : shape[0], : shape[1]
            ]  # a swamp on the straight line, to be walked around
            away = np.hypot(rows / shape[0] - 0.5, cols / shape[1] - 0.5)
            cost += rng.choice([0.0, 0.05, 0.15, 0.4]) * (away < rng.choice([0.1, 0.2, 0.3]))
        cost = (cost + 0.05).astype(np.float32)
        cost[rng.random(shape) < rng.choice([0.0, 0.02, 0.2, 0.35])] = np.inf
        start = (1, 1)
        goal = (shape[0] - 2, shape[1] - 2)
        cost[start] = cost[goal] = 0.5
        yield cost * (100.0 if step_cost == "length" else 1.0), start, goal, bool(rng.integers(2))


def check(plan, optimum, refused):
    """The bound of a plan: against Dijkstra's optimum, and against the least that a path out of its
    region can cost.

    The second is what the bound is: one that is too high hardly ever comes to lie above the
    optimum.
    """
    assert plan.ok == math.isfinite(optimum)
    if plan.ok:
        assert 0.0 < plan.lower_bound <= min(optimum * (1.0 + CLOSE), plan.cost)
        assert optimum * (1.0 - CLOSE) <= plan.cost <= plan.bound * optimum * (1.0 + CLOSE)
        expected = min(plan.cost, refused)
        assert (1.0 - CLOSE) * expected <= plan.lower_bound <= (1.0 + CLOSE) * expected


def refused_by(plan, cost, *query):
    """The least that a path out of a plan's region can cost; inf where the whole map was
    searched.
    """
    return (
        math.inf
        if plan.region is None
        else oracles.bound_by_region(cost, plan.region.mask(), *query)
    )


@pytest.mark.parametrize("epsilon", [math.inf, 0.02, 0.0])
@pytest.mark.parametrize("method", Method)
def test_every_methods_bound_holds_and_is_as_close_as_asked(network, method, epsilon):
    for step_cost in ("paper", "length"):
        sources = Counter()
        for cost, start, goal, corner_cutting in maps(step_cost, 10, 1):
            options = {
                "step_cost": step_cost,
                "corner_cutting": corner_cutting,
                "model": network,
                "ask_from": 0,
            }
            plan = Planner(cost, **options).plan(
                start, goal, method=method, epsilon=epsilon, keep_regions=True
            )
            optimum = oracles.dijkstra(cost, start, step_cost, corner_cutting)[goal]
            check(plan, optimum, refused_by(plan, cost, start, goal, step_cost, corner_cutting))
            if plan.ok:
                assert plan.cost <= (1.0 + epsilon) * plan.lower_bound * (1.0 + 1e-9)
                assert plan.cost <= (1.0 + epsilon) * optimum * (1.0 + CLOSE)
            sources[plan.source] += 1
        if epsilon == math.inf and method is not Method.ASTAR:
            assert (
                sources[Source.REGION] + sources[Source.WIDENED] >= 2
            )  # else the bound was an exact search's


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
