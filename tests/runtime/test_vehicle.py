"""A vehicle's values, and the cells under it."""

import dataclasses
import itertools
import math
import random
import re

import numpy as np
import pytest

from nnpp_edge.runtime import Vehicle
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.terrain.vehicle import HEADINGS, footprint
from tests import pose_oracles
from tests.fuzz.bodies import draw_vehicle

PLAIN = {"length_m": 1.6, "width_m": 1.2, "clearance_m": 0.3}
SIDES = ((1.0, 1.0), (0.25, 0.25), (0.4, 0.3), (0.3, 0.5))


def vehicle(**changes):
    return Vehicle(**{**PLAIN, **changes})


def test_unlikely_bodies_are_bodies():
    assert Vehicle(length_m=240.0, width_m=40.0, clearance_m=9.0, turning_radius_m=90.0).reach_m > 100.0
    assert vehicle(clearance_m=3.0, max_tilt_deg=2.0, max_step_m=0.001).step_m == 0.001


def test_every_default_vehicle_that_can_be_has_its_wheels_under_it():
    for length, width in itertools.product((0.3, 0.5, 0.7, 1.1, 12.3), repeat=2):
        made = Vehicle(length_m=length, width_m=width, clearance_m=0.1)
        assert made.stance_m[0] + made.contact_m[0] <= length * (1 + 1e-9)
        assert made.stance_m[1] + made.contact_m[1] <= width * (1 + 1e-9)


def test_a_vehicle_is_frozen_and_compares_by_value():
    assert vehicle() == vehicle() != vehicle(axles=3)
    with pytest.raises(dataclasses.FrozenInstanceError):
        vehicle().length_m = 3.0


# --- the cells under it


def as_sets(wheels, belly):
    """Order does not matter; wheels are told apart by their cells."""
    return sorted(sorted(map(tuple, cells.tolist())) for cells in wheels), sorted(map(tuple, belly.tolist()))


def test_headings_are_those_of_the_eight_steps():
    steps = set(itertools.product((-1, 0, 1), repeat=2)) - {(0, 0)}
    assert {step for row, col in HEADINGS for step in ((row, col), (-row, -col))} == steps
    assert HEADINGS == pose_oracles.HEADINGS


def test_places_are_metres_ahead_and_aside():
    made = vehicle()
    for heading, (row, col) in enumerate(HEADINGS):
        found = footprint(made, heading, 0.4, 0.3)
        step = np.array((row * 0.4, col * 0.3))
        metres = found.belly * (0.4, 0.3)
        np.testing.assert_allclose(found.places[:, 0], metres @ step / np.hypot(*step), atol=1e-9)
        np.testing.assert_allclose(np.hypot(*found.places.T), np.hypot(*metres.T), atol=1e-9)


@pytest.mark.parametrize("sides", SIDES)
def test_a_footprint_bounds_the_ground_at_every_point_on_the_way(sides):
    """Bilinear ground is 0 wherever no cell of the footprint is higher: no point may feel another cell."""
    made, rng = draw_vehicle(random.Random(str(sides)), min(sides)), np.random.default_rng(1)
    for heading, (row, col) in enumerate(HEADINGS):
        found = footprint(made, heading, *sides)
        step = np.array((row, col)) * sides
        ahead = step / np.hypot(*step)
        right = pose_oracles.right_of(ahead)
        parts = [(found.belly, np.zeros(2), made.length_m / 2, made.width_m / 2, 0.5)]
        long, wide = made.contact_m
        at_rest = 0.5 if row and col else 0.0
        for x, y in made.wheels_m:
            middle = x * ahead + y * right
            # which of the wheels of a pair comes first does not matter
            cells = min(found.wheels, key=lambda each: np.hypot(*((each * sides).mean(0) - middle)))
            parts.append((cells, middle, long / 2, wide / 2, at_rest))
        for cells, middle, half_long, half_wide, share in parts:
            known = set(map(tuple, cells.tolist()))
            points = rng.uniform(-1.0, 1.0, (300, 3)) * (half_long, half_wide, share)
            for along, aside, moved in points:
                place = np.round((middle + along * ahead + aside * right + moved * step) / sides, 9)
                first = np.floor(place).astype(int)
                near = {
                    (first[0] + i, first[1] + j)
                    for i, j in itertools.product((0, 1), repeat=2)
                    if abs(place[0] - first[0] - i) < 1.0 and abs(place[1] - first[1] - j) < 1.0
                }
                assert {(int(i), int(j)) for i, j in near} <= known


