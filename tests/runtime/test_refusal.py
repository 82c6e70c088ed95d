"""Why a body stands nowhere or gets no farther: named is the limit that the ground was made to
break.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Planner, Vehicle
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT, FAILS, REFUSALS
from nnpp_edge.runtime.robots.body.refusal import refusals
from tests.strategies import flat

ROVER = Vehicle(
    length_m=1.2,
    width_m=0.9,
    clearance_m=0.3,
    max_tilt_deg=20.0,
    max_step_m=0.2,
    wheel_length_m=0.3,
)
CELL_M = 0.3
UNKNOWN = "unknown ground, an obstacle or the map's edge lies below it"


def across(heights):
    """Ground (40, 48) of the same heights in each row."""
    return np.repeat(np.asarray(heights, np.float32)[None], 40, axis=0)


TRENCH = np.where(np.arange(48) == 24, np.nan, 0.0)
STEEP = np.clip(np.arange(48) - 20, 0, 9) * CELL_M * math.tan(math.radians(28.0))
STEP = 0.25 * (np.arange(48) >= 24)
STONES = across(np.zeros(48))
STONES[::2, 24] = 0.36


@pytest.mark.parametrize(
    ("ground", "changes", "limit", "words"),
    [
        (across(TRENCH), {}, "unknown", UNKNOWN),
        (across(STEEP), {}, "tilt", "it tilts by up to 2.*°, and max_tilt_deg is 20"),
        (
            across(STEEP),
            {"max_tilt_deg": 40, "max_pitch_deg": 10},
            "pitch",
            "it pitches by up to .* max_pitch_deg is 10",
        ),
        (
            across(STEP),
            {},
            "step",
            "heights under a wheel differ by up to 0.2.* m, and max_step_m is 0.2",
        ),
        (
            across(STEP),
            {"max_step_m": None, "clearance_m": 0.2},
            "step",
            "under a wheel .* and clearance_m is 0.2",
        ),
        (
            STONES,
            {"max_step_m": 0.5},
            "belly",
            "above the plane of its wheels, and clearance_m is 0.3",
        ),
    ],
)
def test_without_a_path_the_limit_that_refuses_is_named(ground, changes, limit, words):
    vehicle = replace(ROVER, **changes)
    dynamic = DynamicPlanner.of_elevation(ground, CELL_M, (20, 40), vehicle=vehicle)
    dynamic.move((20, 8))
    for plan in (
        Planner.of_elevation(ground, CELL_M, vehicle=vehicle).plan((20, 8), (20, 40)),
        dynamic.replan(),
    ):
        assert plan.status == "NO_PATH"
        told = re.fullmatch(
            r"no path exists on the known map; the search from the goal got to \(20, (\d+)\), "
            r"(\d+) cells from the "
            rf"start\. Near there (\d+) of (\d+) refused steps fail by {limit}, such as from "
            rf"\(\d+, \1\) .*{words}",
            plan.reason,
        )
        assert told, plan.reason
        assert int(told[1]) - int(told[2]) == 8 and 0 < int(told[3]) <= int(told[4])


def test_where_the_body_cannot_turn_into_the_way_on_that_is_said():
    crossing = flat(61, 61, np.nan)
    crossing[27:34] = crossing[:, 27:34] = 0.0
    planner = Planner.of_elevation(
        crossing, CELL_M, vehicle=replace(ROVER, length_m=3.0, width_m=0.6)
    )
    assert planner.plan((30, 10), (30, 50)).ok and planner.plan((10, 30), (50, 30)).ok
    reason = planner.plan((30, 10), (50, 30)).reason
    assert "; the search from the start got to (30, 30), 20 cells from the goal. " in reason
    assert reason.endswith(f" It cannot turn on the spot there: {UNKNOWN}"), reason


def test_a_cell_where_it_stands_in_no_heading_is_refused_with_the_limit():
    slope = across(np.arange(48) * CELL_M * math.tan(math.radians(25.0)))
    planner = Planner.of_elevation(slope, CELL_M, vehicle=ROVER)
    for start, goal, words in (
        (
            (20, 20),
            (20, 30),
            "start (20, 20) is impassable: in any heading it tilts by 25° or more, and "
            "max_tilt_deg is 20",
        ),
        ((0, 20), (20, 30), f"start (0, 20) is impassable: in any heading {UNKNOWN}"),
    ):
        plan = planner.plan(start, goal)
        assert (plan.status, plan.reason) == ("START_BLOCKED", words)


def test_explain_gives_each_limit_beside_its_allowance():
    slope = across(np.arange(48) * CELL_M * math.tan(math.radians(15.0)))
    dynamic = DynamicPlanner.of_elevation(
        slope, CELL_M, (20, 40), vehicle=replace(ROVER, max_roll_deg=12.0)
    )
    along = dynamic.explain((20, 20), 90.0)
    side = dynamic.explain((20, 20), 0)
    assert (along.ok, along.refused_by, side.ok, side.refused_by) == (True, None, False, "roll")
    assert along.pitch_deg == pytest.approx((15.0, 20.0), abs=1e-3)
    assert side.roll_deg == pytest.approx((15.0, 12.0), abs=1e-3)
    assert str(side).splitlines()[0] == "(20, 20) at 0°: refused by roll"
    assert "  roll      15.0°, at most 12.0°   too much" in str(side).splitlines()


def test_ground_where_it_stands_nowhere_is_told_apart_by_the_limit_that_refuses_most_headings():
    codes = np.full((AXIS_COUNT, 1, 3), FAILS + REFUSALS.index("belly"), np.uint16)
    codes[:5, 0, 1] = FAILS + REFUSALS.index("tilt")
    codes[7, 0, 2] = 1
    assert refusals(codes).tolist() == [
        [1 + REFUSALS.index("belly"), 1 + REFUSALS.index("tilt"), 0]
    ]
