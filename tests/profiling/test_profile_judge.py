import pytest

from nnpp_edge.profiling.judge import EXIT_CODES, Noise, judged, verdict
from nnpp_edge.profiling.profile_file import Budget, Device, Load, Profile
from nnpp_edge.profiling.sensors import Throttling

QUIET = Noise()
DISTURBED = Noise("others took 40 % of the cores' time", 0.4)
SLOWED = Noise(throttling=Throttling("the clock of core 0 fell from 2000 to 1500 MHz", 0.25))


def profile(*budgets, sizes=(64,)):
    return Profile("p", "p", "auto", Device((0,)), Load(sizes=sizes), budgets=budgets)


def budget(quantity, limit, direction, unit, **changes):
    return Budget("b", quantity, limit, direction, unit, **{"planner": "nnpp", **changes})


def row(size=64, **figures):
    told = {
        "workload": "soft",
        "size": size,
        "planner": "nnpp",
        "time_ms": {"p99": 4.0},
        "fps": 500.0,
    }
    told |= {"map_ms": {"median": 4.0, "p99": 9.0}, "patch_ms": {"median": 0.1, "p99": 0.2}}
    return (
        told | {"gap_mean": 0.012, "halves": {"time": [1.0, 1.05], "ratio": [1.0, 1.05]}} | figures
    )


FPS = budget("fps", 100.0, "at least", "1/s")
HALVES = {"time": [1.0, 9.0], "map": [3.9, 4.0], "patch": [0.1, 0.1], "ratio": [3.0, 3.1]}
GAP = budget("gap_mean", 1.0, "at most", "%")


@pytest.mark.parametrize(
    ("wanted", "figures", "disturbed", "state"),
    [
        (FPS, {}, QUIET, "pass"),
        (FPS, {"fps": 99.0}, QUIET, "fail"),
        (FPS, {"fps": 100.0}, QUIET, "pass"),
        (budget("time_ms_p99", 4.0, "at most", "ms"), {}, QUIET, "pass"),
        (budget("time_ms_p99", 3.9, "at most", "ms"), {}, QUIET, "fail"),
        # by the halves of the figure's own basis
        *(
            (budget(quantity, limit, "at most", "ms"), {"halves": HALVES} | figures, QUIET, state)
            for quantity, limit, figures, state in (
                ("map_ms", 4.0, {}, "pass"),
                ("map_ms", 3.9, {}, "fail"),
                ("map_ms_p99", 9.0, {}, "pass"),
                ("map_ms_p99", 8.9, {}, "fail"),
                ("patch_ms", 0.1, {}, "pass"),
                ("patch_ms_p99", 0.19, {}, "fail"),
                ("map_ms", 5.0, {"halves": {"time": [1.0, 1.0], "map": [3.0, 4.0]}}, "noisy"),
                ("map_ms", 5.0, {"map_ms": None}, "not measured"),
            )
        ),
        (
            budget("speedup_total", 2.0, "at least", "x"),
            {"halves": HALVES, "speedup_total": 3.0},
            QUIET,
            "pass",
        ),
        # noise: a pass only ten times over, and a miss only where it is beyond doubt
        (FPS, {"halves": {"time": [1.0, 1.2]}}, QUIET, "noisy"),
        (FPS, {"halves": {"time": [1.2, 1.0]}, "fps": 90.0}, QUIET, "noisy"),
        (FPS, {}, DISTURBED, "noisy"),
        (FPS, {"fps": 90.0}, DISTURBED, "noisy"),
        (FPS, {"fps": 1000.0}, DISTURBED, "pass"),
        (FPS, {"fps": 45.0}, DISTURBED, "fail"),
        (FPS, {"fps": 47.0}, DISTURBED, "noisy"),
        (FPS, {"fps": 41.0, "halves": {"time": [1.0, 2.0]}}, QUIET, "noisy"),
        (FPS, {"fps": 39.0, "halves": {"time": [1.0, 2.0]}}, QUIET, "fail"),
        (budget("time_ms_p99", 1.8, "at most", "ms"), {}, DISTURBED, "fail"),
        (budget("time_ms_p99", 2.0, "at most", "ms"), {}, DISTURBED, "noisy"),
        # path costs do not depend on the clock; budgets are set in percent
        (GAP, {"halves": {"time": [1.0, 9.0]}}, DISTURBED, "fail"),
        (GAP, {"gap_mean": 0.0099}, DISTURBED, "pass"),
        (GAP, {"gap_mean": None}, QUIET, "not measured"),
        (budget("energy_mj", 5.0, "at most", "mJ"), {"energy_mj": 6.0}, QUIET, "fail"),
        (budget("energy_mj", 5.0, "at most", "mJ"), {"energy_mj": None}, QUIET, "not measured"),
        (
            budget("inference_fps", 1.0, "at least", "1/s"),
            {"inference_fps": None},
            QUIET,
            "not measured",
        ),
        (budget("fps", 1.0, "at least", "1/s", planner="corridor"), {}, QUIET, "not measured"),
        (FPS, {}, SLOWED, "pass"),
        (FPS, {"fps": 99.0}, SLOWED, "throttled"),
        (FPS, {"fps": 61.0}, SLOWED, "throttled"),
        (FPS, {"fps": 59.0}, SLOWED, "fail"),
        (FPS, {"fps": 99.0, "halves": {"time": [1.0, 1.2]}}, SLOWED, "noisy"),
        (GAP, {}, SLOWED, "fail"),
        (GAP, {"gap_mean": 0.001}, SLOWED, "pass"),
    ],
)
def test_a_budgets_verdict(wanted, figures, disturbed, state):
    (line,) = judged(profile(wanted), [row(**figures)], {}, disturbed)
    assert line["verdict"] == state
    unsure = state in ("noisy", "not measured", "throttled")
    assert bool(line["why"]) == (
        unsure or "explains no such miss" in line["why"] or "under load" in line["why"]
    )
    assert ("core 0 fell" in line["why"]) == (
        disturbed is SLOWED and wanted is FPS and state in ("throttled", "fail")
    )


