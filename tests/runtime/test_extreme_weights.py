"""Weights of any size: exact, and about as much work as weights that are alike; what no map can hold."""

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Ground,
    MapPatch,
    Navigator,
    Planner,
    traversability_cost,
)
from tests.oracles import dijkstra

SIDE = 120
ENDS = (3, 5), (SIDE - 6, SIDE - 9)
RNG = np.random.default_rng(0)
PLAIN = RNG.uniform(1.0, 3.0, (SIDE, SIDE)).astype(np.float32)


def with_cells(value):
    cost = PLAIN.copy()
    cost.flat[np.random.default_rng(1).choice(SIDE * SIDE, 5, replace=False)] = value
    return cost


def with_wall(value):
    cost = PLAIN.copy()
    cost[50:60] *= np.float32(value)
    return cost


def test_the_optimum_is_found_without_expanding_cells_over_and_over():
    for cost in (
        *map(with_cells, (1e7, 1e20, 1e30, 1e-4, 1e-30, 1.2e-38)),
        *map(with_wall, (1e3, 1e8, 1e20)),
        *(PLAIN * np.float32(value) for value in (1.2e-38, 1e29)),
        *((10.0 ** RNG.uniform(a, b, (SIDE, SIDE))).astype(np.float32) for a, b in ((-3, 3), (-12, 12), (-37.9, 30))),
    ):
        optimum = dijkstra(cost.astype(np.float64), ENDS[0], "length")[ENDS[1]]
        planner = Planner(cost, step_cost="length")
        for method in ("astar", "corridor"):
            plan = planner.plan(*ENDS, method=method, epsilon=0.0)
            assert plan.cost == pytest.approx(optimum, rel=1e-5, abs=0.0)
            assert plan.lower_bound <= optimum * (1 + 1e-6)
            assert plan.expansions < 8 * cost.size
        dynamic = DynamicPlanner(cost, ENDS[1], "dstar", step_cost="length")
        dynamic.move(ENDS[0])
        assert dynamic.replan().cost == pytest.approx(optimum, rel=1e-5, abs=0.0)
        plan = dynamic.replan(method="corridor-dstar")
        assert plan.lower_bound <= optimum * (1 + 1e-6) <= plan.cost * (1 + 2e-5)


def test_a_patch_of_extreme_weights_leaves_nothing_behind_once_it_is_taken_back():
    for value in (1e9, 1e30, 1e-9, 1e-37):
        planner = Planner(PLAIN, step_cost="length")
        before = {method: planner.plan(*ENDS, method=method) for method in ("astar", "corridor")}
        planner.update(40, 40, np.full((2, 3), value))
        planner.plan(*ENDS)
        planner.update(40, 40, PLAIN[40:42, 40:43])
        for method, plan in before.items():
            now = planner.plan(*ENDS, method=method)
            assert (now.cost, now.expansions, now.lower_bound) == (plan.cost, plan.expansions, plan.lower_bound)


def test_mended_paths_are_optimal_where_all_weights_have_grown_beyond_comparison():
    """In units of the cheapest step that there was, the dearest of today would be too many for a float32."""
    planner = DynamicPlanner(PLAIN * np.float32(1e-30), ENDS[1], "dstar", step_cost="length")
    planner.move(ENDS[0])
    assert planner.replan().ok
    grown = (10.0 ** RNG.uniform(0, 7, (SIDE, SIDE))).astype(np.float32)
    planner.update(0, 0, grown)
    assert planner.replan().cost == pytest.approx(dijkstra(grown, ENDS[0], "length")[ENDS[1]], rel=1e-6)


def test_the_loop_rejects_patches_that_no_map_can_hold():
    loop = Navigator(Ground(PLAIN, step_cost="length"))
    for number, weight in enumerate((0.0, 1e-39, 1.1e30, 3.4e38)):
        loop.offer(MapPatch(0, 0, cost=np.full((2, 2), weight)))
        assert loop.counters().patches_rejected == number + 1


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16, np.uint8])
def test_a_masked_cell_is_unknown_everywhere(dtype):
    """As rasterio's read(masked=True) gives it: a number that means nothing under the mask."""
    plain = np.ones((5, 5), dtype)
    weights = np.ma.MaskedArray(plain.copy(), np.zeros(plain.shape, np.bool_), fill_value=0)
    weights.data[2, 2], weights.mask[2, 2] = 0, True
    planner, free = Planner(weights, step_cost="length"), Planner(plain, step_cost="length")
    assert planner.plan((2, 2), (0, 0)).status == "START_BLOCKED"
    assert free.plan((2, 2), (0, 0)).ok
    free.update(0, 0, weights)
    assert free.plan((2, 2), (0, 0)).status == "START_BLOCKED"
    dynamic = DynamicPlanner(plain, (4, 4), "dstar", step_cost="length")
    dynamic.update(0, 0, weights)
    assert not dynamic.is_passable((2, 2))
    assert np.argwhere(np.isnan(MapPatch(0, 0, elevation=weights).elevation)).tolist() == [[2, 2]]
    loop = Navigator(Ground.of_elevation(plain, 1.0))
    loop.offer(MapPatch(0, 0, elevation=weights))
    loop.tick()
    assert np.isinf(loop.map.cost()[2, 2])
    if dtype is np.float64:
        weights.data[2, 2] = -1.7976931348623157e308  # which no map can hold
    assert np.argwhere(np.isinf(traversability_cost(weights, 1.0))).tolist() == [[2, 2]]
