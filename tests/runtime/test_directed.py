"""Steps that cost by the slope they lead up or down: exact methods against scipy's Dijkstra on the directed graph.

The same properties hold on 3,000 maps and 2,000 patches and more: NNPP_EDGE_MAPS=3000 (docs/decisions.md).
"""

import copy
import dataclasses
import math
import os
import pickle

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    EnergyCost,
    LinearCost,
    Mobility,
    Planner,
    Status,
    Traversability,
    Vehicle,
    pose_costs,
    traversability_cost,
)
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP
from nnpp_edge.runtime.map.slope_cost import ToblerCost
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel
from nnpp_edge.runtime.search.astar import astar, cost_field
from nnpp_edge.runtime.search.workspace import Workspace
from tests.directed_cases import (
    MIRRORED,
    MOBILITY,
    MODELS,
    SYMMETRIC,
    dijkstra,
    hills,
    over_slopes,
    path_cost,
    tolerance,
)

MAPS = int(os.environ.get("NNPP_EDGE_MAPS", "120"))
TURNS = 6


def planner_of(case, name, dem=None, mobility=MOBILITY, **given):
    return Planner.of_elevation(
        case.dem if dem is None else dem,
        case.sides[0],
        case.limits,
        cell_width_m=case.sides[1],
        corner_cutting=case.corner_cutting,
        step_cost=name,
        mobility=mobility,
        warn=False,
        ask_from=0,
        **given,
    )


