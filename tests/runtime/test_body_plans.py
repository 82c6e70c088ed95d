"""Plans of a vehicle's body on a map that changes, and by corridors that close what a search did not get across."""

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Planner, Vehicle, pose_costs
from nnpp_edge.runtime.kernels.nodes import STAMP_SHIFT
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.search.workspace import Workspace
from tests import pose_oracles

ROVER = Vehicle(length_m=1.2, width_m=0.9, clearance_m=0.3, max_tilt_deg=30.0)
LOW = Vehicle(length_m=1.5, width_m=1.2, clearance_m=0.05, max_step_m=0.04)
CELL_M, SCALE = 0.25, 255 * 0.011
START, GOAL = (128, 20), (128, 236)


def optimum(dem, start, goal, vehicle=ROVER):
    return Planner.of_elevation(dem, CELL_M, vehicle=vehicle, warn=False).plan(start, goal, method="astar")


@pytest.mark.parametrize("method", ["dstar", "astar", "corridor-dstar", "nnpp-dstar", "auto"])
def test_plans_on_a_changing_map_are_those_of_a_new_planner(method):
    rng, (down, right) = np.random.default_rng(2), np.mgrid[:44, :44]
    dem = (0.2 * np.sin(right / 6.0 + 2) * np.cos(down / 5.0)).astype(np.float32)
    for _ in range(21):
        dem[tuple(rng.integers(0, 44, 2))] += rng.uniform(0.05, 0.4)
    at, goal = (7, 8), (36, 35)
    planner = DynamicPlanner.of_elevation(dem, CELL_M, goal, method=method, vehicle=ROVER)

    def cost_of(path):
        return pose_oracles.path_cost_over_poses(pose_costs(dem, CELL_M, ROVER), path, SCALE)

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
