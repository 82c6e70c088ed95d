"""Lines that a body can follow: the check at any heading, and what a line is made of."""

import math

import numba
import numpy as np
import pytest

from nnpp_edge.runtime import Planner, Vehicle
from nnpp_edge.runtime.kernels import any_heading
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.planners.refine import BodyLines, Refiner
from nnpp_edge.runtime.terrain.vehicle import HEADINGS

VEHICLE = Vehicle(1.5, 1.2, 0.3)


@numba.njit
def pose_cost(body, row, col, ahead, sweep):
    under, contacts = any_heading.under_body(body), np.empty((2, len(body[1])))
    return any_heading.pose_cost(under, row, col, ahead, sweep, contacts)


def rocky(seed, side=60, cell_m=0.25):
    rng = np.random.default_rng(seed)
    heights = np.cumsum(rng.normal(0.0, 0.01, (side, side)), axis=1) * cell_m
    for row, col in rng.integers(0, side, (side // 5, 2)).tolist():
        heights[row : row + 2, col : col + 2] += rng.uniform(0.1, 0.5)
    return heights.astype(np.float32)


@pytest.mark.parametrize("heading", [1, 3])
def test_the_check_at_any_heading_is_that_of_the_grid_on_its_diagonals(heading):
    heights, sides = rocky(1), (0.25, 0.3)
    wanted = pose_costs(heights, sides[0], VEHICLE, cell_width_m=sides[1])[heading]
    planner = Planner.of_elevation(heights, sides[0], cell_width_m=sides[1], vehicle=VEHICLE, warn=False)
    step = np.array(HEADINGS[heading]) * sides
    length = float(np.hypot(*step))
    body = BodyLines(planner.state.grid).body
    for row in range(0, 60, 3):
        for col in range(0, 60, 2):
            for sign in (1.0, -1.0):
                ahead = tuple((sign * step / length).tolist())
                found = pose_cost(body, float(row), float(col), ahead, 0.5 * length)
                assert math.isinf(found) == math.isinf(wanted[row, col]), (row, col)
                if math.isfinite(found):
                    assert found == pytest.approx(wanted[row, col], abs=1e-4)


def test_every_leg_of_a_body_s_line_can_be_followed_at_no_higher_cost():
    lines = 0
    for seed in range(6):
        planner = Planner.of_elevation(rocky(seed), 0.25, vehicle=VEHICLE, warn=False)
        plan = planner.plan((8, 8), (50, 48), method="astar", refine="any-angle")
        if not plan.ok:
            continue
        refiner = Refiner(planner.state)
        assert tuple(plan.waypoints[0]) == (8, 8) and tuple(plan.waypoints[-1]) == (50, 48)
        assert refiner.cost(plan.waypoints) == pytest.approx(plan.line_cost, rel=1e-12)
        assert plan.line_cost <= refiner.cost(plan.path.astype(np.float64)) * (1.0 + 1e-9)
        lines += plan.line_cost < 0.99 * refiner.cost(plan.path.astype(np.float64))
    assert lines > 0


def test_between_its_poses_a_leg_keeps_the_limits_too():
    checked = 0
    for seed in range(6):
        planner = Planner.of_elevation(rocky(seed), 0.25, vehicle=VEHICLE, warn=False)
        plan = planner.plan((8, 8), (50, 48), method="astar", refine="any-angle")
        if not plan.ok:
            continue
        body = BodyLines(planner.state.grid).body
        for begin, end in zip(plan.waypoints[:-1], plan.waypoints[1:], strict=True):
            ahead = (end - begin) / np.hypot(*(end - begin))
            if np.isclose(np.abs(ahead), [[0.0, 1.0], [1.0, 0.0]]).all(1).any():
                continue  # along rows and columns the grid's check is another, see docs/vehicle.md
            for share in np.linspace(0.0, 1.0, 50):
                place = begin + share * (end - begin)
                assert math.isfinite(pose_cost(body, *place.tolist(), tuple(ahead.tolist()), 0.0))
                checked += 1
    assert checked
