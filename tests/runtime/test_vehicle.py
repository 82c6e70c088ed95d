"""A vehicle's values, and a disc, of which a radius alone is known."""

import itertools
import math
import re

import numpy as np
import pytest

from nnpp_edge.runtime import (
    Ground,
    Planner,
    Traversability,
    Vehicle,
    pose_costs,
)
from nnpp_edge.runtime.errors import InvalidMapError, Status
from tests.tables import cases, keywords

PLAIN = {"length_m": 1.6, "width_m": 1.2, "clearance_m": 0.3}


def vehicle(**changes):
    return Vehicle(**{**PLAIN, **changes})


def test_unlikely_bodies_are_bodies_and_stand_on_their_wheels():
    assert Vehicle(length_m=240.0, width_m=40.0, clearance_m=9.0).reach_m > 100.0
    assert vehicle(clearance_m=3.0, max_tilt_deg=2.0, max_step_m=0.001).step_m == 0.001
    for length, width in itertools.product((0.3, 0.5, 0.7, 1.1, 12.3), repeat=2):
        made = Vehicle(length_m=length, width_m=width, clearance_m=0.1)
        assert made.stance_m[0] + made.contact_m[0] <= length * (1 + 1e-9)
        assert made.stance_m[1] + made.contact_m[1] <= width * (1 + 1e-9)


def test_what_is_not_given_is_taken_from_the_others_and_what_is_given_is_taken():
    made = vehicle()
    assert (made.contact_m, made.step_m, made.tilts_deg) == ((0.2, 0.15), 0.3, (25.0, 25.0, 25.0))
    assert made.stance_m == pytest.approx((1.4, 1.05)) and made.reach_m == pytest.approx(1.0)
    limits = {"max_tilt_deg": 30.0, "max_pitch_deg": 20.0, "max_roll_deg": 10.0, "max_step_m": 0.1}
    wheels = {"wheel_length_m": 0.3, "wheel_width_m": 0.1, "wheelbase_m": 1.0, "track_m": 0.8}
    made = vehicle(**limits, **wheels)
    assert (made.contact_m, made.stance_m, made.step_m) == ((0.3, 0.1), (1.0, 0.8), 0.1)
    assert made.tilts_deg == (20.0, 10.0, 30.0)
    assert (
        made.turn_m_per_rad == pytest.approx(0.5 * math.hypot(1.0, 0.8))
        and vehicle(turn_cost_m_per_rad=0.0).turn_m_per_rad == 0.0
    )
    assert vehicle(wheel_length_m=0.4, wheel_width_m=0.2).stance_m == pytest.approx((1.2, 1.0))
    assert vehicle(wheelbase_m=1.4, wheel_length_m=0.2).stance_m[0] == 1.4  # at the very edge
    assert vehicle(track_m=1.1, wheel_width_m=0.1).stance_m[1] == 1.1


def test_wheels_stand_in_pairs_evenly_over_the_wheelbase():
    for axles in range(2, 9):
        wheels = vehicle(axles=axles, wheelbase_m=1.2, track_m=0.8).wheels_m
        wanted = itertools.product(np.linspace(-0.6, 0.6, axles), (-0.4, 0.4))
        np.testing.assert_allclose(sorted(map(tuple, wheels)), list(wanted), atol=1e-9)


def test_of_a_bodys_limits_and_hard_limits_of_the_ground_the_stricter_one_counts():
    flat = np.zeros((40, 40))

    def body_under(limits, **changes):
        return Ground.of_elevation(flat, 1.0, limits, vehicle=vehicle(**changes)).vehicle

    limits = Traversability(hard_slope_deg=20.0, hard_gradient_deg=15.0)
    assert body_under(limits, max_roll_deg=10.0).tilts_deg == (15.0, 10.0, 15.0)
    assert body_under(Traversability(hard_slope_deg=60.0)) == vehicle()
    assert body_under(None, max_tilt_deg=40.0) == vehicle(max_tilt_deg=40.0)
    shut = Ground.of_elevation(flat, 1.0, limits, vehicle=vehicle())
    assert shut.limits == Traversability()  # cells by themselves shut nothing
    with pytest.raises(InvalidMapError, match="wanted the body's own max_step_m and clearance_m"):
        body_under(Traversability(hard_step_m=0.1))


