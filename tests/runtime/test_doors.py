"""Terms of layers under a body, and a step cost that is the same both ways beside costs given.
Beside Dijkstra's algorithm both are in `test_robots`.
"""

from dataclasses import replace

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Ground, Planner
from nnpp_edge.runtime.terrain.traversability import terrain_terms
from tests import pose_oracles
from tests.doors import SHADED, RoughMobility, add_step_cost, add_term
from tests.fuzz import bodies
from tests.worlds import CAR, OMEGA, ROVER

SIDE = 0.25


@pytest.mark.parametrize("vehicle", [replace(ROVER, turn_cost_m_per_rad=0.0), CAR])
def test_a_body_pays_for_the_layer_under_its_wheels(vehicle, monkeypatch):
    add_term(monkeypatch)
    row, col = np.mgrid[:30, :40].astype(np.float32)
    dem = np.zeros(row.shape, np.float32)

    def planner(shade):
        given = {"vehicle": vehicle, "layers": {"shade": shade}}
        return Planner(Ground.of_elevation(dem, SIDE, SHADED, **given))

    shade = 0.1 + row / 200.0 + col / 250.0  # whose mean over a leg is that at its middle
    moving = planner(shade)
    motions = bodies.motions_on(bodies.poses_of(moving))
    inner = np.s_[4:-4, 4:-4]
    for k, (down, right) in enumerate(pose_oracles.AXES):
        middle = shade + down / 400.0 + right / 500.0
        found = (motions[k] - 1.0) / bodies.MOST_CODE
        wanted = SHADED.shade_weight * middle / SHADED.shade_limit
        assert found[inner] == pytest.approx(wanted[inner], abs=2 * bodies.T_ROUNDED)
    plan = moving.plan((5, 5), (24, 20))
    if plan.states is None:
        lengths = np.hypot(*np.diff(plan.path, axis=0).T)
        middles = shade[tuple((plan.path[1:] + plan.path[:-1]).T // 2)]
        counted = 1.0 + 2.0 * 255.0 * OMEGA * SHADED.shade_weight / SHADED.shade_limit * middles
        assert plan.cost == pytest.approx((lengths * counted).sum(), rel=0.01)
    shade[8:20, 10:30] = 0.4
    moving.update(8, 10, shade[8:20, 10:30], layer="shade")
    fresh = planner(shade)
    codes = [bodies.poses_of(each).codes for each in (moving, fresh)]
    np.testing.assert_array_equal(*codes)
    assert moving.plan((5, 5), (24, 20)).cost == fresh.plan((5, 5), (24, 20)).cost > plan.cost


def test_a_price_by_the_ground_alone_is_that_of_costs_given_with_lengths(monkeypatch):
    add_step_cost(monkeypatch)
    dem = np.random.default_rng(4).normal(0.0, 0.03, (60, 70)).astype(np.float32)
    dem[10:50, 30] = np.nan
    ways = {"step_cost": "rough", "mobility": RoughMobility()}
    towards = {"goal": (55, 60), "refine": "any-angle"}
    rough = DynamicPlanner(Ground.of_elevation(dem, SIDE, **ways), **towards)
    for _ in range(2):
        _, roughness, _ = terrain_terms(dem, SIDE)
        cost = np.where(rough.state.cost() < 1.0, 2.0 * SIDE * (1.0 + 9.0 * roughness), np.inf)
        given = DynamicPlanner(Ground(cost, step_cost="length"), **towards)
        for method in ("dstar", "astar", "corridor"):
            for each in (rough, given):
                each.move((4, 5))
            ours, theirs = (each.replan(method=method) for each in (rough, given))
            assert ours.ok and ours.cost == pytest.approx(theirs.cost, rel=1e-5)
            assert ours.line_cost == pytest.approx(theirs.line_cost, rel=1e-5)
            assert len(ours.waypoints) < len(ours.path)
        assert rough.state.grid.robot.by_weights  # landmarks serve
        dem[20:30, 10:40] += np.float32(0.1) * (np.arange(30) % 2)
        rough.update_elevation(20, 10, dem[20:30, 10:40])
