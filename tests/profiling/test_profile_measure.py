"""The measured run of a profile: its rows and figures."""

import os
from itertools import product

import pytest

from nnpp_edge.profiling.figures import loop_rows, results
from nnpp_edge.profiling.measure import queries_in, rivals_of, run
from nnpp_edge.profiling.profile_file import Budget, Device, Load, Networks, Profile
from nnpp_edge.profiling.rows import PLACE, Rows
from nnpp_edge.runtime.loop.settings import OnboardLoop

LOAD = Load(
    terrain=("synthetic",),
    workloads=("soft", "limit20"),
    sizes=(96, 256),
    queries=12,
    repeats=1,
    seed=3,
)
NAMES = ["astar", "corridor", "nnpp", "nnpp-fp32", "auto"]
CORES = sorted(os.sched_getaffinity(0))


def asks(quantity, planner, **where):
    return Budget(quantity, quantity, 1.0, "at most", "ms", planner, **where)


def profile(load, planner, model, *budgets):
    loop = OnboardLoop(rate_hz=200.0, model=str(model))
    return Profile("p", "p", planner, load=load, budgets=budgets, loop=loop)


@pytest.fixture(scope="module")
def measured(tiny_model):
    """A run, its rows and the progress."""
    done = []
    planners = rivals_of(Networks(str(tiny_model), str(tiny_model)), Device((0,)))
    found = run(profile(LOAD, "nnpp", tiny_model), planners, CORES, done.append)
    return found, results(found.answers), done


def test_every_planner_has_a_row_for_each_workload_and_size(measured):
    found, told, done = measured
    assert [PLACE(row) for row in told] == list(product(LOAD.workloads, LOAD.sizes, NAMES))
    assert {row["n"] for row in told} == {12}
    assert done[-1] == queries_in(LOAD) == 2 * 2 * 2 * 12 and done == sorted(done)
    assert [half.facts()["measured_s"] > 0.0 for half in found.disturbance] == [True, True]
    of = {PLACE(row): list(row["stages_ms"]) for row in told}
    assert {"encode", "inference", "threshold", "path"} <= set(of["soft", 96, "nnpp"])
    assert of["soft", 96, "astar"] == ["search", "path", "other"]


def test_both_halves_ask_the_same_and_costs_are_those_of_the_public_planner(measured):
    found, told, _ = measured
    for row in found.answers:
        assert sum(row["stages_ms"].values()) == pytest.approx(row["time_ms"])
        assert 0.0 <= row["stages_ms"]["other"] < row["time_ms"]
    for rows in found.answers.groups(("workload", "size", "planner", "query")).values():
        first, second = rows
        assert (first["half"], second["half"]) == (0, 1) and first["cc"] == second["cc"]
    for row in told:
        times = [row["time_ms"][key] for key in ("median", "p90", "p99", "max")]
        assert row["gap_max"] >= row["gap_mean"] >= -1e-6
        assert row["success"] == 1.0 >= row["success_first"]
        assert times == sorted(times) and row["fps"] == pytest.approx(1e3 / times[0], rel=1e-3)
        assert set(row["halves"]) >= {"time", "ratio"}
    at = {PLACE(row): row for row in told}
    exact = at["soft", 96, "astar"]
    assert (exact["speedup_total"], exact["gap_max"]) == (1.0, 0.0)
    int8 = at["soft", 96, "nnpp"]
    fp32_ms = at["soft", 96, "nnpp-fp32"]["inference_ms_median"]
    assert int8["int8_speedup"] == pytest.approx(fp32_ms / int8["inference_ms_median"])
    assert at["soft", 96, "auto"]["inference_fps"] is None


def test_each_call_on_a_vehicles_map_is_that_of_a_planner_that_has_checked_nothing(tiny_model):
    kind = {"terrain": ("synthetic",), "workloads": ("soft", "body", "body-rocks5")}
    load = Load(**kind, vehicle="small-rover", sizes=(64,), queries=3, repeats=2, patches=6)
    asked = profile(load, "corridor", tiny_model, asks("reaction_ms", "loop", workload="body"))
    found = run(asked, rivals_of(Networks(str(tiny_model)), Device((0,))), CORES)
    for (name, *_), rows in found.answers.of("astar").groups(("workload", "query")).items():
        first, second = rows
        assert first["checks"] == second["checks"]
        assert (first["checks"] > 0) == (name != "soft")
    assert len(found.reactions.of(workload="body", half=0)) == 6
    for row in results(found.answers.of(workload="body")):
        assert row["gap_mean"] == 0.0 if row["planner"] == "astar" else row["gap_mean"] > -1e-6


def test_times_are_told_by_their_quantiles_and_a_thousandth_of_enough():
    place = {"workload": "soft", "size": 64, "half": 0}
    rows = Rows({**place, "reaction_ms": float(ms), "late": ms < 2} for ms in range(1101))
    (row,) = loop_rows(Rows(rows[:201]), OnboardLoop())
    told = {"median": 100.0, "p90": 180.0, "p99": 198.0, "max": 200.0, "mean": 100.0}
    assert row["reaction_ms"] == told
    assert row["late_per_hour"] == pytest.approx(2 / (201 / 17 / 3600))
    (row,) = loop_rows(rows, OnboardLoop())
    assert row["reaction_ms"]["p999"] == pytest.approx(1098.9, abs=0.01)
