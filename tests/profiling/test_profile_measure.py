"""The measured run of a profile: its figures, beside a clock outside."""

import os
import time
from collections import defaultdict
from itertools import chain, product
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from msgspec.structs import replace

from nnpp_edge.profiling import measure, rivals
from nnpp_edge.profiling.contest import PLACE
from nnpp_edge.profiling.figures import break_even, loop_rows, rows
from nnpp_edge.profiling.measure import ProfileMaps, queries_in, rivals_of, run
from nnpp_edge.profiling.profile_file import Budget, Device, Load, Networks, Profile
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.settings import OnboardLoop
from nnpp_edge.runtime.planners.planner import Planner

LOAD = Load(
    terrain=("synthetic",),
    workloads=("soft", "limit20"),
    sizes=(96, 256),
    queries=12,
    repeats=1,
    seed=3,
)
NAMES = ["astar", "corridor", "nnpp", "nnpp-fp32", "auto"]


class Timed(Planner):
    """The public planner, timed from outside by a clock of its own."""

    calls: ClassVar[dict] = defaultdict(list)

    def __init__(self, ground, model="edge", **options):
        super().__init__(ground, model=model, **options)
        self.asked = model

    def plan(self, start, goal, **options):
        began = time.perf_counter()
        plan = super().plan(start, goal, **options)
        query = self.shape, start, goal, options["method"], self.asked
        self.calls[query].append(1e3 * (time.perf_counter() - began))
        return plan


class OneWatt:
    """A meter by which every call takes as many millijoules as milliseconds."""

    def read(self):
        return time.perf_counter()

    def since_mj(self, before):
        return 1e3 * (time.perf_counter() - before)


def asks(quantity, planner, **where):
    return Budget(quantity, quantity, 1.0, "at most", "ms", planner, **where)


def profile(load, planner, model, *budgets):
    return Profile(
        "p",
        "p",
        planner,
        load=load,
        budgets=budgets,
        loop=OnboardLoop(rate_hz=200.0, model=str(model)),
    )


@pytest.fixture(scope="module")
def measured(tiny_model):
    """A run, its rows, what the clock outside showed, the progress, and the planners."""
    cores = sorted(os.sched_getaffinity(0))
    done = []
    patch = pytest.MonkeyPatch()
    patch.setattr(rivals, "Planner", Timed)
    patch.setattr(measure, "EnergyMeter", OneWatt)
    Timed.calls.clear()
    planners = rivals_of(Networks(str(tiny_model), str(tiny_model)), Device((0,)))
    budgets = (asks("map_ms", "astar"), asks("reaction_ms", "loop", workload="limit20", size=256))
    asked = profile(replace(LOAD, patches=16), "nnpp", tiny_model, *budgets)
    found = run(asked, planners, cores, progress=done.append)
    patch.undo()
    named = {planner.name: planner for planner in planners}
    return found, rows(found), dict(Timed.calls), done, named


def test_every_planner_has_a_row_for_each_workload_and_size(measured):
    found, told, _, done, _ = measured
    places = [(row["workload"], row["size"], row["planner"]) for row in told]
    assert places == list(product(LOAD.workloads, LOAD.sizes, NAMES))
    assert {(row["n"], *row["time_ms"]) for row in told} == {
        (12, "median", "p90", "p99", "max", "mean")
    }
    assert done[-1] == queries_in(LOAD) == 2 * 2 * 2 * 12 and done == sorted(done)
    watts = [row["energy_mj"] / row["time_ms"]["mean"] for row in told]
    # calls may be held up after the clock stopped
    assert min(watts) > 1.0 and np.quantile(watts, 0.25) < 1.5
    assert [half.elapsed_s > 0.0 for half in found.disturbance] == [True, True]


def test_each_row_has_the_stages_of_its_planner(measured):
    for row in measured[1]:
        assert list(row["stages_ms"])[-1] == "other"
    stages = {PLACE(row): set(row["stages_ms"]) for row in measured[1]}
    needed = {"encode", "inference", "threshold", "search", "path"}
    assert needed <= stages["soft", 96, "nnpp"]
    assert stages["soft", 96, "astar"] == {"search", "path", "other"}


def clock_outside(measured, of, name):
    """(queries, 2) milliseconds of the calls that each half of the run timed, by the
    clock outside.
    """
    _, _, outside, _, planners = measured
    rival = planners[name]
    times = []
    for query in chain(*of.queries_by_map):
        calls = outside[(of.size, of.size), *query, rival.method, rival.model or "edge"]
        times.append(calls if len(calls) == 2 else calls[1::2])  # a map's first is asked before
    return np.array(times)


@pytest.mark.parametrize("name", NAMES)
def test_stages_and_figures_agree_with_a_clock_outside_within_5_percent(measured, name):
    """Query by query, of stages the better of its two calls: a disturbance between two does not
    decide.

    The clock outside is nearer to the planner by a call, so it shows a little less than the
    figures.
    """
    for of in measured[0].workloads:
        answers = of.answers[name]
        outside = clock_outside(measured, of, name)
        named = [sum(plan.values()) - plan["other"] for plan in answers.stages_ms]
        shares = np.reshape(named, (2, -1)).T / outside
        ratios = outside.mean(axis=1) / answers.column("time_ms")
        assert shares.max() <= 1.0 and ratios.max() <= 1.0
        assert np.median(shares.max(axis=1)) > 0.95 < np.median(ratios), (of.workload, of.size)