def test_what_is_not_given_is_taken_from_the_others_and_what_is_given_is_taken():
    made = vehicle()
    assert (made.contact_m, made.step_m, made.tilts_deg) == ((0.2, 0.15), 0.3, (25.0, 25.0, 25.0))
    assert made.stance_m == pytest.approx((1.4, 1.05)) and made.reach_m == pytest.approx(1.0)
    limits = {"max_tilt_deg": 30.0, "max_pitch_deg": 20.0, "max_roll_deg": 10.0, "max_step_m": 0.1}
    wheels = {"wheel_length_m": 0.3, "wheel_width_m": 0.1, "wheelbase_m": 1.0, "track_m": 0.8}
    made = vehicle(**limits, **wheels)
    assert (made.contact_m, made.stance_m, made.step_m) == ((0.3, 0.1), (1.0, 0.8), 0.1)
    assert made.tilts_deg == (20.0, 10.0, 30.0)
    assert vehicle(wheel_length_m=0.4, wheel_width_m=0.2).stance_m == pytest.approx((1.2, 1.0))
    assert vehicle(wheelbase_m=1.4, wheel_length_m=0.2).stance_m[0] == 1.4  # at the very edge
    assert vehicle(track_m=1.1, wheel_width_m=0.1).stance_m[1] == 1.1


def test_wheels_stand_in_pairs_evenly_over_the_wheelbase():
    for axles in range(2, 9):
        wheels = vehicle(axles=axles, wheelbase_m=1.2, track_m=0.8).wheels_m
        assert wheels.shape == (2 * axles, 2)
        ahead = sorted({round(x, 9) for x, _ in wheels})
        np.testing.assert_allclose(ahead, [-0.6 + 1.2 * at / (axles - 1) for at in range(axles)], atol=1e-9)
        assert {(round(x, 9), round(y, 9)) for x, y in wheels} == {(x, y) for x in ahead for y in (-0.4, 0.4)}


def test_a_bad_value_is_named_in_one_line():
    lengths = ("length_m", "width_m", "clearance_m", "max_step_m", "wheelbase_m", "track_m")
    angles = ("max_tilt_deg", "max_pitch_deg", "max_roll_deg")
    for names, values in (
        ((*lengths, "wheel_length_m", "wheel_width_m"), (0.0, -0.1, math.inf, -math.inf, math.nan)),
        (angles, (0.0, -5.0, 90.0, 91.0, math.inf, math.nan)),
        (("axles",), (0, 1, 9, -2, 2.5, 3.0, math.nan, True)),
    ):
        for name, value in itertools.product(names, values):
            with pytest.raises(InvalidMapError) as told:
                vehicle(**{name: value})
            assert name in str(told.value) and str(value) in str(told.value) and "\n" not in str(told.value)


def test_a_value_in_another_unit_is_refused_with_the_unit_that_is_wanted():
    large = {"length_m": 1600.0, "width_m": 1200.0, "clearance_m": 300.0}
    for values, told in (
        ({"clearance_m": 400.0}, "clearance_m must be in metres, at most 4.8 for such a vehicle, got 400 (0.4 m if"),
        ({"max_step_m": 150.0}, "max_step_m must be in metres"),
        ({"turning_radius_m": 2000.0}, "turning_radius_m must be in metres, at most 160"),
        (large, "length_m must be in metres, at most 250"),
        ({"width_m": 120.0}, "width_m must be in metres, at most 80"),
        ({"max_tilt_deg": 0.5236}, "max_tilt_deg must be in degrees, above 1.57, got 0.5236 (30° if that is in rad"),
        ({"max_roll_deg": 0.35}, "max_roll_deg must be in degrees"),
        ({"max_pitch_deg": math.pi / 2}, "max_pitch_deg must be in degrees"),
        ({"wheelbase_m": 1.7}, "the wheels must lie under the body: "),
        ({"wheelbase_m": 1.5, "wheel_length_m": 0.2}, "the wheels must lie under the body: "),
        ({"wheel_length_m": 1.7}, "the wheels must lie under the body: "),
        ({"track_m": 1.3}, "the wheels must lie under the body: "),
        ({"track_m": 1.1, "wheel_width_m": 0.2}, "the wheels must lie under the body: "),
    ):
        with pytest.raises(InvalidMapError, match=re.escape(told)):
            vehicle(**values)
    for values in ({"radius_m": 400.0}, {"radius_m": 0.3, "turning_radius_m": 500.0}):
        with pytest.raises(InvalidMapError, match="must be in metres"):
            Vehicle(**values)


def test_footprints_hold_the_cells_that_clipped_polygons_touch_and_no_other_alike_both_ways():
    for seed, sides in itertools.product(range(8), SIDES):
        check_footprints(draw_vehicle(random.Random(seed), min(sides)), sides)
    for changes in ({}, {"length_m": 2.0, "width_m": 1.0, "wheel_length_m": 0.5, "axles": 3}):
        check_footprints(vehicle(**changes), (0.25, 0.25))  # of sizes that meet the cells' edges


def check_footprints(made, sides):
    for heading in range(4):
        found, wanted = footprint(made, heading, *sides), pose_oracles.Body.of(made, heading, *sides)
        assert as_sets(found.wheels, found.belly) == as_sets(wanted.wheels, wanted.belly)
        assert found.half_step == pytest.approx(wanted.half_step)
        turned = [-cells for cells in found.wheels], -found.belly
        assert as_sets(*turned) == as_sets(found.wheels, found.belly)
