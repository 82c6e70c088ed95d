"""`nnpp-edge evaluate`: rows of planners on the same queries, of a point and of a vehicle."""

import math
from dataclasses import replace
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.profiling.evaluate import evaluate, evaluated
from nnpp_edge.profiling.rivals import controls, exact_and
from nnpp_edge.profiling.suites import dems_of, terrain_cases, whole_cost
from nnpp_edge.runtime import Ground, NetworkModel, Planner, Status, Vehicle, pose_costs
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.workloads import body_rocks, workload

METHODS = ("astar", "corridor", "nnpp", "corridor-narrow", "nnpp-untrained")
KEYS = (
    "workload size method n success_raw success gap_mean gap_p95 gap_p99 gap_max time_ms_median "
    "time_ms_p99 speedup_median speedup_total expansions_median region_share_mean widened_share "
    "whole_map_share mm_mean"
)
FRESH_KEYS = (
    "fresh_ms_median fresh_ms_p99 fresh_speedup_median fresh_gap_mean fresh_gap_p99 "
    "costs_computed_mean"
)
CELL_M = 0.25
ROVER = Vehicle(length_m=1.0, width_m=0.8, clearance_m=0.3)
SIZE = 96


@pytest.fixture(scope="module")
def terrain(ground_file):
    return ground_file(160, CELL_M)


@pytest.fixture(scope="module")
def rocky(terrain):
    """A case with rocks, of the vehicle."""
    return next(terrain_cases(dems_of((terrain,)), "body-rocks5", SIZE, vehicle=ROVER))


@pytest.fixture
def judged(nnpp_edge, terrain):
    """Run `evaluate` with these words."""
    words = ("evaluate", "--terrain", terrain, "--repeats", 1)
    return lambda *more: nnpp_edge(*words, *more)


def test_each_planner_has_a_row_lazily_and_eagerly(judged, tiny_model, write_toml):
    rover = write_toml("length_m = 1.0\nwidth_m = 0.8\nclearance_m = 0.3\n")
    words = "--workload soft,limit15,body,body-rocks5 --sizes 64,160 --queries 4 --fresh-map"
    more = ("--methods", "corridor,nnpp", "--model", tiny_model, "--vehicle", rover)
    ended = judged(*words.split(), *more, "--json")
    assert ended.code == 0, ended.err
    told = ended.json
    wanted = [
        (workload, size, name + end)
        for workload in ("soft", "limit15", "body", "body-rocks5")
        for size in (64, 160)
        for name in METHODS[: 2 if workload.startswith("body") else None]
        for end in ("", "-eager")
    ]
    assert [(row["workload"], row["size"], row["method"]) for row in told] == wanted
    for lazy, eager in zip(told[::2], told[1::2], strict=True):
        assert all(lazy[key] == eager[key] for key in KEYS.split() if key != "method")
        assert (lazy["n"], lazy["success"]) == (4, 1.0)
        assert -1e-5 <= lazy["gap_mean"] <= lazy["gap_p99"] + 1e-9 <= lazy["gap_max"] + 1e-9
        found = lazy["success_raw"] + lazy["widened_share"] + lazy["whole_map_share"]
        assert found == pytest.approx(1.0)
        if lazy["method"] == "astar":
            assert lazy["gap_max"] == 0.0 and lazy["mm_mean"] is None
            assert eager["fresh_speedup_median"] == 1.0
        else:
            assert 0.0 < lazy["mm_mean"] < 1.0 >= lazy["region_share_mean"] > 0.0
        assert np.isfinite([row[key] for row in (lazy, eager) for key in FRESH_KEYS.split()]).all()
        assert lazy["fresh_gap_mean"] == pytest.approx(eager["fresh_gap_mean"], abs=1e-6)
        if "nnpp" not in lazy["method"]:  # its lazy planner shows the network a sample of the map
            assert lazy["gap_mean"] == pytest.approx(lazy["fresh_gap_mean"], abs=1e-6)
        assert ("checks_mean" in lazy) == lazy["workload"].startswith("body")
        if "checks_mean" in lazy:
            assert eager["checks_share_mean"] == 1.0 > lazy["checks_share_mean"] > 0.0
            in_cell = lazy["checks_mean"] / (lazy["size"] ** 2 * lazy["checks_share_mean"])
            assert in_cell > 16 and in_cell == pytest.approx(round(in_cell)), "of legs and turns"
        else:
            assert eager["costs_computed_mean"] == 1.0 >= lazy["costs_computed_mean"] > 0.0


