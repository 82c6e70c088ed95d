"""A vehicle of which a radius is known: a disc, on costs and on elevations."""

import copy
import itertools
import math

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Planner, Vehicle, traversability_cost
from nnpp_edge.runtime.errors import Status

DISC = Vehicle(radius_m=1.2)
CELL_M = 0.5


def costs(seed=0, side=40, share=0.004):
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0.1, 0.6, (side, side)).astype(np.float32)
    cost[rng.random(cost.shape) < share] = math.inf
    return cost


def stands(cost, cell, radius=DISC.radius_m, side=CELL_M):
    """Whether no obstacle and no edge of the map lies within the radius of a cell's middle."""
    rows, cols = np.mgrid[-8 : len(cost) + 8, -8 : len(cost[0]) + 8]
    blocked = np.pad(~(cost < 1.0), 8, constant_values=True)
    down = np.maximum(np.abs(rows - cell[0]) - 0.5, 0.0) * side
    along = np.maximum(np.abs(cols - cell[1]) - 0.5, 0.0) * side
    return not (blocked & (np.hypot(down, along) < radius)).any()


def ends(planner):
    weights = planner.state.grid.map()
    cells = np.argwhere(np.isfinite(weights))
    return tuple(cells[0].tolist()), tuple(cells[-1].tolist())


def test_a_gap_is_passed_if_it_is_wide_enough():
    for gap, status in ((3, Status.NO_PATH), (9, Status.OK)):
        cost = np.full((40, 60), 0.2, np.float32)
        cost[:, 30] = math.inf
        cost[16 : 16 + gap, 30] = 0.2
        assert Planner(cost).plan((20, 8), (20, 50)).ok
        planner = Planner(cost, vehicle=DISC, cell_size_m=CELL_M)
        assert planner.plan((20, 8), (20, 50)).status is status
    planner.update(16, 30, np.full((9, 1), math.inf, np.float32))
    assert planner.plan((20, 8), (20, 50)).status is Status.NO_PATH


def test_a_disc_on_a_map_that_changes():
    planner = DynamicPlanner(costs(1, share=0.0), (30, 30), "dstar", vehicle=DISC, cell_size_m=CELL_M)
    planner.move((8, 8))
    assert planner.replan().ok
    planner.update(18, 0, np.full((1, 40), math.inf, np.float32))
    assert not planner.standing().valid and planner.replan().status is Status.NO_PATH


def test_a_disc_keeps_its_distance_on_cells_and_between_them():
    for seed in range(4):
        cost = costs(seed)
        planner = Planner(cost, vehicle=DISC, cell_size_m=CELL_M)
        for method in ("astar", "corridor", "nnpp"):
            plan = planner.plan(*ends(planner), method=method)
            assert plan.status in (Status.OK, Status.NO_PATH)
            for one, other in itertools.pairwise(plan.path):
                assert all(stands(cost, (1.0 - share) * one + share * other) for share in (0.0, 0.25, 0.5, 0.75))


@pytest.mark.parametrize("elevations", [False, True])
def test_after_patches_the_map_is_that_of_a_new_planner(elevations):
    ground, rng = costs(0), np.random.default_rng(0)
    if elevations:
        row, col = np.mgrid[:40, :40]
        ground = (0.3 * np.sin(row / 5.0) * np.cos(col / 6.0)).astype(np.float32)
        ground[20, 20] = np.nan

    def fresh():
        cost = traversability_cost(ground, CELL_M, warn=False) if elevations else ground
        return Planner(cost, vehicle=DISC, cell_size_m=CELL_M)

    planner = Planner.of_elevation(ground, CELL_M, vehicle=DISC, warn=False) if elevations else fresh()
    for _ in range(16):
        rows, cols = rng.integers(1, 9, 2)
        row, col = (int(rng.integers(0, 40 - size)) for size in (rows, cols))
        patch = costs(int(rng.integers(1e6)), 9, 0.05)[:rows, :cols]
        ground[row : row + rows, col : col + cols] = np.where(np.isinf(patch), np.nan, patch) if elevations else patch
        update = planner.update_elevation if elevations else planner.update
        update(row, col, ground[row : row + rows, col : col + cols])
        for ours in (planner, copy.deepcopy(planner)):
            np.testing.assert_array_equal(ours.state.grid.map(), fresh().state.grid.map())
