"""A vehicle on a map that changes: D* Lite over poses, the standing path, the loop."""

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Planner, Vehicle, pose_costs
from tests import pose_oracles

ROVER = Vehicle(length_m=1.2, width_m=0.9, clearance_m=0.3, max_tilt_deg=30.0)
CELL_M, SCALE = 0.25, 255 * 0.011


def ground(seed, side=44):
    rng, (row, col) = np.random.default_rng(seed), np.mgrid[:side, :side]
    dem = (0.2 * np.sin(col / 6.0 + seed) * np.cos(row / 5.0)).astype(np.float32)
    for _ in range(side * side // 90):
        dem[tuple(rng.integers(0, side, 2))] += rng.uniform(0.05, 0.4)
    return dem, rng


def optimum(dem, start, goal):
    return Planner.of_elevation(dem, CELL_M, vehicle=ROVER, warn=False).plan(start, goal, method="astar")


def bumped(dem, rng):
    """A patch of heights somewhere: as they are, raised or lowered at random."""
    row, col = (int(at) for at in rng.integers(0, len(dem) - 6, 2))
    noise = rng.choice([0.0, 0.3, -0.2]) * rng.random((6, 6))
    return row, col, (dem[row : row + 6, col : col + 6] + noise).astype(np.float32)


@pytest.mark.parametrize("method", ["dstar", "astar", "corridor-dstar", "nnpp-dstar", "auto"])
def test_plans_on_a_changing_map_are_those_of_a_new_planner(method):
    dem, rng = ground(2)
    at, goal = (7, 8), (len(dem) - 8, len(dem) - 9)
    planner = DynamicPlanner.of_elevation(dem, CELL_M, goal, method=method, vehicle=ROVER)
    for _ in range(6):
        planner.move(at)
        plan, best = planner.replan(), optimum(dem, at, goal)
        assert plan.status is best.status
        if plan.ok:
            costs = pose_costs(dem, CELL_M, ROVER)
            assert pose_oracles.path_cost_over_poses(costs, plan.path, SCALE) == pytest.approx(plan.cost, rel=1e-5)
            assert plan.cost >= best.cost * (1.0 - 1e-5)
            if method in ("dstar", "astar"):
                assert plan.cost == pytest.approx(best.cost, rel=1e-5)
            assert planner.standing().valid
            at = tuple(plan.path[min(3, len(plan.path) - 1)].tolist())
            planner.move(at)
        row, col, patch = bumped(dem, rng)
        dem[row : row + 6, col : col + 6] = patch
        planner.update_elevation(row, col, patch)
        if plan.ok and (standing := planner.standing()).valid:
            assert standing.cost == pytest.approx(_cost_from(dem, planner.standing_plan.path, at), rel=1e-5)
            now = optimum(dem, at, goal)
            assert not now.ok or standing.lower_bound <= now.cost * (1.0 + 1e-5)


def _cost_from(dem, path, at):
    first = int(np.flatnonzero((path == at).all(1))[0])
    return (
        pose_oracles.path_cost_over_poses(pose_costs(dem, CELL_M, ROVER), path[first:], SCALE)
        if first < len(path) - 1
        else 0.0
    )
