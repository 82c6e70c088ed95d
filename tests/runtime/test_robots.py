"""Every method, for every robot, on every kind of map, beside Dijkstra's algorithm: standing maps,
maps that change, tours and what can be reached.

More maps: ``NNPP_EDGE_MAPS=100 pytest tests/runtime/test_robots.py``.
"""

import itertools
import math
import os
import pickle
from collections import Counter
from contextlib import suppress

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicMethod, Method, ToblerCost
from nnpp_edge.runtime.map import changes, pyramid
from nnpp_edge.runtime.options import CELLS, METHODS
from nnpp_edge.runtime.robots.body import search
from nnpp_edge.runtime.terrain.traversability import terrain_terms
from tests import oracles
from tests.doors import DOORS
from tests.fuzz.sequences import interrupting
from tests.worlds import ANY_MOTIONS, WORLDS, same_maps

MAPS = int(os.environ.get("NNPP_EDGE_MAPS", "10"))
ALL = WORLDS | ANY_MOTIONS
KNOWN = {"any arcs": [98, 213]}
"""Numbers of worlds in which an answer was wrong once."""
pytestmark = pytest.mark.filterwarnings("ignore:the network .* was trained for omega")


TURNS = 6


@pytest.fixture
def worlds(monkeypatch):
    """Makes the first worlds of a name; on each other one small maps have several coarse levels,
    and few changes are told apart.
    """

    def made(name, seed=0):
        count = MAPS // 2 if "body" in name or "arcs" in name else MAPS
        for number in [*range(count), *KNOWN.get(name, [])]:
            few = number % 2
            monkeypatch.setattr(pyramid, "ANOTHER_LEVEL_FROM", (256, 8)[few])
            for expansions in ("AROUND_GOAL", "LATE_IN_REGION", "LATE_ON_MAP"):
                monkeypatch.setattr(search, expansions, (4096, 96)[few])
            monkeypatch.setattr(changes, "MOST_LOGGED_CHANGES", (64, 2)[few])
            yield ALL[name](np.random.default_rng([seed, number]))

    return made


@pytest.mark.parametrize("name", ALL)
def test_every_method_finds_dijkstras_cost_and_no_bound_is_above_it(name, worlds, network):
    found = 0
    for world in worlds(name):
        planner = world.planner(model=network, ask_from=0)
        cells = world.cells(3)
        for start, goal in itertools.permutations(cells, 2):
            headings = world.headings()
            optimum = world.optimum(start, goal, *headings)
            begin, end = map(world.heading, headings)
            options = {"start_heading_deg": begin, "goal_heading_deg": end, "keep_regions": True}
            for method, epsilon in itertools.product(Method, (math.inf, 0.02, 0.0)):
                plan = planner.plan(start, goal, method=method, epsilon=epsilon, **options)
                allowed = min(epsilon, METHODS[plan.method].bound - 1.0)
                world.judge(plan, optimum, allowed)
                found += plan.ok
                if name in ("costs", "lengths") and plan.ok and plan.region is not None:
                    region = plan.region.mask()
                    out = oracles.bound_by_region(world.cost, region, start, goal, *world.rule)
                    bound = min(plan.cost, out)
                    assert plan.lower_bound == pytest.approx(bound, rel=1e-5, abs=1e-6)
        if world.passable[start]:
            costs = world.costs_from(start)
            finite = costs[np.isfinite(costs)]
            near = world.near(finite.max())
            reached = planner.reach(start)
            assert reached == pytest.approx(costs, rel=1e-5, abs=near)
            within = max(float(np.median(finite)), 0.0) + near
            part = np.where(reached <= within, reached, np.inf)
            np.testing.assert_array_equal(planner.reach(start, within), part)
    assert found > MAPS


