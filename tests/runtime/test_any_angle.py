"""Paths freed from the grid: what they cost, and what they keep clear of."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nnpp_edge.runtime import DynamicPlanner, Ground, Planner, Vehicle
from nnpp_edge.runtime.arrays import curvatures
from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.kernels import records
from nnpp_edge.runtime.kernels.any_angle import NO_DISC, cost_along, ground_of
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.planners.refine import refined
from nnpp_edge.runtime.terrain.step_cost import StepModel
from tests import oracles
from tests.strategies import Case, cases, flat, uniform


@kernel
def line_cost(grid: records.GridRecord, room: records.Room, points):
    """The line integral along way points (N, 2); inf if a leg is not clear."""
    return cost_along(ground_of(grid, room), points)


def crossed(points, closed):
    """Cells, (row, col), that legs meet: their closed squares, or only the inside of them. Exact,
    by fractions.
    """
    found = set()
    for a, b in itertools.pairwise(points.tolist()):
        around = (
            range(math.floor(min(each)) - 1, math.ceil(max(each)) + 2)
            for each in zip(a, b, strict=True)
        )
        begin, end = (tuple(map(Fraction, each)) for each in (a, b))
        cells = itertools.product(*around)
        found |= {cell for cell in cells if meets(begin, end, cell, closed)}
    return found


def meets(a, b, cell, closed):
    """Whether the line from a to b meets the square of a cell."""
    first = Fraction(0)
    last = Fraction(1)
    for begin, end, middle in zip(a, b, cell, strict=True):
        half = (
            Fraction(1, 2) if closed else Fraction(1, 2) - Fraction(1, 1 << 40)
        )  # of points that are rounded
        low = middle - half
        high = middle + half
        if begin == end:
            if not (low <= begin <= high if closed else low < begin < high):
                return False
            continue
        one, other = sorted(((low - begin) / (end - begin), (high - begin) / (end - begin)))
        first = max(first, one)
        last = min(last, other)
    return first <= last if closed else first < last


@given(cases(most_side=20))
@example(
    Case(
        np.array([[9, 0, 0, 0, 0.75], [0.75, 0, 9, 0.75, 9]], np.float32),
        (1, 3),
        (0, 1),
        "paper",
        True,
    )
)
def test_a_line_costs_no_more_than_the_path_by_the_same_integral_and_meets_nothing_impassable(case):
    planner = Planner(case.cost, step_cost=case.step_cost, corner_cutting=case.corner_cutting)
    plan = planner.plan(case.start, case.goal, method="astar", refine="any-angle")
    plain = planner.plan(case.start, case.goal, method="astar")
    assert (plan.status, plan.cost) == (plain.status, plain.cost) and (
        plan.path == plain.path
    ).all()
    assert (plan.waypoints is None) == (not plan.ok)
    if plan.ok:
        packed = planner.state.grid.packed
        on_grid = line_cost(packed, NO_DISC, plan.path.astype(np.float64))
        assert plan.line_cost <= on_grid * (1.0 + 1e-12)
        assert plan.line_cost == pytest.approx(line_cost(packed, NO_DISC, plan.waypoints))
        assert (tuple(plan.waypoints[0]), tuple(plan.waypoints[-1])) == (case.start, case.goal)
        passable = (case.cost < 1.0) | ((case.step_cost == "length") & np.isfinite(case.cost))
        assert crossed(plan.waypoints, not case.corner_cutting) <= set(
            map(tuple, np.argwhere(passable).tolist())
        )


@settings(max_examples=25)
@given(st.integers(0, 2**32), st.sampled_from(["paper", "length"]))
def test_the_integral_is_that_of_a_bilinear_density(seed, step_cost):
    rng = np.random.default_rng(seed)
    cost = (0.05 + 0.9 * rng.random((12, 15))).astype(np.float32)
    cost[rng.random(cost.shape) < 0.1] = np.inf
    grid = Grid.of(cost, StepModel.of(step_cost))
    points = rng.random((4, 2)) * (11.0, 14.0)
    found = line_cost(grid.packed, NO_DISC, points)
    assert math.isinf(found) == bool([c for c in crossed(points, True) if not np.isfinite(cost[c])])
    if math.isfinite(found):
        assert found == pytest.approx(oracles.line_cost(points, cost, step_cost, 20_000), rel=1e-5)


def test_on_even_ground_the_line_is_straight():
    for step_cost in ("paper", "length"):
        planner = Planner(flat(60, 90, 0.3), step_cost=step_cost)
        plan = planner.plan((3, 5), (41, 86), refine="any-angle")
        per_cell = 1.0 + 2.0 * 255 * 0.011 * 0.3 if step_cost == "paper" else 0.3
        assert plan.line_cost == pytest.approx(per_cell * math.hypot(38, 81), rel=1e-4)
        assert len(plan.waypoints) <= 6
        assert plan.waypoint_headings_deg == pytest.approx(
            math.degrees(math.atan2(81, -38)), abs=2.0
        )


def test_curvature_is_that_of_the_widest_arc_that_fits():
    corner = np.array([[0.0, 0.0], [0.0, 10.0], [6.0, 10.0]])
    assert 1.0 / curvatures(corner).max() == pytest.approx(3.0)  # touches 3 cells from the corner
    assert curvatures(corner[:1]).tolist() == [0.0]


def test_a_dynamic_planner_frees_every_plan_on_the_newest_map():
    cost = flat(40, 60, 0.2)
    planner = DynamicPlanner(cost, (35, 55), "dstar", refine="any-angle")
    planner.move((3, 4))
    first = planner.replan()
    planner.update(0, 25, np.ones((36, 1)))
    second = planner.replan()
    around = (math.hypot(33, 21) + math.hypot(1, 30)) / math.hypot(32, 51)
    assert second.line_cost == pytest.approx(around * first.line_cost, rel=0.02)
    assert not {cell for cell in crossed(second.waypoints, False) if cell[1] == 25 and cell[0] < 36}
    planner.move((35, 55))
    at_goal = planner.replan()
    assert at_goal.waypoints.tolist() == [[35.0, 55.0]] and at_goal.line_cost == 0.0
    rest = planner.refined(second)
    assert rest.line_cost == second.line_cost


@settings(max_examples=25)
@given(st.integers(0, 2**32), st.sampled_from([0.5, 1.0]), st.sampled_from([1.0, 0.8]))
def test_a_discs_line_keeps_its_radius_from_obstacles(seed, size, wider):
    rng = np.random.default_rng(seed)
    shape = rng.integers(20, 60, 2)
    sides = size, size * wider
    cost = rng.uniform(0.0, rng.choice((0.9, 0.2)), shape).astype(np.float32)
    for row, col, high, wide in rng.integers((0, 0, 1, 1), (*shape, 4, 4), (rng.integers(16), 4)):
        cost[row : row + high, col : col + wide] = np.inf
    blocked = np.argwhere(np.pad(np.isinf(cost), 1, constant_values=True)) - 1
    radius = size * rng.uniform(0.3, 2.2)
    ground = Ground(cost, cell_size_m=size, cell_width_m=sides[1], vehicle=Vehicle(radius_m=radius))
    planner = Planner(ground)
    for start, goal in rng.integers(3, shape - 3, (8, 2, 2)).tolist():
        ends = tuple(start), tuple(goal)
        plan = planner.plan(*ends, refine="any-angle")
        for leg in itertools.pairwise(plan.waypoints if plan.ok else ()):
            places = np.linspace(*leg, 2 + int(16 * math.dist(*leg)))
            apart = np.maximum(np.abs(places[:, None] - blocked) - 0.5, 0.0) * sides
            assert np.hypot(*apart.T).min() >= 0.99999 * radius, ends


def test_at_the_deadline_the_line_is_what_was_found():
    cost = uniform(6, (80, 90)) * np.float32(0.9)
    planner = Planner(cost)
    plan = planner.plan((3, 4), (74, 81), method="astar")
    late = refined(plan, planner.state, Deadline(0.0))
    whole = refined(plan, planner.state)
    on_grid = line_cost(planner.state.grid.packed, NO_DISC, plan.path.astype(np.float64))
    assert whole.line_cost < late.line_cost <= on_grid * (1.0 + 1e-12)


def test_lines_of_elevations_computed_where_somebody_looks_are_those_of_all():
    dem = np.cumsum(np.random.default_rng(3).normal(0.0, 0.4, (150, 170)), axis=1).astype(
        np.float32
    )
    planners = [Planner.of_elevation(dem, 1.0, lazy=lazy, warn=False) for lazy in (True, False)]
    plans = [
        each.plan((4, 5), (140, 160), method="corridor", refine="any-angle") for each in planners
    ]
    assert plans[0].line_cost == pytest.approx(plans[1].line_cost, rel=1e-9)