def test_the_tables_are_of_standing_and_of_fresh_maps_or_of_bodies(judged):
    words = "--sizes 64 --queries 1 --methods corridor"
    table = judged(*words.split(), "--fresh-map").out
    for word in (" corridor ", "speed-up", "fallback", " astar-eager "):
        assert word in table
    table = judged(*words.split(), "--workload", "body", "--vehicle", "small-rover").out
    assert "poses" in table and "speed-up" not in table


def test_the_narrow_corridor_is_the_learned_regions_without_a_network():
    """It searches no more than the usual corridor, and where that is too narrow it widens and looks
    everywhere. An untrained network, whose region is the whole map, finds the same paths.
    """
    case = next(terrain_cases(dems_of(()), "soft", 256))
    bands, untrained = controls()
    narrow = bands.on(Ground(case.cost))
    other_control = untrained.on(Ground(case.cost))
    usual = Planner(case.cost)
    for start, goal in case.queries:
        plan = narrow((start, goal), keep_regions=True)
        other = usual.plan(start, goal, method="corridor", keep_regions=True)
        assert plan.ok and plan.region.area() <= other.region.area()
        assert plan.cost >= plan.lower_bound * (1.0 - 1e-6)
        same = other_control((start, goal))
        assert same.method == "nnpp" and same.cost == pytest.approx(plan.cost)
    walled = case.cost.copy()
    walled[:, 80] = np.inf
    shut_in = bands.on(Ground(walled))
    assert shut_in(((4, 4), (4, 150))).status == Status.NO_PATH


def test_several_models_stand_beside_each_other(tiny_model):
    model = NetworkModel(tiny_model)
    rivals = exact_and(["nnpp", "astar"], {"one": model, "two": model})
    assert [rival.name for rival in rivals] == ["astar", "nnpp", "nnpp:two"]


def test_limits_and_weight_of_ones_own_are_taken(judged):
    words = ["--sizes", "64", "--queries", "6", "--methods", "astar", "--json"]

    def cc(*more):
        return judged(*words, *more).json[0]["cc_mean"]

    assert cc("--omega", 0.05) < cc() != cc("--limit", "roughness_limit_m=2")
    own = ("--workload", "limit20", "--limit", "hard_slope_deg=15")
    judged(*words, *own).refused("leave out --limit")


def test_a_held_out_stripe_is_evaluated_alone(judged):
    """Its size decides, and the error says which sizes fit."""
    words = ("--methods", "astar", "--queries", 1, "--held-out")
    stripe = (*words, "--validation-share", 0.25, "--sizes")
    judged(*stripe, 64).refused("--sizes 40 is the largest that fits")
    assert judged(*stripe, 16, "--json").json[0]["n"] == 1
    judged(*words).refused("go together")


def test_terrain_without_two_passable_cells_is_refused():
    steep = np.indices((24, 24), np.float32)[0]
    dem = Dem(steep, 1.0, 1.0, None, Path("dem.npz"))
    with pytest.raises(InvalidQueryError, match="no two passable cells"):
        next(terrain_cases([dem], "limit1", 20))


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
    assert exact["n"] == len(gaps) and 0 < exact["unsolvable"] <= 10 - len(gaps)
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
    whole = terrain_cases(dems, "body-rocks5", 160, vehicle=ROVER)
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
