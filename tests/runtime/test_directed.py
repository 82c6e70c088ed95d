"""Steps that cost by the slope they lead up or down, against scipy's Dijkstra on the directed
graph.

The same properties hold on 3,000 maps and 2,000 patches: NNPP_EDGE_MAPS=3000
(docs/decisions/slope-costs.md).
"""

import dataclasses
import math
import os
import sys

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    EnergyCost,
    LinearCost,
    Mobility,
    Planner,
    ToblerCost,
    Traversability,
    Vehicle,
    pose_costs,
    traversability_cost,
)
from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel
from nnpp_edge.runtime.robots.slope import directed
from nnpp_edge.runtime.search.astar import astar, costs_to_nearest
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.traversability import terrain_terms
from tests import oracles, pose_oracles
from tests.directed_cases import MOBILITY, MODELS, dijkstra, hills, path_cost, tolerance
from tests.fuzz import bodies

MAPS = int(os.environ.get("NNPP_EDGE_MAPS", "100"))
TURNS = 6
STEEP = Traversability(slope_limit_deg=60.0)


def planner_of(case, name, kind=Planner, **given):
    fixed = {
        "cell_width_m": case.sides[1],
        "corner_cutting": case.corner_cutting,
        "mobility": MOBILITY,
    }
    fixed |= {"step_cost": name, "traversability": case.limits} | (
        {"warn": False} if kind is Planner else {}
    )
    return kind.of_elevation(case.dem, case.sides[0], **fixed, **given)


