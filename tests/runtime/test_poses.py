"""Poses of a robot with a body, and plans over them, beside plain and slow answers.

Many more cases of the same kind: ``python -m tests.fuzz --target bodies``.
"""

import dataclasses
import math
import random

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Planner, Traversability, Vehicle, pose_costs
from nnpp_edge.runtime.kernels.nodes import STAMP_SHIFT
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.search.workspace import Workspace
from tests import pose_oracles
from tests.fuzz import bodies
from tests.fuzz.cases import Place

METHODS = ("astar", "corridor")
ROVER = Vehicle(length_m=1.3, width_m=0.9, clearance_m=0.3, wheel_length_m=0.21, wheel_width_m=0.13)
CELL_M = 0.25
ROUNDING_M = 1e-6
pytestmark = pytest.mark.filterwarnings("ignore:the network .* was trained for omega")


@pytest.fixture
def planner(tiny_model):
    """Makes planners with a small network."""

    def make(dem, vehicle=ROVER, **options):
        return Planner.of_elevation(dem, CELL_M, vehicle=vehicle, model=tiny_model, ask_from=0, warn=False, **options)

    return make


def rocks(seed, rows=44, cols=52, share=0.02):
    """Gentle hills with rocks of half a clearance to two."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:rows, :cols]
    dem = 0.15 * np.sin(row / 9.0 + seed) + 0.2 * np.cos(col / 11.0)
    dem[rng.random(dem.shape) < share] += rng.uniform(0.15, 0.6)
    return dem.astype(np.float32)


def ends_of(costs, seed):
    """Two cells far apart on which the body may stand."""
    cells = np.argwhere(np.isfinite(costs).any(0))
    rng = random.Random(seed)
    pairs = [[tuple(map(int, cells[rng.randrange(len(cells))])) for _ in range(2)] for _ in range(8)]
    return max(pairs, key=lambda pair: math.dist(*pair))


def test_flat_ground_costs_nothing_and_the_three_weights_are_those_of_eq_1():
    found = pose_costs(np.full((20, 24), 7.0, np.float32), CELL_M, ROVER)
    assert found.shape == (4, 20, 24) and found.dtype == np.float32
    assert (found[:, 6:-6, 6:-6] == 0.0).all()
    assert np.isinf(found[:, 0]).all() and np.isinf(found[:, :, -1]).all()
    limits = Traversability(slope_weight=0.1, roughness_weight=0.7, step_weight=0.2)
    dem = rocks(3, 20, 24)
    found = pose_costs(dem, CELL_M, ROVER, traversability=limits)
    wanted = pose_oracles.naive_pose_costs(dem, CELL_M, ROVER, weights=(0.1, 0.7, 0.2))
    both = np.isfinite(found) & np.isfinite(wanted)
    assert both.any()
    np.testing.assert_allclose(found[both], wanted[both], atol=5e-5)


def test_poses_and_plans_over_them_are_the_naive_ones_checked_at_once_or_where_a_search_looks(tiny_model):
    for seed in range(14):
        case = bodies.generate(random.Random(seed), most_side=16)
        assert (problem := bodies.check(case, Place(tiny_model.parent))) is None, f"{seed}: {problem.kind}"


@pytest.mark.parametrize(("n", "drop"), [(2, 0.05), (3, 0.26), (4, 0.15), (6, 0.05)])
def test_ground_made_to_meet_the_belly_between_two_cells_never_does(n, drop):
    """The front wheels come down and the ground between the wheels is as high as both poses bear."""
    length, point = 2 * n + 0.07, {"wheel_length_m": 0.01, "wheel_width_m": 0.01}
    stance = {"wheelbase_m": 2 * n - 0.03, "track_m": 2.7}
    vehicle = Vehicle(length, 3.3, 0.3, max_tilt_deg=30.0, max_step_m=1.0, **stance, **point)
    dem, middle, col = np.full((13, 2 * n + 14), -3.0), 6, n + 6
    for row in (4, 5, 7, 8):
        dem[row, col - n : col - n + 3] = -0.5 * drop / length, 0.0, 0.0
        dem[row, col + n - 1 : col + n + 2] = -0.5 * drop / length, -0.5 * drop / length, -drop

    def both_pass():
        return np.isfinite(pose_costs(dem, 1.0, vehicle)[2, middle, col : col + 2]).all()

    for at in range(col - n, col + n + 2):  # raised cell by cell while both poses pass
        for height in np.arange(0.35, 0.0, -0.005):
            dem[middle, at] = height
            if both_pass():
                break
            dem[middle, at] = -3.0
    assert both_pass()
    path = [(middle, col), (middle, col + 1)]
    assert pose_oracles.drive_breaks(dem, 1.0, vehicle, path, positions=20, margin_m=ROUNDING_M) is None


def test_checks_are_made_where_a_search_looks_and_are_kept(planner):
    dem = rocks(1, share=0.001)
    costs, ours = pose_costs(dem, CELL_M, ROVER), planner(dem)
    pairs = (ends_of(costs, seed) for seed in range(40))
    start, goal = next(pair for pair in pairs if planner(dem).plan(*pair, method="astar").ok)
    first, again = (ours.plan(start, goal, method="astar") for _ in range(2))
    assert first.ok and 0 < first.checks <= 4 * dem.size
    assert again.checks == 0 and again.cost == first.cost
    row, col = first.path[len(first.path) // 2]
    ours.update_elevation(int(row), int(col), dem[row : row + 1, col : col + 1] + np.float32(0.01))
    assert 0 < ours.plan(start, goal, method="astar").checks < first.checks
    assert planner(dem, lazy=False).plan(start, goal, method="astar").checks == 0
    plan = planner(np.zeros((200, 200), np.float32)).plan((90, 90), (92, 110), method="astar")
    assert plan.ok and plan.checks < 0.1 * 4 * 200 * 200  # a short way checks a small part of the map


def test_headings_are_those_of_the_steps(planner):
    ours = planner(np.zeros((40, 40), np.float32))
    for goal, heading in (((10, 20), 0.0), ((20, 30), 90.0), ((30, 20), 180.0), ((30, 10), 225.0), ((10, 10), 315.0)):
        plan = ours.plan((20, 20), goal, method="astar")
        np.testing.assert_allclose(plan.headings_deg, np.full(len(plan.path), heading), atol=1e-9)
    assert len(ours.plan((20, 20), (20, 20), method="astar").headings_deg) == 0


def test_the_judges_of_poses_and_plans_can_fail(monkeypatch):
    case = bodies.generate(random.Random(1), most_side=12)
    dem = np.zeros(case.dem.shape)
    dem[dem.shape[0] // 2, dem.shape[1] // 2] = 1.5 * case.vehicle.clearance_m
    assert bodies.problem_with_poses(dem, case.cell, case.vehicle) is None
    flat = pose_costs(np.zeros_like(dem), case.cell[0], case.vehicle, cell_width_m=case.cell[1])
    monkeypatch.setattr(bodies, "pose_costs", lambda *given, **options: flat)  # a check that forgets the belly
    found = bodies.problem_with_poses(dem, case.cell, case.vehicle)
    assert found is not None and found.kind == "a pose passes that must fail"
    costs, ends = np.zeros((4, 6, 6), np.float32), ((2, 0), (2, 5))
    plan = Planner(np.zeros((6, 6), np.float32)).plan(*ends, method="astar")
    assert bodies.problem_with_plan(plan, costs, *ends, 0.011, True) is None
    found = bodies.problem_with_plan(dataclasses.replace(plan, checks=145), costs, *ends, 0.011, True)
    assert found is not None and found.kind.startswith("145 of 144 poses checked")
    costs[2, 2, 3] = np.inf
    found = bodies.problem_with_plan(plan, costs, *ends, 0.011, True)
    assert found is not None and found.kind.startswith("a path through a pose that fails")


def test_what_is_driven_breaks_no_limit_between_the_cells(planner):
    for method in METHODS:
        driven = 0
        for seed in range(4):
            dem = rocks(seed, share=0.01)
            start, goal = ends_of(pose_costs(dem, CELL_M, ROVER), seed)
            plan = planner(dem).plan(start, goal, method=method)
            assert pose_oracles.drive_breaks(dem, CELL_M, ROVER, plan.path, margin_m=ROUNDING_M) is None
            driven += len(plan.path)
        assert driven > 40


SMALL = Vehicle(length_m=1.2, width_m=0.9, clearance_m=0.3, max_tilt_deg=30.0)
LOW = Vehicle(length_m=1.5, width_m=1.2, clearance_m=0.05, max_step_m=0.04)
SCALE = 255 * 0.011
START, GOAL = (128, 20), (128, 236)


def optimum(dem, start, goal, vehicle=SMALL):
    return Planner.of_elevation(dem, CELL_M, vehicle=vehicle, warn=False).plan(start, goal, method="astar")


@pytest.mark.parametrize("method", ["dstar", "astar", "corridor-dstar", "nnpp-dstar", "auto"])
def test_plans_on_a_changing_map_are_those_of_a_new_planner(method):
    rng, (down, right) = np.random.default_rng(2), np.mgrid[:44, :44]
    dem = (0.2 * np.sin(right / 6.0 + 2) * np.cos(down / 5.0)).astype(np.float32)
    for _ in range(21):
        dem[tuple(rng.integers(0, 44, 2))] += rng.uniform(0.05, 0.4)
    at, goal = (7, 8), (36, 35)
    planner = DynamicPlanner.of_elevation(dem, CELL_M, goal, method=method, vehicle=SMALL)

    def cost_of(path):
        return pose_oracles.path_cost_over_poses(pose_costs(dem, CELL_M, SMALL), path, SCALE)

    for _ in range(6):
        planner.move(at)
        plan, best = planner.replan(), optimum(dem, at, goal)
        assert plan.status is best.status
        if plan.ok:
            assert cost_of(plan.path) == pytest.approx(plan.cost, rel=1e-5)
            assert plan.cost >= best.cost * (1.0 - 1e-5)
            if method in ("dstar", "astar"):
                assert plan.cost == pytest.approx(best.cost, rel=1e-5)
            assert planner.standing().valid
            at = tuple(plan.path[min(3, len(plan.path) - 1)].tolist())
            planner.move(at)
        row, col = (int(n) for n in rng.integers(0, 38, 2))  # heights as they are, raised or lowered at random
        dem[row : row + 6, col : col + 6] += rng.choice([0.0, 0.3, -0.2]) * rng.random((6, 6))
        planner.update_elevation(row, col, dem[row : row + 6, col : col + 6])
        if plan.ok and (standing := planner.standing()).valid:
            path = planner.standing_plan.path
            rest = path[int(np.flatnonzero((path == at).all(1))[0]) :]
            assert standing.cost == pytest.approx(cost_of(rest) if len(rest) > 1 else 0.0, rel=1e-5)
            now = optimum(dem, at, goal)
            assert not now.ok or standing.lower_bound <= now.cost * (1.0 + 1e-5)


@pytest.fixture(scope="module")
def gaps():
    """A wall of rocks that a body cannot see through means: gaps too narrow for it in front, a wide one aside."""
    dem = np.zeros((256, 256), np.float32)
    dem[::4, 128] = 0.06  # a post in each block: cheap on average, and no body gets between two
    dem[20:44, 128] = 0.0
    return dem


def test_where_no_pose_passes_the_links_are_closed_and_the_next_region_leads_around(gaps, monkeypatch):
    closed, close = [], CoarseLevel.close_dead_ends
    monkeypatch.setattr(
        CoarseLevel, "close_dead_ends", lambda self, *given: closed.append(close(self, *given)) or closed[-1]
    )
    exact = optimum(gaps, START, GOAL, LOW)
    planner = Planner.of_elevation(gaps, CELL_M, vehicle=LOW, warn=False)
    plan = planner.plan(START, GOAL, method="corridor")
    assert exact.ok and plan.ok and plan.source in (Source.REGION, Source.WIDENED)
    assert any(closed) and plan.cost == pytest.approx(exact.cost, rel=0.01)
    whole = Planner.of_elevation(gaps, CELL_M, vehicle=LOW, warn=False, lazy=False).state.pyramid.levels[1]
    planner.state.grid.tiles.complete()
    np.testing.assert_array_equal(planner.state.pyramid.levels[1].links, whole.links)  # opened again
    moving = DynamicPlanner.of_elevation(gaps, CELL_M, GOAL, method="corridor-dstar", vehicle=LOW)
    moving.move(START)
    assert moving.replan().ok  # what D* Lite reached is not in the memory by which dead ends are found


def test_closed_links_are_opened_again_and_set_no_landmarks(gaps):
    state = Planner.of_elevation(gaps, CELL_M, vehicle=LOW, warn=False, lazy=False).state
    memory, coarse = Workspace(len(state.grid.weights)), CoarseLevel(state.pyramid.levels[1])
    links, stamp = coarse.level.links.copy(), memory.next_stamp()
    memory.meta[1 : memory.meta.size // 2 : 2] = stamp << STAMP_SHIFT  # the upper half was reached
    everywhere = np.ones((2 * coarse.grid.rows, 2 * coarse.grid.cols), np.int32)
    assert coarse.close_dead_ends(Region(everywhere, *state.pyramid.levels[0].quarters, 1), memory, state.shape)
    assert (coarse.level.links != links).any() and not (coarse.level.links & ~links).any()
    for _ in range(20):
        coarse.search((0, 0), (31, 63), None, beyond=0.0)
        coarse.invest()
    assert coarse.landmarks is None
    coarse.open_dead_ends()
    np.testing.assert_array_equal(coarse.level.links, links)
