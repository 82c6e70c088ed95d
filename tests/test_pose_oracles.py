"""The oracles of a body can fail, and agree with each other."""

import dataclasses
import math

import numpy as np

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
"""On wheels that touch the ground at points: on a plane the body has its inclination, and
no more.
"""
ALONG_ROW = (8, 6), (8, 9)
DIAGONAL = (6, 6), (8, 8)


def slope(down, right):
    row, col = np.mgrid[:17, :17]
    return row * math.tan(math.radians(down)) + col * math.tan(math.radians(right))


FLAT = slope(0, 0)


def with_cell(height, ground=FLAT):
    ground = ground.copy()
    ground[8, 8] = height
    return ground


def broken(ground, ends, body=BODY):
    """What a drive straight from one cell to another breaks first."""
    ahead = np.subtract(*ends[::-1])
    places = np.linspace(*ends, 10 * abs(ahead).max() + 1)
    headings = np.full(len(places), math.atan2(ahead[1], ahead[0]))
    return pose_oracles.breaks_at(ground, 1.0, body, places, headings)


def test_a_drive_that_breaks_a_limit_is_seen_and_others_are_not():
    for ends in (ALONG_ROW, ALONG_ROW[::-1], DIAGONAL, DIAGONAL[::-1]):
        assert broken(FLAT, ends) is None
    for angles in ((0, 19.9), (14.9, 0), (13, 18)):
        assert broken(slope(*angles), ALONG_ROW) is None
    wide = Vehicle(length_m=2.2, width_m=4.0, clearance_m=0.3)
    long = Vehicle(length_m=4.4, width_m=2.0, clearance_m=2.0, max_step_m=0.2, wheel_length_m=1.0)
    small = Vehicle(length_m=0.2, width_m=0.2, clearance_m=0.02, max_tilt_deg=10.0)
    kerb, low_kerb = (np.where(np.arange(17) >= 9, height, FLAT) for height in (0.25, 0.19))
    for limit, ground, ends, body in (
        ("pitch", slope(0, 21), ALONG_ROW, BODY),
        ("roll", slope(16, 0), ALONG_ROW, BODY),
        ("roll", slope(0, -16), ((8, 8), (9, 8)), BODY),
        ("tilt", slope(14, 19), ALONG_ROW, BODY),
        ("unknown", np.full((17, 17), np.nan), ALONG_ROW, BODY),
        ("unknown", FLAT, ((8, 8), (8, 16)), BODY),
        (
            None,
            with_cell(0.29),
            ALONG_ROW,
            wide,
        ),  # a rock between the wheels, where the belly meets it or not
        ("belly", with_cell(0.31), ALONG_ROW, wide),
        ("step", kerb, ALONG_ROW, long),  # under one contact patch
        (None, low_kerb, ALONG_ROW, long),
        ("unknown", with_cell(np.nan), ALONG_ROW, BODY),
        (None, with_cell(np.nan), ALONG_ROW, dataclasses.replace(BODY, unknown_passes=True)),
        (
            "pitch",
            with_cell(-0.5),
            ((8, 6), (8, 7)),
            small,
        ),  # a hole that only places in between see
    ):
        found = broken(ground, ends, body)
        assert (found and found.limit) == limit
    assert 0.3 < broken(with_cell(0.31), ALONG_ROW, wide).value <= 0.31 + 1e-9