def test_the_loops_reactions_have_budgets():
    loop = {
        "workload": "soft",
        "reaction_ms": {"median": 2.0, "p99": 6.0},
        "halves": {"reaction": [2, 2]},
    }
    for quantity, limit, at, state in (
        ("reaction_ms", 2.0, 64, "pass"),
        ("reaction_ms", 1.9, 64, "fail"),
        ("reaction_ms_p99", 5.9, 64, "fail"),
        ("reaction_ms", 2.0, 128, "not measured"),
    ):
        wanted = budget(quantity, limit, "at most", "ms", planner="loop")
        (line,) = judged(profile(wanted), [row()], {}, QUIET, [loop | {"size": at}])
        assert (line["verdict"], line["planner"]) == (state, "loop")


def test_a_budget_without_a_size_is_judged_at_each():
    lines = judged(profile(FPS, sizes=(64, 128)), [row(), row(128, fps=1.0)], {}, QUIET)
    assert [(line["size"], line["verdict"]) for line in lines] == [(64, "pass"), (128, "fail")]


def test_what_the_run_has_one_figure_of_is_judged_once_and_start_up_may_be_noisy():
    for quantity, unit, value, noise, state in (
        ("peak_memory_mb", "MB", 280.0, DISTURBED, "pass"),
        ("start_up_warm_s", "s", 0.9, QUIET, "pass"),
        ("start_up_warm_s", "s", 90.0, DISTURBED, "noisy"),
    ):
        wanted = budget(quantity, 300.0, "at most", unit)
        lines = judged(
            profile(wanted, sizes=(64, 128)), [row()], {quantity: {"nnpp": value}}, noise
        )
        assert [(line["size"], line["value"], line["verdict"]) for line in lines] == [
            (None, value, state)
        ]


@pytest.mark.parametrize(
    ("states", "disturbed", "whole"),
    [
        (["pass", "pass"], QUIET, "met"),
        (["pass", "noisy"], QUIET, "noisy"),
        (["noisy", "fail"], QUIET, "missed"),
        (["pass", "not measured"], QUIET, "noisy"),
        ([], QUIET, "met"),
        ([], DISTURBED, "noisy"),
        (["pass"], DISTURBED, "met"),
        (["throttled", "pass"], SLOWED, "throttled"),
        (["throttled", "fail"], SLOWED, "missed"),
        (["throttled", "not measured"], SLOWED, "noisy"),
        (["pass"], SLOWED, "met"),
        ([], SLOWED, "throttled"),
    ],
)
def test_the_whole_runs_verdict(states, disturbed, whole):
    assert verdict([{"verdict": state} for state in states], disturbed) == whole
    assert EXIT_CODES == {"met": 0, "missed": 1, "noisy": 3, "throttled": 3}