def model_of(seed):
    """Each model in turn, and on the large maps, which are every fifth, too."""
    return MODELS[(seed + seed // 5) % len(MODELS)]


def cases(count, most_side=24, least_side=1):
    for seed in range(count):
        yield (
            seed,
            model_of(seed),
            hills(np.random.default_rng(seed), most_side + 40 * (seed % 5 == 0), least_side),
        )


def ramp(rows=12, cols=40, slope=0.2):
    return np.tile((slope * np.arange(cols)).astype(np.float32), (rows, 1))


def test_every_exact_method_finds_dijkstras_cost_and_no_bound_is_above_it():
    found = 0
    for seed, name, case in cases(MAPS):
        model = MOBILITY.model(name)
        planner = planner_of(case, name, ask_from=0)
        near = tolerance(case, model)
        for start, goal in ((case.start, case.goal), (case.goal, case.start)):
            truth = dijkstra(case, model, start)[goal]
            methods = [
                ("astar", math.inf),
                ("corridor", 0.0),
                ("corridor", math.inf),
                ("auto", math.inf),
            ]
            for method, epsilon in methods + [("nnpp", math.inf)] * (seed % 10 == 0):
                plan = planner.plan(start, goal, method=method, epsilon=epsilon)
                assert plan.ok == math.isfinite(truth), (seed, method)
                if not plan.ok:
                    continue
                found += 1
                assert plan.cost == pytest.approx(
                    path_cost(plan.path, case, model), rel=1e-6, abs=1e-9
                ), seed
                assert plan.lower_bound <= truth + near and plan.cost >= truth - near, (
                    seed,
                    method,
                )
                if method == "astar" or epsilon == 0.0:
                    assert plan.cost == pytest.approx(truth, rel=1e-5, abs=near), (
                        seed,
                        name,
                        method,
                    )
                if name in ("time", "energy"):
                    number = plan.time_s if name == "time" else plan.energy_j
                    assert number == pytest.approx(plan.cost, rel=1e-4, abs=1e-3)
    assert found > MAPS


def patched(rng, dem):
    """Where a patch goes, and what it holds: ground that is unknown, rough, flat, or lifted."""
    (rows, cols), (high, wide) = dem.shape, rng.integers(1, 7, 2)
    row = int(rng.integers(rows))
    col = int(rng.integers(cols))
    kind = int(rng.integers(4))
    here = dem[row : row + high, col : col + wide]
    mean = float(np.nan_to_num(np.nanmean(dem))) if np.isfinite(dem).any() else 0.0
    rough = np.nan_to_num(here, nan=mean) + rng.normal(0.0, 0.3, here.shape)
    kinds = (
        np.full(here.shape, np.nan),
        rough,
        np.full(here.shape, mean),
        here + rng.normal(0.0, 0.5),
    )
    return row, col, kinds[kind].astype(np.float32)


def with_patch(case, row, col, patch):
    """The case with that ground, and what is passable on it now."""
    dem = case.dem.copy()
    dem[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
    cost = traversability_cost(
        dem, case.sides[0], case.limits, cell_width_m=case.sides[1], warn=False
    )
    return dataclasses.replace(case, dem=dem, passable=cost < 1.0)


def test_d_star_lite_equals_dijkstra_after_every_patch_and_the_standing_path_knows_what_it_costs():
    stood = found = 0
    for seed, name, case in cases(max(MAPS // 4, 8), 24, 4):
        rng = np.random.default_rng([seed, 1])
        model = MOBILITY.model(name)
        start = case.start
        methods = ("dstar", "corridor-dstar", "auto") if seed % 3 == 0 else ("dstar",)
        planner = planner_of(case, name, DynamicPlanner, goal=case.goal, method="dstar")
        for turn in range(TURNS):
            planner.move(start)
            truth = dijkstra(case, model, start)[case.goal]
            near = tolerance(case, model)
            plans = [planner.replan(method=method) for method in methods]
            blocked = not (case.passable[start] and case.passable[case.goal])
            for plan in plans:
                assert plan.ok == (not blocked and math.isfinite(truth)), (seed, turn, plan.planner)
                if plan.ok:
                    assert plan.cost == pytest.approx(
                        path_cost(plan.path, case, model), rel=1e-6, abs=1e-9
                    )
                    assert plan.lower_bound <= truth + near
            if plans[0].ok:
                found += 1
                assert plans[0].cost == pytest.approx(truth, rel=1e-5, abs=near), (seed, turn, name)
                start = tuple(
                    plans[-1].path[min(len(plans[-1].path) - 1, int(rng.integers(3)))].tolist()
                )
            for _ in range(1 + turn % 3):
                patch = patched(rng, case.dem)
                planner.update_elevation(*patch)
                case = with_patch(case, *patch)
            if plans[-1].ok and case.passable[start] and case.passable[case.goal]:
                planner.move(start)
                standing = planner.standing()
                rest = planner.standing_plan.path
                truth = dijkstra(case, model, start)[case.goal]
                assert standing.lower_bound <= truth + tolerance(case, model) + 1e-6 * abs(truth), (
                    seed,
                    turn,
                )
                if standing.valid:
                    stood += 1
                    left = path_cost(rest[standing.index :], case, model)
                    assert standing.cost == pytest.approx(left, rel=1e-6, abs=1e-9)
                else:
                    with pytest.raises(AssertionError):
                        path_cost(rest[standing.index :], case, model)
    assert found > MAPS // 4 and stood > MAPS // 8


def test_rough_ground_counts_in_every_exact_method_and_after_every_patch(monkeypatch):
    def rough(model, dem, sides_m):
        terms = terrain_terms(dem, sides_m[0], cell_width_m=sides_m[1])
        return 1.0 + 9.0 * terms[1]

    monkeypatch.setattr(ToblerCost, "ground", rough)
    monkeypatch.setattr(sys.modules[__name__], "MODELS", ("tobler",))
    monkeypatch.setattr(sys.modules[__name__], "MAPS", 20)
    test_every_exact_method_finds_dijkstras_cost_and_no_bound_is_above_it()
    test_d_star_lite_equals_dijkstra_after_every_patch_and_the_standing_path_knows_what_it_costs()


def test_steps_priced_on_several_cores_are_those_of_one(monkeypatch):
    dem = np.random.default_rng(3).normal(0.0, 0.1, (70, 90)).astype(np.float32)
    one = Planner.of_elevation(dem, 1.0, step_cost="tobler")
    monkeypatch.setattr(directed, "_THREADS_FROM", 1)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: range(3))
    several = Planner.of_elevation(dem, 1.0, step_cost="tobler")
    np.testing.assert_array_equal(several.reach((5, 5)), one.reach((5, 5)))


# --- coarse levels


def test_coarse_levels_are_searched_from_the_goal_by_the_steps_that_lead_to_it():
    for seed, name, case in cases(30, 40, 16):
        for level in planner_of(case, name).state.pyramid.levels[1:]:
            grid = level.grid
            links = level.links
            ends = [(row // 4, col // 4) for row, col in (case.start, case.goal)]
            if not all(map(grid.is_passable, ends)):
                continue
            there = astar(grid, *ends, Workspace(len(grid.weights)), links=links)
            back = CoarseLevel(level).search(ends[1], ends[0], None, beyond=0.0)
            assert there.status is back.status, seed
            assert walked(grid, there.path) == pytest.approx(
                walked(grid, back.path[::-1]), rel=1e-5
            ), (seed, name)


def walked(grid, path):
    """What the steps of a path cost on a coarse level."""
    directions = {
        (up, left): k for k, (up, left) in enumerate(zip(ROW_STEP, COL_STEP, strict=True))
    }
    steps = zip(path.tolist(), np.diff(path, axis=0).tolist(), strict=False)
    return sum(
        float(grid.robot.price.edges()[grid.node(*cell), directions[tuple(step)]])
        for cell, step in steps
    )


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


def test_the_nearest_of_several_goals_is_the_cheapest_to_get_to():
    energy = {
        "step_cost": "energy",
        "mobility": Mobility(energy=EnergyCost(10.0, 0.05)),
        "warn": False,
    }
    planner = Planner.of_elevation(ramp(20, 60, 0.2), 1.0, STEEP, **energy)
    ranked = planner.nearest((10, 30), [(10, 40), (10, 5)], count=2)
    assert [at for at, _ in ranked] == [1, 0]  # downhill, though farther
    assert ranked[0][1].cost < ranked[1][1].cost
    energy["mobility"] = Mobility(energy=EnergyCost(10.0, 0.1))
    planner = Planner.of_elevation(ramp(60, 60, 0.1), 1.0, **energy)
    assert planner.nearest((30, 30), [(40, 30), (30, 15)])[0][0] == 1


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
    planner.update_elevation(
        15, 30, np.full((1, 1), 0.05 * 30)
    )  # the way is free again, and something changes far off
    planner.update_elevation(0, 58, np.full((1, 1), 3.0))
    assert planner.standing().lower_bound <= planner.replan().cost < around.cost


# --- with a vehicle


def test_a_disc_keeps_its_distance_and_pays_by_the_slope():
    dem = ramp(40, 60, 0.1)
    dem[:18, 30] = np.nan
    planner = Planner.of_elevation(
        dem, 1.0, vehicle=Vehicle(radius_m=2.0), step_cost="tobler", warn=False
    )
    plan = planner.plan((8, 10), (8, 50), method="astar")
    assert plan.ok and np.abs(plan.path - (17, 30)).max(1).min() >= 2 and plan.cost > 40.0
    planner.update_elevation(0, 29, ramp(40, 60, 0.1)[:18, 29:32])
    straight = float(ToblerCost().cost(40.0, 4.0))
    assert planner.plan((8, 10), (8, 50), method="astar").cost == pytest.approx(straight, rel=1e-5)


@pytest.mark.parametrize("seed", range(len(MODELS)))
def test_a_bodys_poses_decide_where_it_may_go_and_the_slope_what_it_costs(seed):
    rng = np.random.default_rng(seed)
    side = 36
    name = model_of(seed)
    body = Vehicle(2.2, 2.2, 0.6, max_tilt_deg=25.0)
    model = MOBILITY.model(name)
    dem = (rng.normal(0.0, 0.03, (side, side)).cumsum(0) + 0.1 * np.arange(side)).astype(np.float32)
    dem[rng.integers(4, side - 4, 5), rng.integers(4, side - 4, 5)] += 2.0
    ends = [
        tuple(cell)
        for cell in np.argwhere(np.isfinite(pose_costs(dem, 1.0, body)).all(0))[[0, -1]].tolist()
    ]
    given = {"vehicle": body, "step_cost": name, "mobility": MOBILITY}

    def optimum():
        priced = bodies.priced(Planner.of_elevation(dem, 1.0, vehicle=body, warn=False), 0.0)
        heights = dem.astype(float)
        for k, step in enumerate(pose_oracles.DIRECTIONS):
            here, there = pose_oracles.between(dem.shape, step)
            rises = heights[there] - heights[here]
            legs = priced.legs[(*here, k)]
            legs[:] = np.where(
                legs < np.inf,
                model.cost(math.hypot(*step), rises) - model.height_price * rises,
                np.inf,
            )
        priced.turns[:] *= float(model.cost(1.0, 0.0))
        found = pose_oracles.costs_to_cells(priced, ends[0])[ends[1]]
        return found + model.height_price * (heights[ends[1]] - heights[ends[0]])

    near = 1e-5 * (2 * side * model.least_per_m + model.height_price * float(np.ptp(dem)))
    planner = Planner.of_elevation(dem, 1.0, warn=False, **given)
    truth = optimum()
    for method in ("astar", "corridor", "nnpp"):
        plan = planner.plan(*ends, method=method)
        assert plan.ok == math.isfinite(truth)
        if plan.ok:
            assert plan.lower_bound - near <= truth <= plan.cost + near
            assert method != "astar" or plan.cost == pytest.approx(truth, rel=1e-5, abs=near)
    moving = DynamicPlanner.of_elevation(dem, 1.0, ends[1], None, "dstar", **given)
    for lift in (0.0, 0.3, 0.0, -0.3):
        moving.move(ends[0])
        found = moving.replan()
        assert not found.ok or found.cost == pytest.approx(optimum(), rel=1e-5, abs=near)
        dem = dem.copy()
        dem[15:20, 15:20] += np.float32(lift)
        moving.update_elevation(15, 15, dem[15:20, 15:20])


# --- what can be reached, and tours


@pytest.mark.parametrize("name", MODELS)
def test_reach_tours_and_costs_between_stops_are_dijkstras(name):
    rng = np.random.default_rng(7)
    model = MOBILITY.model(name)
    for seed in range(14):
        case = hills(rng, least_side=6)
        planner = planner_of(case, name)
        near = tolerance(case, model)
        wanted = dijkstra(case, model, case.start)
        found = planner.reach(case.start)
        assert np.array_equal(np.isfinite(found), np.isfinite(wanted))
        assert found == pytest.approx(wanted, rel=1e-5, abs=near)
        within = float(max(np.median(wanted[np.isfinite(wanted)]), 0.0)) + near
        assert np.array_equal(np.isfinite(planner.reach(case.start, within)), found <= within)
        cells = np.argwhere(np.isfinite(wanted))
        stops = [tuple(cell) for cell in cells[rng.permutation(len(cells))[:6]].tolist()]
        workspace = Workspace(len(planner.state.grid.weights))
        costs, known = costs_to_nearest(planner.state.grid, stops, 2, workspace)
        between = [dijkstra(case, model, stop)[tuple(np.transpose(stops))] for stop in stops]
        for ours, exact, theirs in zip(costs[:-1], known[:-1], between, strict=False):
            assert ours[exact] == pytest.approx(theirs[exact], rel=1e-5, abs=near)
            assert (ours <= theirs * (1.0 + 1e-5) + near).all()
            assert exact.sum() >= min(3, len(stops))
        if len(stops) < 6 or seed % 2:
            continue
        best, _ = oracles.cheapest_order(between)
        for method in ("astar", "corridor"):
            tour = planner.plan_via(
                stops[0], stops[-1], stops[1:-1], best_order=True, method=method
            )
            assert tour.plan.cost == pytest.approx(path_cost(tour.plan.path, case, model), abs=near)
            assert tour.plan.cost <= tour.given_cost + near
            assert method != "astar" or tour.plan.cost == pytest.approx(
                best, rel=1e-5, abs=5 * near
            )
