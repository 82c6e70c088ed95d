"""What can be reached, and tours, where steps cost by the slope they lead up or down: against scipy's Dijkstra."""

import itertools

import numpy as np
import pytest

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.search.astar import cost_field, costs_to_nearest
from nnpp_edge.runtime.search.workspace import Workspace
from tests import directed_cases as cases
from tests.directed_cases import MOBILITY, MODELS, tolerance


def planner_of(case, step_cost):
    return Planner.of_elevation(
        case.dem,
        case.sides[0],
        case.limits,
        cell_width_m=case.sides[1],
        corner_cutting=case.corner_cutting,
        warn=False,
        step_cost=step_cost,
        mobility=MOBILITY,
    )


@pytest.mark.parametrize("step_cost", MODELS)
def test_reach_equals_dijkstras_field_on_the_directed_graph(step_cost):
    rng, model = np.random.default_rng(7), MOBILITY.model(step_cost)
    for _ in range(60):
        case = cases.hills(rng)
        planner, wanted = planner_of(case, step_cost), cases.dijkstra(case, model, case.start)
        found = planner.reach(case.start)
        assert np.array_equal(np.isfinite(found), np.isfinite(wanted))
        assert found == pytest.approx(wanted, rel=1e-5, abs=tolerance(case, model))
        finite = wanted[np.isfinite(wanted)]
        within = float(max(np.median(finite), 0.0)) + tolerance(case, model)
        assert np.array_equal(np.isfinite(planner.reach(case.start, within)), found <= within)


@pytest.mark.parametrize("step_cost", MODELS)
def test_the_best_order_of_a_directed_tour_is_that_of_all_orders_tried(step_cost):
    rng, model = np.random.default_rng(8), MOBILITY.model(step_cost)
    for _ in range(12):
        case = cases.hills(rng, least_side=6)
        cells = np.argwhere(np.isfinite(cases.dijkstra(case, model, case.start)))
        if len(cells) < 6:
            continue
        stops = [tuple(cell) for cell in cells[rng.choice(len(cells), 6, replace=False)].tolist()]
        between = [[cases.dijkstra(case, model, a)[b] for b in stops] for a in stops]
        best = min(
            sum(between[a][b] for a, b in zip((0, *order), (*order, 5), strict=True))
            for order in itertools.permutations(range(1, 5))
        )
        for method in ("astar", "corridor"):
            found = planner_of(case, step_cost).plan_via(
                stops[0], stops[-1], stops[1:-1], best_order=True, method=method
            )
            assert found.plan.cost == pytest.approx(
                cases.path_cost(found.plan.path, case, model), abs=tolerance(case, model)
            )
            assert found.plan.cost <= found.given_cost + tolerance(case, model)
            if method == "astar":
                assert found.plan.cost == pytest.approx(best, rel=1e-5, abs=5 * tolerance(case, model))


@pytest.mark.parametrize(("step_cost", "number"), [("time", "time_s"), ("energy", "energy_j")])
def test_what_a_plan_costs_is_the_number_along_its_way(step_cost, number):
    rng = np.random.default_rng(9)
    for _ in range(20):
        case = cases.hills(rng)
        plan = planner_of(case, step_cost).plan(case.start, case.goal, method="astar")
        if plan.ok:
            assert getattr(plan, number) == pytest.approx(plan.cost, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("step_cost", MODELS)
def test_directed_costs_to_the_nearest_stops_are_those_of_the_whole_field(step_cost):
    rng, model = np.random.default_rng(10), MOBILITY.model(step_cost)
    for _ in range(12):
        case = cases.hills(rng, least_side=6)
        grid = planner_of(case, step_cost).state.grid
        cells = np.argwhere(np.isfinite(cases.dijkstra(case, model, case.start)))
        stops = [tuple(cell) for cell in cells[rng.permutation(len(cells))[:6]].tolist()]
        workspace = Workspace(len(grid.weights))
        found, known = costs_to_nearest(grid, stops, 2, workspace)
        for at, stop in enumerate(stops[:-1]):
            wanted = cost_field(grid, stop, workspace)[tuple(np.transpose(stops))]
            assert found[at][known[at]] == pytest.approx(wanted[known[at]], abs=tolerance(case, model))
            assert (found[at] <= wanted + tolerance(case, model)).all() and known[at].sum() >= min(3, len(stops))
