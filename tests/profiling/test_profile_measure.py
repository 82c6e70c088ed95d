import os
import time
from collections import defaultdict
from typing import ClassVar

import numpy as np
import pytest

from nnpp_edge.profiling import rivals
from nnpp_edge.profiling.figures import rows
from nnpp_edge.profiling.measure import queries_in, rivals_of, run
from nnpp_edge.profiling.profile_file import Device, Load, Networks
from nnpp_edge.profiling.report_format import find
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.planner import Planner

LOAD = Load(terrain=("synthetic",), workloads=("soft", "limit20"), sizes=(96,), queries=12, near=5, repeats=1, seed=3)
NAMES = ["astar", "corridor", "nnpp", "nnpp-fp32", "auto"]


class Timed(Planner):
    """The public planner, timed from outside by a clock of its own."""

    calls: ClassVar[dict] = defaultdict(list)

    def plan(self, start, goal, **options):
        began = time.perf_counter()
        plan = super().plan(start, goal, **options)
        self.calls[start, goal, options["method"]].append(1e3 * (time.perf_counter() - began))
        return plan


@pytest.fixture(scope="module")
def measured(tiny_model):
    """A run, its rows, and what the clock outside showed."""
    cores = sorted(os.sched_getaffinity(0))
    done = []
    patch = pytest.MonkeyPatch()
    patch.setattr(rivals, "Planner", Timed)
    Timed.calls.clear()
    found = run(
        rivals_of(Networks(str(tiny_model), str(tiny_model)), Device((0,))), LOAD, cores, progress=done.append
    )
    patch.undo()
    return found, rows(found), dict(Timed.calls), done


def test_every_planner_has_a_row_for_each_workload_and_size(measured):
    found, told, _, done = measured
    assert [(row["workload"], row["size"], row["planner"]) for row in told] == [
        (workload, 96, name) for workload in LOAD.workloads for name in NAMES
    ]
    assert all(row["n"] == 12 and len(row["queries"]["time_ms"]) == 17 for row in told)
    assert done[-1] == queries_in(LOAD) == 2 * 2 * 17 and done == sorted(done)
    assert len(found.disturbance) == 2 and all(half.cores.elapsed > 0.0 for half in found.disturbance)


def test_stages_and_other_add_up_to_the_whole(measured):
    for row in measured[1]:
        whole = row["time_ms"]["mean"]
        assert sum(spread["mean"] for spread in row["stages_ms"].values()) == pytest.approx(whole, rel=1e-3)
        assert sum(row["stages_share"].values()) == pytest.approx(1.0, rel=1e-3)
        assert list(row["stages_ms"])[-1] == "other"
    stages = find(measured[1], "soft", 96, "nnpp")["stages_ms"]
    assert {"encode", "inference", "threshold", "search", "path"} <= set(stages)
    assert set(find(measured[1], "soft", 96, "astar")["stages_ms"]) == {"search", "path", "other"}


def test_named_stages_are_nearly_the_whole(measured):
    """Query by query, so that a moment's disturbance between two stages does not decide."""
    for of in measured[0].workloads:
        answers = of.answers["nnpp"]
        shares = [
            stages["other"] / ms
            for half in range(2)
            for stages, ms in zip(answers.stages_ms[half], answers.middle_ms[half], strict=True)
        ]
        assert 0.0 <= np.median(shares) < 0.15  # on a map of 96² a plan takes a fraction of a millisecond


def test_the_figures_agree_with_a_clock_outside(measured):
    """The clock outside is nearer to the planner by a call, so it shows a little less, query by query."""
    found, _, outside, _ = measured
    for of in found.workloads:
        ratios = []
        for query, ours in zip(of.queries, of.answers["astar"].times(), strict=True):
            theirs = outside[query.start, query.goal, "astar"]
            if len(theirs) == 4:  # the first query on a map is answered once before, in each half
                theirs = theirs[1::2]
            assert len(theirs) == 2
            ratios.append(np.mean(theirs) / ours)
        assert max(ratios) <= 1.0
        assert np.median(ratios) > 0.9


def test_both_halves_ask_the_same_and_costs_are_those_of_the_public_planner(measured):
    found, told, _, _ = measured
    for of in found.workloads:
        assert all(len(half) == len(of.queries) for half in of.answers["astar"].middle_ms)
        assert sum(query.judged for query in of.queries) == 12
    for row in told:
        assert row["gap_max"] >= row["gap_mean"] >= -1e-6
        assert row["success"] == 1.0 and 0.0 <= row["success_first"] <= 1.0
        assert row["time_ms"]["median"] <= row["time_ms"]["p90"] <= row["time_ms"]["p99"] <= row["time_ms"]["max"]
        assert row["fps"] == pytest.approx(1e3 / row["time_ms"]["median"], rel=1e-3)
        assert set(row["halves"]) >= {"time", "ratio"}
    assert find(told, "soft", 96, "astar")["speedup_total"] == 1.0
    assert find(told, "soft", 96, "astar")["gap_max"] == 0.0
    assert find(told, "soft", 96, "nnpp")["int8_speedup"] > 0.0
    assert find(told, "soft", 96, "auto")["inference_fps"] is None


def test_near_questions_are_nearer_than_judged_ones(measured):
    for of in measured[0].workloads:
        for query in of.queries:
            distance = np.hypot(*np.subtract(query.start, query.goal))
            assert (distance >= 0.35 * 96) == query.judged or abs(distance - 0.35 * 96) < 1.5


def test_terrain_without_enough_queries_is_refused(tmp_path, tiny_model):
    towers = (np.arange(40)[:, None] // 10 + np.arange(40) // 10) % 2
    heights = (1000.0 * towers).astype(np.float32)
    np.savez(tmp_path / "cliff.npz", elevation_m=heights, cell_size_m=1.0)
    terrain = (str(tmp_path / "cliff.npz"),)
    load = Load(terrain, workloads=("limit20",), sizes=(40,), queries=2, near=0, min_distance=0.6)
    planners = rivals_of(Networks(str(tiny_model)), Device((0,)))
    with pytest.raises(InvalidQueryError, match="wanted 2 queries with a path"):
        run(planners, load, [0])
