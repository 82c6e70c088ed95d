"""Steps that cost by the slope they lead up or down: coarse levels, and by hand on ramps. Beside
Dijkstra's algorithm they are in `test_robots`.
"""

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Ground,
    LinearCost,
    Mobility,
    Planner,
    Traversability,
    Vehicle,
)
from nnpp_edge.runtime.robots.slope import directed
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import CorridorWidth
from tests.directed_cases import MODELS
from tests.strategies import costs_on, descent_of
from tests.worlds import ROVER, WORLDS

BAND = CorridorWidth(0, 0.1, 0.0)
STEEP = Traversability(slope_limit_deg=60.0)


def ramp(rows=12, cols=40, slope=0.2):
    return np.tile((slope * np.arange(cols)).astype(np.float32), (rows, 1))


def test_steps_priced_on_several_cores_are_those_of_one(monkeypatch):
    dem = np.random.default_rng(3).normal(0.0, 0.1, (70, 90)).astype(np.float32)
    one = Planner.of_elevation(dem, 1.0, step_cost="tobler")
    monkeypatch.setattr(directed, "_THREADS_FROM", 1)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: range(3))
    several = Planner.of_elevation(dem, 1.0, step_cost="tobler")
    np.testing.assert_array_equal(several.reach((5, 5)), one.reach((5, 5)))


# --- coarse levels


@pytest.mark.parametrize("name", MODELS)
def test_coarse_levels_are_searched_from_the_goal_by_the_steps_that_lead_to_it(name):
    for seed in range(6):
        world = WORLDS[name](np.random.default_rng(seed))
        descent, levels = descent_of(world.planner().state)
        start, goal = world.cells(2)
        for number, level in enumerate(levels[1:], 1):
            ends = [(row // 4**number, col // 4**number) for row, col in (start, goal)]
            wanted = costs_on(level, ends[0])[ends[1]]
            region = descent.corridor(Query(start, goal), Work(), number, None, BAND)
            assert (region is not None) == (wanted < np.inf), seed
            if number == 1 and region is not None:
                back = level.grid.inner(descent.workspace(1).costs())
                assert back[ends[0]] == pytest.approx(wanted, rel=1e-5), seed
                through = costs_on(level, ends[0]) + back
                inside = region.blocks()[::2, ::2]
                limit = (1.0 + BAND.band) * wanted
                assert inside[through < limit * (1.0 - 1e-4)].all()
                assert (through[inside] <= limit * (1.0 + 1e-4)).all()


@pytest.mark.parametrize("vehicle", [None, Vehicle(2.2, 2.2, 0.6)])
def test_a_coarse_steps_cost_is_the_mean_of_the_steps_below(vehicle):
    options = {"step_cost": "linear", "mobility": Mobility(linear=LinearCost()), "warn": False}
    planner = Planner.of_elevation(ramp(16, 20, 0.1), 1.0, vehicle=vehicle, **options)
    coarse = planner.state.pyramid.levels[1].grid
    assert coarse.prices == planner.state.grid.prices
    uphill, downhill = coarse.robot.price.edges()[coarse.node(1, 2), [3, 2]].tolist()
    assert uphill == pytest.approx(0.72 + (6.0 - 1.9998) * 0.1, rel=1e-3)
    assert downhill == pytest.approx(0.72, rel=1e-3)
    assert coarse.robot.price.edges(True)[coarse.node(1, 2), 2] == pytest.approx(
        uphill
    )  # from the left


# --- by hand, on ramps


def test_bounds_reckon_with_the_height_between_the_ends():
    dem = ramp(70, 60, 0.2)
    methods = {"method": "dstar", "step_cost": "tobler"}
    planner = DynamicPlanner.of_elevation(dem, 1.0, (32, 50), STEEP, **methods)
    planner.move((32, 5))
    mended = planner.replan(method="corridor-dstar")
    exact = planner.replan(method="dstar")
    assert (
        0.8 * exact.cost < mended.lower_bound <= mended.cost
    )  # all but the price of height is less than 0.6 of it
    planner.update_elevation(
        0, 20, dem[:3, 20:24] + np.float32(0.3)
    )  # no path by way of there is as cheap
    assert planner.standing().lower_bound == pytest.approx(exact.cost, rel=1e-5)
    planner = DynamicPlanner.of_elevation(
        ramp(30, 60, 0.05), 1.0, (15, 5), None, "dstar", step_cost="tobler"
    )
    planner.move((15, 50))
    planner.replan()
    planner.update_elevation(15, 30, np.full((1, 1), np.nan))  # downhill
    standing = planner.standing()
    around = planner.replan()
    assert standing.footing == "blocked" and around.ok
    assert around.cost * 0.9 < standing.lower_bound <= around.cost
    # something changes far off, and the way is free again
    planner.replan()
    planner.update_elevation(0, 58, np.full((1, 1), 3.0))
    planner.update_elevation(15, 30, np.full((1, 1), 0.05 * 30))
    assert planner.standing().lower_bound <= planner.replan().cost < around.cost


# --- with a vehicle


# --- what can be reached, and tours


@pytest.mark.parametrize("step_cost", ["paper", "tobler"])
def test_a_body_stands_no_more_on_a_goal_that_became_impassable(step_cost):
    ground = Ground.of_elevation(ramp(20, slope=0.0), 0.25, vehicle=ROVER, step_cost=step_cost)
    planner = DynamicPlanner(ground, (10, 24))
    planner.move((10, 10))
    planner.replan()
    planner.move((10, 24))
    assert planner.standing().valid
    planner.update(10, 24, np.ones((1, 1)))
    assert not planner.standing().valid
