"""Terms of layers under a body, and a step cost that is the same both ways beside costs given.
Beside Dijkstra's algorithm both are in `test_robots`.
"""

from dataclasses import replace

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Ground, Planner
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.options import CELLS, METHODS, Entry
from nnpp_edge.runtime.terrain.traversability import terrain_terms
from tests.doors import SHADED, RoughMobility, add_step_cost, add_term
from tests.fuzz import bodies
from tests.worlds import OMEGA, ROVER

SIDE = 0.25


def test_a_body_pays_for_the_layer_under_its_wheels(monkeypatch):
    add_term(monkeypatch)

    def shade_at(row, col):  # its mean over a leg is that at the leg's middle
        return 0.1 + row / 200.0 + col / 250.0

    def planner():
        vehicle = replace(ROVER, turn_cost_m_per_rad=0.0)
        given = {"vehicle": vehicle, "layers": {"shade": shade}}
        return Planner(Ground.of_elevation(np.zeros(shade.shape), SIDE, SHADED, **given))

    shade = shade_at(*np.mgrid[:30, :40])
    ends = (5, 5), (24, 20)
    moving = planner()
    plan = moving.plan(*ends)
    lengths = np.hypot(*np.diff(plan.path, axis=0).T)
    shares = shade_at(*(plan.path[1:] + plan.path[:-1]).T / 2) / SHADED.shade_limit
    wanted = lengths @ (1.0 + 2.0 * 255.0 * OMEGA * SHADED.shade_weight * shares)
    assert plan.cost == pytest.approx(wanted, rel=2e-4)
    shade[8:20, 10:30] = 0.4
    moving.update(8, 10, shade[8:20, 10:30], layer="shade")
    fresh = planner()
    np.testing.assert_array_equal(*(bodies.poses_of(each).codes for each in (moving, fresh)))
    assert moving.plan(*ends).cost == fresh.plan(*ends).cost > plan.cost


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


def test_a_method_of_a_file_of_its_own_tells_its_bound_and_is_refused_for_a_body(monkeypatch):
    find = "nnpp_edge.runtime.planners.methods:Methods.search_map"
    entry = Entry("corridor", "within half", find, bound=1.5, robots=(CELLS,))
    monkeypatch.setitem(METHODS, "corridor", entry)
    dem = np.zeros((30, 40))
    point = DynamicPlanner.of_elevation(dem, SIDE, (24, 20), method="corridor")
    point.move((5, 5))
    plan = point.replan()
    assert plan.ok and plan.lower_bound == pytest.approx(plan.cost / 1.5)
    body = DynamicPlanner.of_elevation(dem, SIDE, (24, 20), vehicle=ROVER, method="corridor")
    body.move((5, 5))
    with pytest.raises(InvalidQueryError, match="'corridor' does not plan over states: wanted one"):
        body.replan()
