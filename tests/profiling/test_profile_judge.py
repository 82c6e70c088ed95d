"""Budgets: each verdict, and that of the whole run."""

import json

import pytest

from nnpp_edge.profiling.judge import Noise, judged, verdict
from nnpp_edge.profiling.profile_file import Budget, Device, Load, Profile
from nnpp_edge.profiling.sensors import Throttling
from tests.tables import cases

QUIET = Noise()
DISTURBED = Noise("others took 40 % of the cores' time", 0.4)
SLOWED = Noise(throttling=Throttling("the clock of core 0 fell from 2000 to 1500 MHz", 0.25))
NOISE = {"quiet": QUIET, "disturbed": DISTURBED, "slowed": SLOWED}


def profile(*budgets, sizes=(64,)):
    return Profile("p", "p", "auto", Device((0,)), Load(sizes=sizes), budgets=budgets)


def budget(quantity, limit, direction, unit, **changes):
    return Budget("b", quantity, limit, direction, unit, **{"planner": "nnpp", **changes})


def row(size=64, **figures):
    return {
        "workload": "soft",
        "size": size,
        "planner": "nnpp",
        "time_ms": {"p99": 4.0},
        "fps": 500.0,
        "map_ms": {"median": 4.0, "p99": 9.0},
        "patch_ms": {"median": 0.1, "p99": 0.2},
        "gap_mean": 0.012,
        "halves": {"time": [1.0, 1.05], "ratio": [1.0, 1.05]},
    } | figures


FPS = budget("fps", 100.0, "at least", "1/s")
WANTED = {
    "fps": FPS,
    "one frame": budget("fps", 1.0, "at least", "1/s", planner="corridor"),
    "inference_fps": budget("inference_fps", 1.0, "at least", "1/s"),
    "speedup_total": budget("speedup_total", 2.0, "at least", "x"),
    "gap_mean": budget("gap_mean", 1.0, "at most", "%"),
}
VERDICTS = """
fps                | | quiet | pass
fps                | "fps": 99 | quiet | fail
fps                | "fps": 100 | quiet | pass
time_ms_p99 <= 4.0 | | quiet | pass
time_ms_p99 <= 3.9 | | quiet | fail
time_ms_p90 <= 3.9 | "time_ms_p90": 4.0 | quiet | fail
map_ms <= 4.0      | "halves": {"time": [1, 9], "map": [3.9, 4.0]} | quiet | pass
map_ms <= 3.9      | "halves": {"time": [1, 9], "map": [3.9, 4.0]} | quiet | fail
map_ms_p99 <= 9.0  | "halves": {"time": [1, 9], "map": [3.9, 4.0]} | quiet | pass
map_ms_p99 <= 8.9  | "halves": {"time": [1, 9], "map": [3.9, 4.0]} | quiet | fail
map_ms <= 5.0      | "halves": {"time": [1, 1], "map": [3.0, 4.0]} | quiet | noisy
map_ms <= 5.0      | "map_ms": null | quiet | not measured
patch_ms <= 0.1    | "halves": {"patch": [0.1, 0.1]} | quiet | pass
patch_ms_p99 <= 0.19 | "halves": {"patch": [0.1, 0.1]} | quiet | fail
speedup_total      | "halves": {"time": [1, 9], "ratio": [3, 3.1]}, "speedup_total": 3 | quiet | pass
fps                | "halves": {"time": [1.0, 1.2]} | quiet | pass
fps                | "fps": 145, "halves": {"time": [1.0, 1.2]} | quiet | pass
fps                | "fps": 143, "halves": {"time": [1.0, 1.2]} | quiet | noisy
fps                | "fps": 900, "halves": {"time": [1.0, 1.2]} | disturbed | noisy
fps                | "halves": {"time": [1.2, 1.0]}, "fps": 90 | quiet | noisy
fps                | | disturbed | noisy
fps                | "fps": 90 | disturbed | noisy
fps                | "fps": 1000 | disturbed | pass
fps                | "fps": 45 | disturbed | fail
fps                | "fps": 47 | disturbed | noisy
fps                | "fps": 41, "halves": {"time": [1, 2]} | quiet | noisy
fps                | "fps": 39, "halves": {"time": [1, 2]} | quiet | fail
time_ms_p99 <= 1.8 | | disturbed | fail
time_ms_p99 <= 2.0 | | disturbed | noisy
gap_mean           | "halves": {"time": [1, 9]} | disturbed | fail
gap_mean           | "gap_mean": 0.0099 | disturbed | pass
gap_mean           | "gap_mean": null | quiet | not measured
inference_fps      | "inference_fps": null | quiet | not measured
one frame          | | quiet | not measured
fps                | | slowed | pass
fps                | "fps": 99 | slowed | throttled
fps                | "fps": 61 | slowed | throttled
fps                | "fps": 59 | slowed | fail
fps                | "fps": 99, "halves": {"time": [1.0, 1.2]} | slowed | noisy
gap_mean           | | slowed | fail
gap_mean           | "gap_mean": 0.001 | slowed | pass
"""
"""A budget, the figures that are other than in `row`, the noise, and the verdict."""


