"""The oracles of a body can fail, and agree with each other."""

import dataclasses
import math

import numpy as np
import pytest

from nnpp_edge.runtime import Vehicle
from tests import pose_oracles

BODY = Vehicle(
    length_m=2.2,
    width_m=1.7,
    clearance_m=0.3,
    max_pitch_deg=20.0,
    max_roll_deg=15.0,
    max_tilt_deg=22.0,
    wheel_length_m=0.001,
    wheel_width_m=0.001,
)
"""On wheels that touch the ground at points: on a plane the body has its inclination, and no more."""
ALONG_ROW = [(8, 6), (8, 7), (8, 8), (8, 9)]
DIAGONAL = [(6, 6), (7, 7), (8, 8)]


def slope(down, right):
    row, col = np.mgrid[:17, :17]
    return row * math.tan(math.radians(down)) + col * math.tan(math.radians(right))


FLAT = slope(0, 0)


def with_cell(height, ground=FLAT):
    ground = ground.copy()
    ground[8, 8] = height
    return ground


def broken(ground, path, body=BODY, **options):
    found = pose_oracles.drive_breaks(ground, 1.0, body, path, **options)
    return found and found.limit


def test_a_drive_that_breaks_a_limit_is_seen_and_others_are_not():
    for path in (ALONG_ROW, ALONG_ROW[::-1], DIAGONAL, DIAGONAL[::-1], [(8, 8)]):
        assert broken(FLAT, path) is None
    for angles in ((0, 19.9), (14.9, 0), (13, 18)):
        assert broken(slope(*angles), ALONG_ROW) is None
    wide = Vehicle(length_m=2.2, width_m=4.0, clearance_m=0.3)
    long = Vehicle(length_m=4.4, width_m=2.0, clearance_m=2.0, max_step_m=0.2, wheel_length_m=1.0)
    small = Vehicle(length_m=0.2, width_m=0.2, clearance_m=0.02, max_tilt_deg=10.0)
    kerb, low_kerb = (np.where(np.arange(17) >= 9, height, FLAT) for height in (0.25, 0.19))
    for limit, ground, path, body in (
        ("pitch", slope(0, 21), ALONG_ROW, BODY),
        ("roll", slope(16, 0), ALONG_ROW, BODY),
        ("roll", slope(0, -16), [(8, 8), (9, 8)], BODY),
        ("tilt", slope(14, 19), ALONG_ROW, BODY),
        ("unknown", np.full((17, 17), np.nan), ALONG_ROW, BODY),
        ("unknown", FLAT, [(8, col) for col in range(8, 17)], BODY),
        (None, with_cell(0.29), ALONG_ROW, wide),  # a rock between the wheels, where the belly meets it or not
        ("clearance", with_cell(0.31), ALONG_ROW, wide),
        ("step", kerb, ALONG_ROW, long),  # under one contact patch
        (None, low_kerb, ALONG_ROW, long),
        ("unknown", with_cell(np.nan), ALONG_ROW, BODY),
        (None, with_cell(np.nan), ALONG_ROW, dataclasses.replace(BODY, unknown_passes=True)),
        ("pitch", with_cell(-0.5), [(8, 6), (8, 7)], small),  # a hole that only places in between see
    ):
        assert broken(ground, path, body) == limit
    assert broken(with_cell(0.31), ALONG_ROW, wide, margin_m=0.02) is None
    assert 0.3 < pose_oracles.drive_breaks(with_cell(0.31), 1.0, wide, ALONG_ROW).value <= 0.31 + 1e-9


def test_the_cells_near_a_point_are_the_four_around_it():
    def near(middle, ahead, half):
        return pose_oracles.cells_near(middle, ahead, (half, half), 1.0, 1.0)

    assert near((0.5, 0.25), (1.0, 0.0), 0.01) == {(0, 0), (0, 1), (1, 0), (1, 1)}
    assert near((0.0, 0.0), (0.0, 1.0), 1e-12) == {(0, 0)}
    assert near((0.0, 0.5), (0.0, 1.0), 1e-12) == {(0, 0), (0, 1)}
    diamond = near((0.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5)), 0.72)
    assert (1, 1) in diamond and (2, 1) in diamond and (2, 2) not in diamond


def test_poses_on_a_plane_cost_its_tilt_rounded_up_by_a_part_in_65533_at_most():
    found = pose_oracles.naive_pose_costs(0.25 * slope(3, 4), 0.25, BODY)[:, 8, 8]
    tilt = math.atan(math.hypot(math.tan(math.radians(3)), math.tan(math.radians(4))))
    assert (found > 0.6 * tilt / math.radians(22.0)).all() and (found < 1.0).all()
    np.testing.assert_array_equal(pose_oracles.naive_pose_costs(FLAT, 1.0, BODY)[:, 4:-4, 4:-4], 0.0)
    for passes in (False, True):
        body = dataclasses.replace(BODY, unknown_passes=passes)
        assert np.isfinite(pose_oracles.naive_pose_costs(with_cell(np.nan), 1.0, body)[2, 8, 8]) == passes
    costs = np.random.default_rng(0).random(1000)
    coded = pose_oracles.coded(costs)
    assert ((coded >= costs) & (coded < costs + 1.0 / 65533)).all()
    assert pose_oracles.coded([0.0, np.inf]).tolist() == [0.0, np.inf]


def test_paths_cost_the_poses_of_both_ends_in_the_steps_heading():
    costs = np.full((4, 3, 3), 0.5)
    costs[2, 1] = (0.0, 0.25, 0.5)
    assert pose_oracles.path_cost_over_poses(costs, [(1, 0), (1, 1)], 2.0) == 1.5
    assert pose_oracles.path_cost_over_poses(costs, [(2, 0), (1, 1)], 2.0) == pytest.approx(math.sqrt(2) + 2.0)
    assert pose_oracles.dijkstra_over_poses(costs, (1, 2), (1, 0), 2.0) == 4.0
    costs[2, 1, 1] = np.inf
    assert math.isinf(pose_oracles.path_cost_over_poses(costs, [(1, 0), (1, 1)], 2.0))
    assert pose_oracles.dijkstra_over_poses(costs, (1, 2), (1, 0), 2.0) == pytest.approx(2 * math.sqrt(2) + 4.0)
    costs[:, 1, 1] = costs[:, 0] = costs[:, 2] = np.inf
    assert math.isinf(pose_oracles.dijkstra_over_poses(costs, (1, 2), (1, 0), 2.0))
    assert pose_oracles.dijkstra_over_poses(costs, (1, 2), (1, 2), 2.0) == 0.0


def test_headings_go_clockwise_from_north():
    path = [(5, 5), (4, 5), (3, 6), (3, 7), (4, 8), (5, 8), (6, 7), (6, 6), (5, 5)]
    assert pose_oracles.headings_of(path).tolist() == [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]