def test_a_reserve_takes_its_share_off_every_limit():
    rng = np.random.default_rng(4)
    dem = np.cumsum(rng.normal(0.0, 0.05, (30, 30)), 0) + rng.normal(0.0, 0.02, (30, 30))
    given = {"max_tilt_deg": 20.0, "max_pitch_deg": 15.0, "max_roll_deg": 12.0, "max_step_m": 0.1}
    less = {name: 0.7 * value for name, value in (given | {"clearance_m": 0.3}).items()}
    reserved = pose_costs(dem, 0.3, vehicle(**given, reserve=0.3))
    np.testing.assert_array_equal(reserved, pose_costs(dem, 0.3, vehicle(**less)))
    assert (reserved < 1.0).any() and (reserved == np.inf).any()


OTHER_UNITS = """
clearance_m=400.0 | clearance_m must be in metres, above 0 and at most 4.8 for such a vehicle, got 4
max_step_m=150.0 | max_step_m must be in metres
turns_on_spot=False | a body that turns on the spot alone drives no arcs: wanted a turning_radius_m
reverse_cost=2.0 | drives no arcs: wanted a turning_radius_m
turning_radius_m=2.0, reverse_cost=0.5 | reverse_cost must be a number of at least 1, got 0.5
turning_radius_m=2000.0 | turning_radius_m must be in metres, above 0 and at most 160
turning_radius_m=2.0, gear_change_m=-1.0 | gear_change_m must be a number of metres from 0 to
length_m=1600.0, width_m=1200.0, clearance_m=300.0 | length_m must be in metres, above 0 and at most 250
width_m=120.0 | width_m must be in metres, above 0 and at most 80
max_tilt_deg=0.5236 | max_tilt_deg must be in degrees, above 1.57 (else radians) and below 90, got 0
max_roll_deg=0.35 | max_roll_deg must be in degrees
max_pitch_deg=1.5707963267948966 | max_pitch_deg must be in degrees
wheelbase_m=1.7 | the wheels must lie under the body:
wheelbase_m=1.5, wheel_length_m=0.2 | the wheels must lie under the body:
wheel_length_m=1.7 | the wheels must lie under the body:
track_m=1.3 | the wheels must lie under the body:
track_m=1.1, wheel_width_m=0.2 | the wheels must lie under the body:
"""


@pytest.mark.parametrize(("values", "told"), cases(OTHER_UNITS))
def test_a_value_in_another_unit_is_refused_with_the_unit_that_is_wanted(values, told):
    with pytest.raises(InvalidMapError, match=re.escape(told)):
        vehicle(**keywords(values))


DISC = Vehicle(radius_m=1.2)
CELL_M = 0.5


def costs(seed=0, side=40, share=0.004):
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0.1, 0.6, (side, side)).astype(np.float32)
    cost[rng.random(cost.shape) < share] = math.inf
    return cost


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


def test_a_disc_keeps_its_distance_on_cells_and_between_them():
    """Of every step that there is, by the distance from each obstacle's square."""
    for seed, (radius, dy, dx) in enumerate(
        ((0.55, 1.0, 1.0), (1.3, 1.0, 1.0), (1.5, 1.0, 1.0), (0.9, 0.5, 0.8))
    ):
        cost = costs(seed, share=0.01)
        planner = Planner(
            Ground(cost, cell_size_m=dy, cell_width_m=dx, vehicle=Vehicle(radius_m=radius))
        )
        passable = np.isfinite(planner.state.grid.map())
        obstacles = np.argwhere(~(np.pad(cost, 1, constant_values=2.0) < 1.0)) - 1
        for step in ((0, 1), (1, 0), (1, 1), (1, -1)):
            begin = np.argwhere(passable & np.roll(passable, np.negative(step), (0, 1)))
            begin = begin[((begin + step >= 0) & (begin + step < cost.shape)).all(1)]
            for share in (0.0, 0.25, 0.5, 0.75):
                apart = np.abs(obstacles - (begin + share * np.array(step))[:, None]) - 0.5
                near = np.hypot(*np.moveaxis(np.maximum(apart, 0.0) * (dy, dx), 2, 0)).min()
                assert len(begin) > 50 and near >= radius * (1.0 - 1e-6)