@pytest.mark.parametrize(("name", "figures", "noise", "state"), cases(VERDICTS, 4))
def test_a_budgets_verdict(name, figures, noise, state):
    quantity, _, limit = name.partition(" <= ")
    wanted = budget(quantity, float(limit), "at most", "ms") if limit else WANTED[name]
    changed = row(**json.loads(f"{{{figures}}}"))
    (line,) = judged(profile(wanted), [changed], {}, NOISE[noise])
    assert line["verdict"] == state
    why = line["why"]
    unsure = state in ("noisy", "not measured", "throttled")
    assert bool(why) == (unsure or "explains no such" in why)
    told = noise == "slowed" and name == "fps" and state in ("throttled", "fail")
    assert ("core 0 fell" in why) == told


OTHERS = """
fps             | 1/s | 100 | quiet     | pass, fail
reaction_ms     | ms  | 2.0 | quiet     | pass, not measured
reaction_ms     | ms  | 1.9 | quiet     | fail, not measured
reaction_ms_p99 | ms  | 5.9 | quiet     | fail, not measured
peak_memory_mb  | MB  | 300 | disturbed | pass
start_up_warm_s | s   | 300 | quiet     | pass
start_up_warm_s | s   | 100 | disturbed | noisy
"""
"""A quantity, its limit, the noise, and the verdicts at both sizes, or on the whole run."""


@pytest.mark.parametrize(("quantity", "unit", "limit", "noise", "states"), cases(OTHERS, 5))
def test_a_budget_is_judged_at_each_size_of_the_loop_too_or_once(
    quantity, unit, limit, noise, states
):
    reacted = {"reaction_ms": {"median": 2.0, "p99": 6.0}, "halves": {"reaction": [2, 2]}}
    loop = {"workload": "soft", "size": 64, **reacted}
    whole = {name: {"nnpp": 90.0} for name in ("peak_memory_mb", "start_up_warm_s")}
    planner = "loop" if quantity.startswith("reaction") else "nnpp"
    direction = "at least" if quantity == "fps" else "at most"
    asked = profile(
        budget(quantity, float(limit), direction, unit, planner=planner), sizes=(64, 128)
    )
    lines = judged(asked, [row(), row(128, fps=1.0)], whole, NOISE[noise], [loop])
    assert [line["verdict"] for line in lines] == states.split(", ")
    sizes = [64, 128] if len(lines) == 2 else [None]
    assert [(line["size"], line["planner"]) for line in lines] == [(at, planner) for at in sizes]


WHOLE = """
pass, pass              | quiet | met
pass, noisy             | quiet | noisy
noisy, fail             | quiet | missed
pass, not measured      | quiet | noisy
                        | quiet | met
                        | disturbed | noisy
pass                    | disturbed | met
throttled, pass         | slowed | throttled
throttled, fail         | slowed | missed
throttled, not measured | slowed | noisy
pass                    | slowed | met
                        | slowed | throttled
"""


@pytest.mark.parametrize(("states", "noise", "whole"), cases(WHOLE, 3))
def test_the_whole_runs_verdict(states, noise, whole):
    lines = [{"verdict": state} for state in states.split(", ") if state]
    assert verdict(lines, NOISE[noise]) == whole
