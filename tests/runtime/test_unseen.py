"""Ground of which the means of blocks are known, and cells where they were seen."""

from unittest import mock

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Goal,
    MapPatch,
    Navigator,
    Planner,
    Pose,
    Traversability,
    Vehicle,
    traversability_cost,
)
from nnpp_edge.runtime.kernels.poses import FAILS
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.tuning import MOST_PRICE
from nnpp_edge.terrain.synthetic import synthetic_terrain

FACTOR = 8
CELL_M = 20.0
LIMITS = Traversability(hard_slope_deg=20.0)
HEIGHTS = synthetic_terrain(np.random.default_rng(5), 128, CELL_M).astype(np.float32)
START = (4, 6)
GOAL = (120, 118)


def by_block(cells):
    return cells.reshape(16, FACTOR, 16, FACTOR).mean((1, 3))


def coarse(prior="slope", limits=LIMITS, **options):
    means = by_block(HEIGHTS.astype(np.float64)).astype(np.float32)
    return Planner.of_coarse(means, FACTOR * CELL_M, FACTOR, limits, prior=prior, **options)


def weights(planner):
    planner.state.grid.complete()
    return planner.state.grid.map().copy()


def prices_of(planner):
    return np.kron(planner.state.unseen.layers[0], np.ones((FACTOR, FACTOR), np.float32))


def patches(rng, count):
    for _ in range(count):
        row, col = rng.integers(0, 100, 2).tolist()
        rows, cols = rng.integers(1, 28, 2).tolist()
        yield row, col, HEIGHTS[row : row + rows, col : col + cols]


def test_a_map_of_which_all_cells_were_seen_is_one_of_elevations():
    seen = coarse()
    known = Planner.of_elevation(HEIGHTS, CELL_M, LIMITS, warn=False)
    seen.plan(START, GOAL)
    for row, col, patch in patches(np.random.default_rng(0), 20):
        seen.update_elevation(row, col, patch)
    seen.update_elevation(0, 0, HEIGHTS)
    for method in ("astar", "corridor"):
        plan, other = (planner.plan(START, GOAL, method=method) for planner in (seen, known))
        assert (
            plan.path.tolist() == other.path.tolist()
            and plan.cost == other.cost
            and plan.known == len(plan.path)
        )
    assert np.array_equal(weights(seen), weights(known))


@pytest.mark.parametrize("seed", range(8))
def test_what_is_known_does_not_depend_on_the_order_or_on_when_a_search_looked(seed):
    rng = np.random.default_rng(seed)
    step_by_step = coarse()
    at_once = coarse()
    for number, (row, col, patch) in enumerate(patches(rng, 16)):
        step_by_step.update_elevation(row, col, patch)
        if number % 3 == 0:
            step_by_step.plan(START, GOAL, method=("astar", "corridor")[number % 2])
            obstacles = np.where(rng.random((9, 3)) < 0.5, 1.0, np.nan)
            for planner in (step_by_step, at_once):
                planner.update(row, col, obstacles)
    heights = step_by_step.state.elevation()
    assert np.isnan(heights).any() and np.isfinite(heights).any()
    at_once.update_elevation(0, 0, heights)
    blocks = step_by_step.state.unseen
    grid = step_by_step.state.grid
    assert len(list(blocks.read(grid))) == 1 and not list(blocks.read(grid))
    assert np.array_equal(weights(step_by_step), weights(at_once))
    costs = weights(at_once) / grid.model.scale
    known = np.isfinite(heights) | np.isinf(costs)
    share = by_block(known)
    assert blocks.share == pytest.approx(share) and blocks.left == (share < 1.0).sum()
    assert blocks.blocked * share == pytest.approx(by_block(np.isinf(costs)))
    costs = np.where(np.isinf(costs), 1.0, known * costs)
    assert blocks.mean * share == pytest.approx(by_block(costs), abs=1e-6)


def test_where_nothing_was_seen_a_path_costs_by_the_prices_of_blocks():
    planner = coarse("slope")
    prices = prices_of(planner)
    assert prices.min() >= 0.0 and prices.max() <= MOST_PRICE and len(np.unique(prices)) > 20
    scale = 2.0 * MOST_PRICE  # else the dearest would be impassable
    priced = Planner(prices / np.float32(scale), omega=scale * PAPER_OMEGA)
    exact, other = (each.plan(START, GOAL, method="astar") for each in (planner, priced))
    assert exact.cost == pytest.approx(other.cost, rel=1e-5)
    by_blocks = planner.plan(START, GOAL)
    assert by_blocks.known == exact.known == 0
    assert np.abs(np.diff(by_blocks.path, axis=0)).max() == 1 and by_blocks.path[
        -1
    ].tolist() == list(GOAL)
    assert by_blocks.lower_bound <= exact.cost * (1.0 + 1e-6) and exact.cost <= by_blocks.cost * (
        1.0 + 1e-6
    )
    assert by_blocks.cost <= 1.15 * exact.cost
    assert planner.plan(START, GOAL, epsilon=0.0).cost == pytest.approx(exact.cost, rel=1e-5)


