"""Paths by way of several places: legs, the best order by brute force, and what cannot be
joined.
"""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from nnpp_edge.runtime import Planner, Status, Traversability
from nnpp_edge.runtime.planners.tour import tour
from tests import oracles
from tests.strategies import flat, uniform


def map_with_stops(seed, count, side=24, blocked=0.15):
    rng = np.random.default_rng(seed)
    cost = rng.random((side, side)).astype(np.float32)
    cost[rng.random(cost.shape) < blocked] = np.inf
    passable = np.argwhere(np.isfinite(cost))
    stops = passable[rng.choice(len(passable), count, replace=False)].tolist()
    return cost, [tuple(stop) for stop in stops]


def test_where_a_path_costs_the_same_both_ways_each_two_places_are_planned_between_once_at_most(
    monkeypatch,
):
    cost, stops = map_with_stops(5, 8, side=64, blocked=0.1)
    planner = Planner(cost)
    asked = []

    def leg(begin, end):
        asked.append({begin, end})
        return planner.plan(begin, end, method="corridor")

    def at_least(begin, end):
        return 0.8 * planner.plan(begin, end, method="corridor").cost

    monkeypatch.setattr(planner.state.grid, "least_cost", at_least)
    found = tour(leg, stops, planner.state.grid, best_order=True)
    assert len(asked) == len(set(map(frozenset, asked))) < 8 * 7 // 2 - 1, (
        "and not all that might be"
    )
    assert oracles.path_problem(found.plan.path, cost, stops[0], stops[-1]) == ""
    assert found.plan.cost == pytest.approx(oracles.path_cost(found.plan.path, cost), rel=1e-5)


def test_a_leg_that_was_planned_from_its_other_end_has_the_numbers_of_its_own_way():
    heights = uniform(3, (40, 40), 0.0, 0.2)
    _, stops = map_with_stops(5, 7, side=40)
    planner = Planner.of_elevation(heights, 20.0, Traversability())
    found = planner.plan_via(stops[0], stops[-1], stops[1:-1], best_order=True, method="corridor")
    for leg in found.legs:
        ends = leg.along.heights_m[[0, -1]]
        assert ends == pytest.approx(heights[tuple(leg.path[[0, -1]].T)], abs=1e-5)


def test_only_the_legs_that_are_taken_are_finished_and_the_tour_is_made_of_what_they_became():
    cost, stops = map_with_stops(5, 6, side=40, blocked=0.0)
    planner = Planner(cost)
    finished = []

    def finish(leg):
        finished.append((tuple(leg.path[0]), tuple(leg.path[-1])))
        return replace(leg, cost=leg.cost + 100.0)

    plain = tour(planner.plan, stops, planner.state.grid, best_order=True)
    found = tour(planner.plan, stops, planner.state.grid, best_order=True, finish=finish)
    assert finished == list(zip(found.stops[:-1], found.stops[1:], strict=True))
    assert found.plan.cost == pytest.approx(plain.plan.cost + 500.0) and found.order == plain.order


def test_a_leg_that_has_no_path_is_named():
    cost = flat(40, 40, 0.2)
    cost[:, 20] = np.inf
    planner = Planner(cost)
    for method, best_order in itertools.product(("astar", "corridor"), (False, True)):
        found = planner.plan_via(
            (1, 1), (30, 5), [(5, 5), (9, 30)], method=method, best_order=best_order
        )
        assert found.plan.status is Status.NO_PATH and not len(found.plan.path)
        assert (
            found.plan.reason
            == "leg 2 of 3, from (5, 5) to (9, 30): no path exists on the known map"
        )
        assert found.plan.cost == math.inf and [leg.ok for leg in found.legs] == [True, False]
        found = planner.plan_via((1, 1), (7, 20), [(2, 2)], best_order=best_order)
        assert (found.plan.status, found.plan.source) == (Status.GOAL_BLOCKED, None)


def test_without_places_a_tour_is_a_plan_and_more_than_a_dozen_are_visited_in_the_order_given_alone():
    planner = Planner(flat(5, 40, 0.1))
    found = planner.plan_via((2, 0), (2, 39), [(2, 10), (2, 20), (2, 30)], best_order=True)
    assert found.order == (0, 1, 2) and found.plan.cost == pytest.approx(found.given_cost)
    found = planner.plan_via((0, 0), (0, 39), [], best_order=True)
    plan = planner.plan((0, 0), (0, 39))
    assert found.plan.cost == plan.cost and found.plan.reason == plan.reason
    stops = [(at % 5, 2 * at + 1) for at in range(13)]
    assert planner.plan_via((0, 0), (0, 39), stops).plan.ok
