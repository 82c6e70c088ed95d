"""`nnpp-edge evaluate` with a vehicle: its workloads, its rows and its poses."""

import math
from dataclasses import replace
from itertools import product, repeat

import numpy as np
import pytest

from nnpp_edge.profiling.evaluate import evaluate, evaluated
from nnpp_edge.profiling.rivals import exact_and
from nnpp_edge.profiling.suites import dems_of, terrain_cases, whole_cost
from nnpp_edge.runtime import Planner, Vehicle, pose_costs
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.workloads import body_rocks, workload

CELL_M = 0.25
ROVER = Vehicle(length_m=1.0, width_m=0.8, clearance_m=0.3)
SIZE = 96
WORDS = f"--sizes {SIZE} --queries 4 --methods corridor --repeats 1"
FRESH = "fresh_ms_median fresh_ms_p99 fresh_gap_mean fresh_gap_p99 costs_computed_mean"


@pytest.fixture(scope="module")
def terrain(ground_file):
    return ground_file(128, CELL_M)


@pytest.fixture(scope="module")
def rover(tmp_path_factory):
    path = tmp_path_factory.mktemp("vehicle") / "rover.toml"
    path.write_text("length_m = 1.0\nwidth_m = 0.8\nclearance_m = 0.3\n")
    return path


@pytest.fixture(scope="module")
def rocky(terrain):
    """A case with rocks, of the vehicle."""
    return next(terrain_cases(dems_of((terrain,)), "body-rocks5", SIZE, vehicle=ROVER))


@pytest.fixture
def judged(nnpp_edge, terrain, rover):
    """Run `evaluate` on maps of 96 × 96 with a vehicle and these words more."""
    words = ("evaluate", "--terrain", terrain, "--vehicle", rover, *WORDS.split())
    return lambda *more: nnpp_edge(*words, *more)


def test_each_workload_has_rows_of_the_corridor_and_exact_search(judged):
    ended = judged("--workload", "body,body-rocks5,soft", "--fresh-map", "--json")
    assert ended.code == 0, ended.err
    told = ended.json
    methods = ("astar", "astar-eager", "corridor", "corridor-eager")
    wanted = [*product(("body", "body-rocks5", "soft"), methods)]
    assert [(row["workload"], row["method"]) for row in told] == wanted
    for lazy, eager in zip(told[::2], told[1::2], strict=True):
        assert (lazy["n"], lazy["success"]) == (4, 1.0)
        if lazy["workload"] == "soft":
            assert "checks_mean" not in lazy
            continue
        assert eager["checks_share_mean"] == 1.0 > lazy["checks_share_mean"] > 0.0
        in_cell = lazy["checks_mean"] / (SIZE**2 * lazy["checks_share_mean"])
        assert in_cell > 16 and in_cell == pytest.approx(round(in_cell)), "of legs and turns"
        assert np.isfinite([lazy[key] for key in FRESH.split()]).all()
        for row in (lazy, eager):
            assert lazy["gap_mean"] == pytest.approx(row["fresh_gap_mean"], abs=1e-6)
        assert lazy["gap_mean"] >= -1e-5
        if lazy["method"] == "astar":
            assert lazy["gap_max"] == 0.0 and lazy["whole_map_share"] == 0.0
            assert eager["fresh_speedup_median"] == 1.0
    table = judged("--workload", "body").out
    assert "poses" in table and "speed-up" not in table  # that of points


def test_counts_are_those_of_planners_that_have_checked_nothing(rocky):
    """Each query by a planner of its own; the cost is that of an exact search of all poses."""
    every = Planner(rocky.ground, lazy=False)
    checks = []
    gaps = []
    for query in rocky.queries:
        optimum = every.plan(*query, method="astar")
        if optimum.ok:
            plan = Planner(rocky.ground).plan(*query, method="corridor")
            checks.append(plan.checks)
            gaps.append(plan.cost / optimum.cost - 1.0)
    rivals = exact_and(["corridor"], {})
    exact, row = evaluated(evaluate([rocky], rivals, len(gaps), repeats=1))
    assert (exact["method"], row["method"]) == ("astar", "corridor")
    assert (exact["n"], exact["unsolvable"]) == (len(gaps), 10 - len(gaps))
    assert row["checks_mean"] == pytest.approx(np.mean(checks))
    assert row["gap_mean"] == pytest.approx(np.mean(gaps), abs=1e-6)


def test_the_vehicle_stands_on_starts_and_goals_and_rocks_lie_on_the_crops(terrain, rocky):
    costs = pose_costs(rocky.ground.elevation, CELL_M, ROVER)
    for start, goal in rocky.queries:
        assert np.isfinite(costs[:, *start]).any()
        assert np.isfinite(costs[:, *goal]).any()
        assert math.dist(start, goal) >= 0.35 * SIZE
    np.testing.assert_array_equal(rocky.cost, costs.min(0))
    dems = dems_of((terrain,))
    again = next(terrain_cases(dems, "body-rocks5", SIZE, vehicle=ROVER))
    bare = next(terrain_cases(dems, "body", SIZE, vehicle=ROVER))
    np.testing.assert_array_equal(again.ground.elevation, rocky.ground.elevation)
    raised = rocky.ground.elevation - bare.ground.elevation
    assert raised.min() >= 0.0 and 0.0 < np.mean(raised > 0.05) < 0.5
    whole = terrain_cases(dems, "body-rocks5", 128, vehicle=ROVER)
    assert (next(whole).ground.elevation != next(whole).ground.elevation).any(), "other rocks"


def test_synthetic_ground_has_four_cells_to_a_body():
    case = next(terrain_cases((), "body", 64, vehicle=ROVER))
    assert case.ground.cell_size_m == pytest.approx(0.25)
    assert any(map(case.connections(), case.queries))


def test_maps_without_any_path_are_not_asked_forever(rocky):
    """Of a body that is held up everywhere: it stands on islands."""
    walled = np.zeros((48, 48), np.float32)
    walled[:, 20:28] = 5.0
    ground = replace(rocky.ground, elevation=walled)
    query = ((24, 8), (24, 40))
    case = replace(rocky, ground=ground, cost=whole_cost(ground), queries=(query,))
    with pytest.raises(
        InvalidQueryError, match=r"wanted 1 queries with a path .* found 0 on 20 maps"
    ):
        evaluate(repeat(case), exact_and(["astar"], {}), 1, repeats=1)


def test_a_body_workload_names_its_rocks():
    named = {"body": 0, "body-rocks10": 0.1, "body-rocks2.5": 0.025, "soft": None}
    assert {name: body_rocks(name) for name in named} == named
    for name in ("body-rocks", "body-rocks-1", "body-rocksnan", "body-rocks21"):
        with pytest.raises(InvalidQueryError, match="percent"):
            body_rocks(name)
    with pytest.raises(InvalidQueryError, match="vehicle"):
        workload("body")