def test_a_wall_of_unknown_blocks_is_dear_and_crossed_over_blocks():
    means = np.tile(HEIGHTS[::FACTOR, ::FACTOR], (4, 4))
    means[:, 50] = np.nan
    planner = Planner.of_coarse(means, FACTOR * CELL_M, FACTOR, LIMITS, prior="slope")
    plan = planner.plan(START, (400, 500))
    assert (
        plan.source == "region"
        and plan.expansions < means.size + 100 * FACTOR**2 < planner.shape[0] * 400
    )
    planner.update_elevation(8, 8, HEIGHTS[8:24, 8:24])
    planner.plan(START, (400, 500))
    assert planner.state.costs_computed < 0.5
    planner.state.grid.complete()  # the search has read few of the cells beyond
    assert plan.cost == planner.state.grid.costs_of(plan.path)[0]
    assert plan.cost > FACTOR * (1.0 + 2.0 * MOST_PRICE * 255.0 * PAPER_OMEGA)


def test_a_cell_weighs_by_its_own_heights_once_it_was_seen_and_the_path_says_how_far_it_is_known():
    planner = coarse(limits=Traversability())
    grid = slice(0, 40)
    planner.update_elevation(0, 0, HEIGHTS[grid, grid])
    costs = weights(planner) / (255.0 * PAPER_OMEGA)
    whole = traversability_cost(HEIGHTS, CELL_M, Traversability(), warn=False)
    prices = prices_of(planner)
    assert costs[:39, :39] == pytest.approx(whole[:39, :39], abs=1e-6)
    assert costs[48:, 48:] == pytest.approx(prices[48:, 48:])
    plan = planner.plan((5, 5), GOAL)
    assert (
        30 < plan.known < len(plan.path)
        and plan.path[plan.known - 1].max() < 40 <= plan.path[plan.known].max()
    )
    assert plan.rest(10).known == plan.known - 10
    assert planner.state.grid.costs_of(plan.path)[0] == plan.cost


def test_a_slope_that_a_part_of_a_cell_s_neighbours_make_too_steep_does_not_shut_it():
    planner = coarse()
    wall = HEIGHTS.copy()
    wall[:, 70:] += 500.0
    planner.update_elevation(0, 0, wall[:, :71])
    assert (
        np.isinf(weights(planner)[1:-1, 69]).all() and np.isfinite(weights(planner)[1:-1, 70]).all()
    )
    planner.update_elevation(0, 71, wall[:, 71:])
    assert np.isinf(weights(planner)[1:-1, 70]).all()


def test_a_moving_planner_on_coarse_ground_takes_what_it_sees():
    moving = DynamicPlanner(coarse().state.unseen.ground, GOAL)
    moving.prepare()
    at = START
    unknown = []
    for _ in range(200):
        row, col = (max(cell - 12, 0) for cell in at)
        moving.update_elevation(row, col, HEIGHTS[row : at[0] + 13, col : at[1] + 13])
        moving.move(at)
        plan = moving.replan()
        assert plan.ok and moving.standing().valid and plan.known > min(6, len(plan.path) - 1)
        unknown.append(len(plan.path) - plan.known)
        at = tuple(plan.path[min(6, len(plan.path) - 1)].tolist())
        if at == GOAL:
            break
    assert at == GOAL and unknown[0] > 50 and unknown[-1] == 0


@pytest.mark.parametrize("turning", [{}, {"turning_radius_m": 60.0, "reverse_cost": 2.0}])
def test_a_body_goes_by_prices_until_its_poses_are_known(turning):
    body = Vehicle(60.0, 40.0, 8.0, max_step_m=10.0, **turning)
    planner = coarse(vehicle=body)
    known = Planner.of_elevation(HEIGHTS, CELL_M, LIMITS, vehicle=body, warn=False)
    plan = planner.plan(START, GOAL)
    assert plan.ok and plan.known == 0 and plan.lower_bound <= plan.cost
    assert bool(plan.arcs) == bool(turning) and 0.0 < plan.numbers.climb_m < np.ptp(HEIGHTS) * 3.0
    planner.update_elevation(0, 0, HEIGHTS[:60, :60])
    seen = planner.plan(START, GOAL)
    reach = max(planner.state.grid.robot.moves.poses.reach)
    assert seen.ok and seen.known > 20 and (seen.path.max(1) + reach < 60).argmin() == seen.known
    planner = coarse(vehicle=body)
    planner.update_elevation(0, 0, HEIGHTS)
    for method in ("astar", "corridor"):
        plan, other = (each.plan(START, GOAL, method=method) for each in (planner, known))
        assert plan.cost == other.cost