@pytest.mark.parametrize("name", WORLDS)
def test_on_a_map_that_changes_plans_and_the_standing_path_are_those_of_the_newest_map(
    name, worlds, network
):
    seen = Counter()
    for world in worlds(name, 1):
        rng = world.rng
        start, goal = world.cells(2)
        begin, end = world.headings()
        moving = world.planner(goal, rng.choice(DynamicMethod), model=network)
        moving.set_goal(goal, world.heading(end))
        for _ in range(TURNS):
            moving.move(start, world.heading(begin))
            optimum = world.optimum(start, goal, begin, end)
            for method in rng.choice([*DynamicMethod, *["astar"] * 4], 3):
                if rng.random() < 0.2:
                    moving.replan(method=method, time_limit_s=0.0)
                if rng.random() < 0.1:
                    with interrupting(int(rng.integers(1, 400))), suppress(KeyboardInterrupt):
                        moving.replan(method=method)
                plan = moving.replan(method=method)
                world.judge(plan, optimum, METHODS[method].bound - 1.0)
                seen[plan.status] += 1
            if plan.ok:
                at = int(rng.integers(len(plan.path)) * rng.random())
                start = tuple(plan.path[at].tolist())
                begin = None if plan.states is None else plan.states[at] % 16
            if rng.random() < 0.2:
                moving = pickle.loads(pickle.dumps(moving))
            for _ in range(rng.integers(4)):
                world.patch()(moving)
            world.read()
            places = [(start, world.optimum(start, goal, begin, end))]
            if plan.ok and world.symmetric:
                to_goal = world.costs_from(goal)
                places = [(tuple(cell), to_goal[tuple(cell)]) for cell in plan.path.tolist()]
            for cell, optimum in places:
                moving.move(cell, world.heading(begin))
                seen[judge_standing(moving, world, optimum)] += 1
            moving.move(start, world.heading(begin))
        fresh = world.planner()
        same_maps(moving, fresh)
        same_maps(pickle.loads(pickle.dumps(moving)), fresh)
    assert len(seen) >= 4, seen


def judge_standing(moving, world, optimum):
    """Assert that what a planner says of its standing path is so, and its footing."""
    standing = moving.standing()
    if math.isfinite(optimum):
        assert standing.lower_bound <= optimum + world.near(optimum)
    if standing.index >= 0:
        walked = moving.standing_plan.walked
        cost = world.path_cost(walked[standing.index :])
        if standing.valid:
            assert standing.cost == pytest.approx(cost, rel=1e-5, abs=1e-6)
        else:  # or the body cannot turn into it, as it came
            assert math.isinf(world.path_cost(walked[max(standing.index - 1, 0) :]))
    return standing.footing


def test_rough_ground_counts_in_every_method_and_after_every_patch(worlds, network, monkeypatch):
    def rough(model, dem, sides_m):
        return 1.0 + 9.0 * terrain_terms(dem, sides_m[0], cell_width_m=sides_m[1])[1]

    monkeypatch.setattr(ToblerCost, "ground", rough)
    test_every_method_finds_dijkstras_cost_and_no_bound_is_above_it("tobler", worlds, network)
    test_on_a_map_that_changes_plans_and_the_standing_path_are_those_of_the_newest_map(
        "tobler", worlds, network
    )


@pytest.mark.parametrize("name", DOORS)
def test_what_is_added_by_the_guide_is_held_to_dijkstras_costs_too(
    name, worlds, network, monkeypatch
):
    add, world = DOORS[name]
    add(monkeypatch)
    monkeypatch.setitem(ALL, name, world)
    test_every_method_finds_dijkstras_cost_and_no_bound_is_above_it(name, worlds, network)
    test_on_a_map_that_changes_plans_and_the_standing_path_are_those_of_the_newest_map(
        name, worlds, network
    )


@pytest.mark.parametrize("name", WORLDS)
def test_a_tour_leads_through_its_stops_in_the_best_order_of_all_tried(name, worlds):
    for world in worlds(name, 2):
        start, *via, goal = stops = world.cells(7)
        costs = [world.costs_from(stop)[tuple(np.transpose(stops))] for stop in stops]
        optima = oracles.cheapest_order(costs)
        planner = world.planner()
        by_cells = planner.state.grid.robot.moves.over == CELLS
        for method in ("astar", "corridor"):
            tours = [
                planner.plan_via(start, goal, via, best_order=order, method=method)
                for order in (True, False)
            ]
            if not all(tour.plan.ok for tour in tours):
                assert not (by_cells and world.passable[start] and np.isfinite(optima).all())
                continue
            for tour, optimum in zip(tours, optima, strict=True):
                path = tour.plan.path
                if by_cells:  # a body's legs begin as it came to the stop
                    order = (0, *(at + 1 for at in tour.order), 6)
                    own = sum(costs[a][b] for a, b in itertools.pairwise(order))
                    world.judge(tour.plan, own, 0.0 if method == "astar" else math.inf)
                    assert method != "astar" or own <= optimum + world.near(optimum)
                cost = world.path_cost(tour.plan.walked)
                assert tour.plan.cost == pytest.approx(cost, rel=1e-5, abs=1e-4)
                assert list(tour.stops) == [start, *(via[at] for at in tour.order), goal]
                at = [np.flatnonzero((path == stop).all(1)) for stop in tour.stops]
                assert all(a.min() <= b.max() for a, b in itertools.pairwise(at))
            best, given = tours
            assert sorted(best.order) == list(given.order) == list(range(5))
            assert best.plan.cost <= best.given_cost and math.isnan(given.given_cost)
            assert best.given_cost == pytest.approx(given.plan.cost, rel=1e-5, abs=1e-4)