def model_of(seed):
    """Each model in turn, and on the large maps, which are every fifth, too."""
    return MODELS[(seed + seed // 5) % len(MODELS)]


def cases(count, most_side=24, least_side=1):
    for seed in range(count):
        yield seed, model_of(seed), hills(np.random.default_rng(seed), most_side + 40 * (seed % 5 == 0), least_side)


def test_every_exact_method_finds_dijkstras_cost_and_no_bound_is_above_it():
    found = 0
    for seed, name, case in cases(MAPS):
        model, planner = MOBILITY.model(name), planner_of(case, name)
        near = tolerance(case, model)
        for start, goal in ((case.start, case.goal), (case.goal, case.start)):
            truth = dijkstra(case, model, start)[goal]
            for method, epsilon in (
                ("astar", math.inf),
                ("corridor", 0.0),
                ("corridor", math.inf),
                ("auto", math.inf),
            ):
                plan = planner.plan(start, goal, method=method, epsilon=epsilon)
                assert plan.ok == math.isfinite(truth), (seed, method)
                if not plan.ok:
                    continue
                found += 1
                assert plan.cost == pytest.approx(path_cost(plan.path, case, model), rel=1e-6, abs=1e-9), seed
                assert plan.lower_bound <= truth + near and plan.cost >= truth - near, (seed, method)
                if method == "astar" or epsilon == 0.0:
                    assert plan.cost == pytest.approx(truth, rel=1e-5, abs=near), (seed, name, method)
    assert found > MAPS


def test_the_networks_region_holds_a_path_wherever_there_is_one():
    for seed, name, case in cases(MAPS // 10, 40, 20):
        truth = dijkstra(case, MOBILITY.model(name), case.start)[case.goal]
        plan = planner_of(case, name).plan(case.start, case.goal, method="nnpp")
        assert plan.ok == math.isfinite(truth), seed
        if plan.ok:
            near = tolerance(case, MOBILITY.model(name))
            assert plan.lower_bound - near <= truth <= plan.cost + near, seed


def patched(rng, dem):
    """Where a patch goes, and what it holds: ground that is unknown, rough, flat, or lifted."""
    (rows, cols), (high, wide) = dem.shape, rng.integers(1, 7, 2)
    row, col, kind = int(rng.integers(rows)), int(rng.integers(cols)), int(rng.integers(4))
    here = dem[row : row + high, col : col + wide]
    mean = float(np.nan_to_num(np.nanmean(dem))) if np.isfinite(dem).any() else 0.0
    rough = np.nan_to_num(here, nan=mean) + rng.normal(0.0, 0.3, here.shape)
    kinds = np.full(here.shape, np.nan), rough, np.full(here.shape, mean), here + rng.normal(0.0, 0.5)
    return row, col, kinds[kind].astype(np.float32)


def test_d_star_lite_equals_dijkstra_after_every_patch_and_the_standing_path_knows_what_it_costs():
    stood = found = 0
    for seed, name, case in cases(max(MAPS // 4, 8), 24, 4):
        rng, model = np.random.default_rng([seed, 1]), MOBILITY.model(name)
        methods = ("dstar", "corridor-dstar", "auto") if seed % 3 == 0 else ("dstar",)
        planner = DynamicPlanner.of_elevation(
            case.dem,
            case.sides[0],
            case.goal,
            case.limits,
            "dstar",
            also=methods,
            cell_width_m=case.sides[1],
            corner_cutting=case.corner_cutting,
            step_cost=name,
            mobility=MOBILITY,
        )
        start = case.start
        for turn in range(TURNS):
            planner.move(start)
            truth, near = dijkstra(case, model, start)[case.goal], tolerance(case, model)
            plans = [planner.replan(method=method) for method in methods]
            blocked = not (case.passable[start] and case.passable[case.goal])
            for plan in plans:
                assert plan.ok == (not blocked and math.isfinite(truth)), (seed, turn, plan.planner)
                if plan.ok:
                    assert plan.cost == pytest.approx(path_cost(plan.path, case, model), rel=1e-6, abs=1e-9)
                    assert plan.lower_bound <= truth + near
            if plans[0].ok:
                found += 1
                assert plans[0].cost == pytest.approx(truth, rel=1e-5, abs=near), (seed, turn, name)
                start = tuple(plans[-1].path[min(len(plans[-1].path) - 1, int(rng.integers(3)))].tolist())
            row, col, patch = patched(rng, case.dem)
            planner.update_elevation(row, col, patch)
            dem = case.dem.copy()
            dem[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
            cost = traversability_cost(dem, case.sides[0], case.limits, cell_width_m=case.sides[1], warn=False)
            case = dataclasses.replace(case, dem=dem, passable=cost < 1.0)
            if plans[-1].ok and case.passable[start] and case.passable[case.goal]:
                planner.move(start)
                standing, rest = planner.standing(), planner.standing_plan.path
                truth = dijkstra(case, model, start)[case.goal]
                assert standing.lower_bound <= truth + tolerance(case, model) + 1e-6 * abs(truth), (seed, turn)
                if standing.valid:
                    stood += 1
                    left = path_cost(rest[standing.index :], case, model)
                    assert standing.cost == pytest.approx(left, rel=1e-6, abs=1e-9)
                else:
                    with pytest.raises(AssertionError):
                        path_cost(rest[standing.index :], case, model)
    assert found > MAPS // 4 and stood > MAPS // 8


def test_a_field_of_costs_equals_dijkstras():
    for seed, name, case in cases(MAPS // 3):
        model, grid = MOBILITY.model(name), planner_of(case, name).state.grid
        field = cost_field(grid, case.start, Workspace(len(grid.weights)))
        truth = dijkstra(case, model, case.start)
        assert (np.isfinite(field) == np.isfinite(truth)).all(), seed
        known = np.isfinite(truth)
        np.testing.assert_allclose(field[known], truth[known], rtol=1e-5, atol=tolerance(case, model))


def test_coarse_levels_are_searched_from_the_goal_by_the_steps_that_lead_to_it():
    for seed, name, case in cases(40, 40, 16):
        for level in planner_of(case, name).state.pyramid.levels[1:]:
            grid, links = level.grid, level.links
            ends = [(row // 4, col // 4) for row, col in (case.start, case.goal)]
            if not all(map(grid.is_passable, ends)):
                continue
            there = astar(grid, *ends, Workspace(len(grid.weights)), links=links)
            back = CoarseLevel(level).search(ends[1], ends[0], None, beyond=0.0)
            assert there.status is back.status, seed
            forwards = (walked(grid, path) for path in (there.path, back.path[::-1]))
            assert next(forwards) == pytest.approx(next(forwards), rel=1e-5), (seed, name)


def walked(grid, path):
    """What the steps of a path cost on a coarse level."""
    nodes = [grid.node(*cell) for cell in path.tolist()]
    kinds = [tuple(step) for step in np.diff(path, axis=0).tolist()]
    directions = {(up, left): k for k, (up, left) in enumerate(zip(ROW_STEP, COL_STEP, strict=True))}
    return sum(float(grid.directed.edges[n, directions[step]]) for n, step in zip(nodes[:-1], kinds, strict=True))


def test_a_coarse_steps_cost_is_the_mean_of_the_steps_below():
    planner = Planner.of_elevation(ramp(8, 12, 0.1), 1.0, step_cost="linear", mobility=Mobility(linear=LinearCost()))
    coarse = planner.state.pyramid.levels[1].grid
    assert coarse.prices == planner.state.grid.prices
    uphill, downhill = coarse.directed.edges[coarse.node(0, 1), [3, 2]].tolist()
    assert uphill == pytest.approx(0.72 + (6.0 - 1.9998) * 0.1, rel=1e-3)
    assert downhill == pytest.approx(0.72, rel=1e-3)
    assert coarse.directed.backwards[coarse.node(0, 1), 2] == pytest.approx(uphill)  # from the left


@pytest.mark.parametrize("name", ["tobler", "time", "linear"])
def test_mirrored_coefficients_cost_the_reversed_path_the_same(name):
    plain = dataclasses.replace(MOBILITY, linear=LinearCost(1.0, 4.0, 0.5, 0.5))
    swapped = dataclasses.replace(plain, linear=LinearCost(1.0, 0.5, 4.0, 4.0), **MIRRORED)
    differ = 0
    for seed in range(MAPS // 3):
        case = hills(np.random.default_rng(seed), 40, 12)
        there = planner_of(case, name, mobility=plain).plan(case.start, case.goal, method="astar")
        back = planner_of(case, name, mobility=swapped).plan(case.goal, case.start, method="astar")
        near = tolerance(case, plain.model(name))
        assert there.ok == back.ok and (not back.ok or there.cost == pytest.approx(back.cost, rel=1e-5, abs=near))
        if back.ok:
            assert path_cost(back.path[::-1], case, plain.model(name)) == pytest.approx(back.cost, rel=1e-6, abs=1e-9)
            again = planner_of(case, name, mobility=plain).plan(case.goal, case.start, method="astar")
            differ += again.cost != pytest.approx(there.cost, rel=1e-3)
    assert differ > MAPS // 8  # up costs another amount than down


def test_energy_on_ground_turned_upside_down_costs_the_way_back():
    for seed in range(MAPS // 4):
        case = hills(np.random.default_rng(seed), 30, 8)
        there = planner_of(case, "energy").plan(case.start, case.goal, method="astar")
        back = planner_of(case, "energy", dem=-case.dem).plan(case.goal, case.start, method="astar")
        near = tolerance(case, MOBILITY.model("energy"))
        assert there.ok == back.ok and (not back.ok or there.cost == pytest.approx(back.cost, rel=1e-5, abs=near))


def ramp(rows=12, cols=40, slope=0.2):
    return np.tile((slope * np.arange(cols)).astype(np.float32), (rows, 1))


@pytest.mark.parametrize("name", MODELS)
def test_up_a_ramp_costs_what_the_model_says_and_down_it_another_amount(name):
    model, limits = MOBILITY.model(name), Traversability(slope_limit_deg=60.0)
    planner = Planner.of_elevation(ramp(rows=1), 1.0, limits, step_cost=name, mobility=MOBILITY)  # no room for bends
    up, down = planner.plan((0, 2), (0, 32)), planner.plan((0, 32), (0, 2))
    assert up.cost == pytest.approx(float(model.cost(30.0, 6.0)), rel=1e-5)
    assert down.cost == pytest.approx(float(model.cost(30.0, -6.0)), rel=1e-5)
    assert up.cost > 1.05 * down.cost


def test_downhill_energy_got_back_makes_a_path_cost_less_than_nothing():
    mobility = Mobility(energy=EnergyCost(10.0, 0.05, recovery=0.8))
    for method in ("astar", "corridor"):
        planner = Planner.of_elevation(
            ramp(slope=0.3), 1.0, Traversability(slope_limit_deg=60.0), step_cost="energy", mobility=mobility
        )
        plan = planner.plan((5, 32), (5, 2), method=method)
        assert plan.cost == pytest.approx(0.8 * 10.0 * 9.80665 * 30.0 * (0.05 - 0.3), rel=1e-5)
        assert plan.ok and plan.lower_bound <= plan.cost + 1e-3 and plan.source != "fallback"


def test_steep_ground_is_gone_around_by_who_climbs_slowly_and_not_by_who_does_not():
    row, col = np.mgrid[0:41, 0:41]
    dem = (4.0 * np.exp(-((row - 20.0) ** 2 + (col - 20.0) ** 2) / 60.0)).astype(np.float32)
    over = {}
    for up in (0.0, 50.0):
        mobility = Mobility(linear=LinearCost(1.0, up, 0.0, 0.0))
        planner = Planner.of_elevation(dem, 1.0, step_cost="linear", mobility=mobility, warn=False)
        path = planner.plan((20, 2), (20, 38), method="astar").path
        over[up] = float(dem[path[:, 0], path[:, 1]].max())
    assert over[0.0] > 3.5 > 1.0 > over[50.0]


def test_costs_alike_up_and_down_make_the_way_back_the_same():
    for seed in range(MAPS // 4):
        case = hills(np.random.default_rng(seed), 30, 8)
        planner = planner_of(case, "linear", mobility=Mobility(linear=SYMMETRIC))
        there, back = (
            planner.plan(*ends, method="astar") for ends in ((case.start, case.goal), (case.goal, case.start))
        )
        assert there.ok == back.ok and (not back.ok or there.cost == pytest.approx(back.cost, rel=1e-5))


def test_the_paper_cost_is_what_it_was_and_knows_no_directed_steps():
    case = hills(np.random.default_rng(5), 60, 50)
    plain, named = planner_of(case, "paper", mobility=None), planner_of(case, "paper")
    assert plain.state.grid.directed is None
    for method in ("astar", "corridor"):
        one, other = (each.plan(case.start, case.goal, method=method) for each in (plain, named))
        assert (one.path == other.path).all() and one.cost == other.cost and one.expansions == other.expansions


def test_a_copy_and_a_planner_begun_anew_plan_the_same():
    case = hills(np.random.default_rng(5), 60, 50)
    for vehicle in (None, Vehicle(radius_m=0.4)):
        planner = planner_of(case, "tobler", vehicle=vehicle)
        planner.update_elevation(3, 4, case.dem[3:9, 4:8] + np.float32(0.2))
        wanted = planner.plan(case.start, case.goal, method="astar")
        for other in (copy.deepcopy(planner), pickle.loads(pickle.dumps(planner))):
            found = other.plan(case.start, case.goal, method="astar")
            assert (found.status, found.cost) == (wanted.status, wanted.cost)
            planner.update_elevation(3, 4, case.dem[3:9, 4:8])
            other.update_elevation(3, 4, case.dem[3:9, 4:8])
            assert other.plan(case.start, case.goal).cost == planner.plan(case.start, case.goal).cost


def test_a_disc_keeps_its_distance_and_pays_by_the_slope():
    dem = ramp(40, 60, 0.1)
    dem[:18, 30] = np.nan
    planner = Planner.of_elevation(dem, 1.0, vehicle=Vehicle(radius_m=2.0), step_cost="tobler", warn=False)
    plan = planner.plan((8, 10), (8, 50), method="astar")
    near = np.abs(plan.path - np.array((17, 30))).max(1).min()
    assert plan.ok and near >= 2
    assert plan.cost == pytest.approx(float(ToblerCost().cost(1.0, 0.1)) * 40.0, rel=0.4) and plan.cost > 40.0
    planner.update_elevation(0, 29, ramp(40, 60, 0.1)[:18, 29:32])
    assert planner.plan((8, 10), (8, 50), method="astar").cost == pytest.approx(
        float(ToblerCost().cost(40.0, 4.0)), rel=1e-5
    )


@pytest.mark.parametrize("seed", range(max(6, len(MODELS))))
def test_a_bodys_poses_decide_where_it_may_go_and_the_slope_what_it_costs(seed):
    rng, side, name = np.random.default_rng(seed), 36, model_of(seed)
    body, model = Vehicle(2.2, 2.2, 0.6, max_tilt_deg=25.0), MOBILITY.model(name)
    dem = (rng.normal(0.0, 0.03, (side, side)).cumsum(0) + 0.1 * np.arange(side)).astype(np.float32)
    dem[rng.integers(4, side - 4, 5), rng.integers(4, side - 4, 5)] += 2.0
    stands = np.isfinite(pose_costs(dem, 1.0, body))
    ends = [tuple(cell) for cell in np.argwhere(stands.all(0))[[0, -1]].tolist()]
    truth = over_slopes(dem, stands, (1.0, 1.0), model, ends[0])[ends[1]]
    planner = Planner.of_elevation(dem, 1.0, vehicle=body, step_cost=name, mobility=MOBILITY, warn=False)
    near = 1e-5 * (2 * side * model.least_per_m + model.height_price * float(np.ptp(dem)))
    for method in ("astar", "corridor", "nnpp"):
        plan = planner.plan(*ends, method=method)
        assert plan.ok == math.isfinite(truth)
        if plan.ok:
            assert plan.lower_bound - near <= truth <= plan.cost + near
            assert method != "astar" or plan.cost == pytest.approx(truth, rel=1e-5, abs=near)
    moving = DynamicPlanner.of_elevation(
        dem, 1.0, ends[1], None, "dstar", vehicle=body, step_cost=name, mobility=MOBILITY
    )
    for lift in (0.0, 0.3, 0.0):
        moving.move(ends[0])
        found = moving.replan()
        truth = over_slopes(dem, np.isfinite(pose_costs(dem, 1.0, body)), (1.0, 1.0), model, ends[0])[ends[1]]
        assert not found.ok or found.cost == pytest.approx(truth, rel=1e-5, abs=near)
        dem = dem.copy()
        dem[15:20, 15:20] += np.float32(lift)
        moving.update_elevation(15, 15, dem[15:20, 15:20])


def test_the_nearest_of_several_goals_is_the_cheapest_to_get_to():
    dem, mobility = ramp(20, 60, 0.2), Mobility(energy=EnergyCost(10.0, 0.05))
    planner = Planner.of_elevation(
        dem, 1.0, Traversability(slope_limit_deg=60.0), step_cost="energy", mobility=mobility
    )
    ranked = planner.nearest((10, 30), [(10, 40), (10, 5)], count=2)
    assert [at for at, _ in ranked] == [1, 0]  # downhill, though farther
    assert ranked[0][1].cost < ranked[1][1].cost


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda dem: Planner.of_elevation(dem, 1.0, step_cost="time"), ["mobility.time", "speed_m_s"]),
        (lambda dem: Planner.of_elevation(dem, 1.0, step_cost="energy"), ["mobility.energy", "mass_kg"]),
        (lambda dem: Planner.of_elevation(dem, 1.0, step_cost="length"), ["one of paper, tobler", "'length'"]),
        (lambda dem: Planner(dem, step_cost="tobler"), ["'tobler'", "heights", "elevations"]),
        (lambda dem: DynamicPlanner(dem, (0, 0), step_cost="linear"), ["'linear'", "elevations"]),
        (lambda dem: directed(dem).prepare(landmarks=2), ["landmarks", "alike both ways"]),
        (lambda dem: directed(dem).prepare(goals=[(1, 1)]), ["landmarks"]),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(make, words):
    with pytest.raises((InvalidQueryError, InvalidMapError)) as caught:
        make(np.zeros((20, 20), np.float32))
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert "\n" not in str(caught.value)


BODY = Vehicle(2.2, 2.2, 0.6)


def directed(dem, vehicle=None):
    return Planner.of_elevation(dem, 1.0, step_cost="tobler", vehicle=vehicle, warn=False)


def test_ends_that_are_unknown_or_outside_are_outcomes():
    dem = ramp()
    dem[3, 3] = np.nan
    planner = directed(dem)
    for ends, status in (
        (((3, 3), (5, 5)), Status.START_BLOCKED),
        (((5, 5), (3, 3)), Status.GOAL_BLOCKED),
        (((5, 5), (99, 3)), Status.GOAL_OUTSIDE_MAP),
    ):
        assert planner.plan(*ends).status is status
        assert planner.nearest(ends[0], [ends[1]])[0][1].status is status
    same = planner.plan((5, 5), (5, 5))
    assert same.ok and same.cost == 0.0 and same.bound == 1.0


def test_bounds_reckon_with_the_height_between_the_ends():
    dem = ramp(70, 60, 0.2)
    planner = DynamicPlanner.of_elevation(
        dem,
        1.0,
        (32, 50),
        Traversability(slope_limit_deg=60.0),
        "dstar",
        also=("corridor-dstar",),
        step_cost="tobler",
    )
    planner.move((32, 5))
    mended, exact = planner.replan(method="corridor-dstar"), planner.replan(method="dstar")
    assert 0.8 * exact.cost < mended.lower_bound <= mended.cost  # all but the price of height is less than 0.6 of it
    planner.update_elevation(0, 20, dem[:3, 20:24] + np.float32(0.3))  # no path by way of there is as cheap
    assert planner.standing().lower_bound == pytest.approx(exact.cost, rel=1e-5)


def test_the_bound_of_a_blocked_path_downhill_is_below_what_the_way_around_costs():
    dem = ramp(30, 60, 0.05)
    planner = DynamicPlanner.of_elevation(dem, 1.0, (15, 5), None, "dstar", step_cost="tobler")
    planner.move((15, 50))
    planner.replan()
    planner.update_elevation(15, 30, np.full((1, 1), np.nan))
    standing, around = planner.standing(), planner.replan()
    assert standing.footing == "blocked" and around.ok
    assert around.cost * 0.9 < standing.lower_bound <= around.cost


def test_a_goal_downhill_is_nearer_than_a_level_one_that_is_not_so_far():
    mobility, dem = Mobility(energy=EnergyCost(10.0, 0.1)), ramp(60, 60, 0.1)
    planner = Planner.of_elevation(dem, 1.0, step_cost="energy", mobility=mobility, warn=False)
    assert planner.nearest((30, 30), [(40, 30), (30, 15)])[0][0] == 1