@pytest.mark.parametrize("turning", [{}, {"turning_radius_m": 3.0, "reverse_cost": 2.0}])
def test_an_obstacle_and_the_edge_shut_the_motions_on_unseen_ground_that_they_do_elsewhere(turning):
    body = Vehicle(3.0, 2.0, 0.3, **turning)
    planner = DynamicPlanner.of_coarse(
        np.zeros((8, 8)), 8.0, 8, (58, 30), prior="slope", vehicle=body
    )
    flat = Planner.of_elevation(np.zeros((64, 64)), 1.0, vehicle=body, warn=False)
    planner.move((6, 30))
    planner.replan()
    told = np.where(np.random.default_rng(6).random((64, 64)) < 0.005, 1.0, np.nan)
    told[30, 24:36] = 1.0
    for each in (planner, flat):
        each.update(0, 0, told)
    assert not planner.standing().valid and planner.replan().ok
    poses, known = (each.state.grid.robot.moves.poses for each in (planner, flat))
    poses.complete()
    known.complete()
    assert np.array_equal(poses.codes >= FAILS, known.codes >= FAILS)
    planner.update(20, 0, np.ones((1, 64)))
    assert planner.replan().status == "NO_PATH"


def test_a_way_over_blocks_cuts_no_corner_that_may_not_be_cut_and_is_bounded():
    flat = np.zeros((16, 16), np.float32)
    planner = DynamicPlanner.of_coarse(flat, 8.0, 8, (0, 100), prior="slope", corner_cutting=False)
    planner.state.unseen.layers[0] = 0.0
    planner.move((0, 0))
    plan, exact = (planner.replan(method=method) for method in ("corridor", "astar"))
    assert plan.lower_bound <= exact.cost < plan.cost / 1.02
    planner.set_goal(GOAL)
    for at in range(FACTOR, 128, FACTOR):
        planner.update(at, at - 1, np.ones((1, 1)))
    plan, exact = (planner.replan(method=method) for method in ("corridor", "astar"))
    assert plan.source == "region" and planner.standing().valid and exact.cost <= plan.cost


def test_obstacles_that_were_told_on_unseen_ground_are_gone_around_without_a_search_of_all_cells():
    means = np.tile(HEIGHTS[::FACTOR, ::FACTOR], (4, 4))
    planner = Planner.of_coarse(means, FACTOR * CELL_M, FACTOR, Traversability(), prior="slope")
    planner.update(238, 172, np.ones((2, 180)))
    planner.update(148, 262, np.ones((180, 2)))
    goals = (480, 490), (235, 267)
    plans = [planner.plan((20, 20), goal) for goal in goals]
    assert planner.state.costs_computed < 0.8
    for goal, plan in zip(goals, plans, strict=True):
        exact = planner.plan((20, 20), goal, method="astar")
        assert exact.cost <= plan.cost <= 1.25 * exact.cost


def test_heights_of_unseen_ground_lie_between_the_means_of_blocks():
    rows, cols = np.mgrid[:16, :16]
    planner = Planner.of_coarse(3.0 * rows + 5.0 * cols, 8.0, FACTOR, prior="slope")
    along = planner.state.along(np.array(((20, 30), (100, 90))))
    expected = (along.places + 0.5) @ (3.0, 5.0) / FACTOR - 4.0
    assert along.sampled_m == pytest.approx(expected, abs=1e-4)


def test_the_loop_says_how_far_its_path_is_known_and_looks_once():
    ground = coarse(limits=Traversability()).state.unseen.ground
    navigator = Navigator(ground, tolerance=9.0)
    navigator.offer(Goal(*GOAL))
    navigator.offer(Pose(*START))
    look = mock.patch.object(
        MapState, "known_along", autospec=True, side_effect=MapState.known_along
    )
    with look as asked:
        assert navigator.tick().known == 0 and asked.call_count == 1
    navigator.offer(MapPatch(0, 0, elevation=HEIGHTS[:30, :30]))
    message = navigator.tick()
    assert message.origin == "standing" and message.known > 20


def test_poses_at_the_edge_of_what_was_seen_are_not_refused_for_want_of_the_rest():
    heights = np.add.outer(
        0.45 * CELL_M * np.arange(128.0), 0.1 * CELL_M * np.arange(128.0)
    ).astype(np.float32)
    body = Vehicle(100.0, 80.0, 20.0, max_tilt_deg=25.0, max_step_m=20.0)
    planner = Planner.of_coarse(
        by_block(heights), FACTOR * CELL_M, FACTOR, prior="slope", vehicle=body
    )
    planner.update_elevation(30, 30, heights[30:70, 30:70])
    assert (
        planner.state.grid.robot.moves.poses.standing()[:, 5:-5, 5:-5] < FAILS
    ).all()  # a plane of 24.7 degrees, all of it
    planner.update_elevation(
        66, 30, heights[66:70, 30:70] + np.where(np.arange(40) < 20, 30.0, 0.0).astype(np.float32)
    )
    assert not planner.is_passable((66, 45)) and planner.is_passable(
        (66, 60)
    )  # a step, of which all was seen