def test_both_halves_ask_the_same_and_costs_are_those_of_the_public_planner(measured):
    found, told, *_ = measured
    for of in found.workloads:
        assert all(len(half) == 12 for half in of.answers["astar"].figures)
        assert sum(map(len, of.queries_by_map)) == 12
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


def test_maps_and_patches_that_have_just_arrived_are_measured_of_whom_it_was_asked(measured):
    for row in measured[1]:
        asked = row["planner"] in ("nnpp", "astar")
        for key, basis in (("map_ms", "map"), ("patch_ms", "patch")):
            assert (row[key] is not None) == (basis in row["halves"]) == asked
            if asked:
                assert 0.0 < row[key]["median"] <= row[key]["p99"] <= row[key]["max"]
                assert len(row["halves"][basis]) == 2
    for of in measured[0].workloads:
        assert of.answers["nnpp"].halves("map_ms").shape == (2, 12), "each judged query"


def test_the_loop_answers_every_patch_with_a_checked_path(measured):
    (row,) = loop_rows(measured[0], OnboardLoop(rate_hz=200.0))
    place = (row["workload"], row["size"], row["method"], row["rate_hz"])
    assert place == ("limit20", 256, "auto", 200.0)
    assert (row["n"], row["patch_side"]) == (32, 64)
    assert row["planned"] + row["kept"] + row["without_path"] == 32 and row["planned"] > 0
    assert 0.0 < row["reaction_ms"]["median"] <= row["reaction_ms"]["p99"]
    assert len(row["halves"]["reaction"]) == 2


def test_terrain_without_enough_queries_is_refused(tmp_path, tiny_model):
    towers = (np.arange(40)[:, None] // 10 + np.arange(40) // 10) % 2
    heights = (1000.0 * towers).astype(np.float32)
    np.savez(tmp_path / "cliff.npz", elevation_m=heights, cell_size_m=1.0)
    terrain = (str(tmp_path / "cliff.npz"),)
    load = Load(terrain, workloads=("limit20",), sizes=(40,), queries=2, min_distance=0.6)
    planners = rivals_of(Networks(str(tiny_model)), Device((0,)))
    with pytest.raises(InvalidQueryError, match="wanted 2 queries with a path"):
        run(profile(load, "auto", tiny_model), planners, [0])


def test_each_call_on_a_vehicles_map_is_that_of_a_planner_that_has_checked_nothing(
    tiny_model,
):
    kind = {"terrain": ("synthetic",), "workloads": ("soft", "body", "body-rocks5")}
    load = Load(**kind, vehicle="small-rover", sizes=(64,), queries=3, repeats=2, patches=6)
    asked = profile(load, "corridor", tiny_model, asks("reaction_ms", "loop", workload="body"))
    planners = rivals_of(Networks(str(tiny_model)), Device((0,)))
    found = run(asked, planners, sorted(os.sched_getaffinity(0)))
    maps = ProfileMaps(load)
    for of in found.workloads:
        wanted = [
            Planner(on_map.ground).plan(*query, method="astar")
            for queries, on_map in zip(of.queries_by_map, maps.maps(of.workload, 64), strict=False)
            for query in queries
        ]
        for plan, answer in zip(of.answers["astar"].plans, wanted, strict=True):
            assert plan.cost == pytest.approx(answer.cost, rel=1e-5)
            assert plan.checks == answer.checks  # in the last of all repeats, too
            assert (plan.checks > 0) == (of.workload != "soft")
        assert len(of.answers["corridor"].halves("map_ms")[0]) == 3
    (reacting,) = (of for of in found.workloads if of.reactions)
    assert reacting.workload == "body" and len(reacting.reactions[0].ms) == 6
    gaps = {row["planner"]: row["gap_mean"] for row in rows(found) if row["workload"] == "body"}
    assert gaps["astar"] == 0.0 and all(gap > -1e-6 for gap in gaps.values())


def test_times_are_told_by_their_quantiles():
    times = np.random.default_rng(0).permutation(np.arange(1.0, 202.0))
    halves = [
        SimpleNamespace(ms=half, planned=3, kept=2, without_path=1, late=1)
        for half in np.array_split(times, 2)
    ]
    of = SimpleNamespace(workload="soft", size=64, reactions=halves)
    (row,) = loop_rows(SimpleNamespace(workloads=[of]), OnboardLoop())
    told = {"median": 101.0, "p90": 181.0, "p99": 199.0, "max": 201.0, "mean": 101.0}
    assert row["reaction_ms"] == told
    assert row["late_per_hour"] == pytest.approx(2 / (201 / 17 / 3600))
    of.reactions[0].ms = np.arange(1100.0)
    (row,) = loop_rows(SimpleNamespace(workloads=[of]), OnboardLoop())
    assert 1000.0 < row["reaction_ms"]["p999"] < 1100.0


def test_from_which_size_on_a_planner_pays():
    times = {"astar": (1.0, 9.0, 50.0), "corridor": (2.0, 3.0, 40.0), "nnpp": (0.5, 10.0, 30.0)}
    told = [
        {"planner": name, "size": size, "n": 10, "time_ms": {"mean": ms}}
        for name, of_sizes in times.items()
        for size, ms in zip((128, 256, 512), of_sizes, strict=True)
    ]
    found = {(line["planner"], line["over"]): line["size_from"] for line in break_even(told)}
    assert found == {("corridor", "astar"): 256, ("nnpp", "astar"): 512, ("nnpp", "corridor"): 512}
    smaller = break_even([row for row in told if row["size"] < 512])
    assert {line["size_from"] for line in smaller} == {256, None}
