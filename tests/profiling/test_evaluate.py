"""`nnpp-edge evaluate`: rows of planners on the same queries."""

from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.profiling.evaluate import evaluate, evaluated
from nnpp_edge.profiling.rivals import controls, exact_and
from nnpp_edge.profiling.suites import dems_of, terrain_cases
from nnpp_edge.runtime import Ground, NetworkModel, Planner, Status
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.synthetic import synthetic_terrain

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


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("terrain") / "dem.npz"
    dem = synthetic_terrain(np.random.default_rng(4), 160, 5.0)
    np.savez(path, elevation_m=dem, cell_size_m=5.0)
    return path


def test_a_row_for_each_workload_size_and_planner(nnpp_edge, terrain, tiny_model):
    words = "--workload soft,limit15 --sizes 64,128 --queries 12 --repeats 1 --json"
    more = ("--methods", "corridor,nnpp", "--model", tiny_model)
    ended = nnpp_edge("evaluate", "--terrain", terrain, *words.split(), *more)
    assert ended.code == 0, ended.err
    rows = ended.json
    named = [f"{row['workload']} {row['size']} {row['method']}" for row in rows]
    places = [f"{name} {size}" for name in ("soft", "limit15") for size in (64, 128)]
    assert named == [f"{at} {method}" for at in places for method in METHODS]
    for row in rows:
        assert set(row) >= {*KEYS.split()}
        assert (row["n"], row["success"]) == (12, 1.0)
        assert -1e-5 <= row["gap_mean"] <= row["gap_p99"] + 1e-9 <= row["gap_max"] + 1e-9
        found = row["success_raw"] + row["widened_share"] + row["whole_map_share"]
        assert found == pytest.approx(1.0)
        exact = row["method"] == "astar"
        assert (row["gap_max"] == 0.0 and row["mm_mean"] is None) or not exact
        assert exact or 0.0 < row["mm_mean"] < 1.0 >= row["region_share_mean"] > 0.0


def test_a_fresh_map_is_timed_from_its_elevations_on(nnpp_edge, terrain, tiny_model):
    words = ("--sizes", 96, "--queries", 5, "--model", tiny_model, "--repeats", 1, "--fresh-map")
    ended = nnpp_edge("evaluate", "--terrain", terrain, *words, "--json")
    assert ended.code == 0, ended.err
    rows = {row["method"]: row for row in ended.json}
    assert list(rows) == [each for name in METHODS for each in (name, f"{name}-eager")]
    for name in METHODS:
        lazy = rows[name]
        eager = rows[f"{name}-eager"]
        for row in (lazy, eager):
            assert np.isfinite([row[key] for key in FRESH_KEYS.split()]).all()
            assert 0.0 < row["fresh_ms_median"] <= row["fresh_ms_p99"]
        assert eager["costs_computed_mean"] == 1.0 >= lazy["costs_computed_mean"] > 0.0
        assert lazy["fresh_gap_mean"] == pytest.approx(eager["fresh_gap_mean"], abs=1e-6)
        assert all(lazy[key] == eager[key] for key in KEYS.split() if key != "method")
        if not name.startswith("nnpp"):  # whose lazy planner shows the network a sample of the map
            assert lazy["gap_mean"] == pytest.approx(lazy["fresh_gap_mean"], abs=1e-6)
    assert rows["astar-eager"]["fresh_speedup_median"] == 1.0
    table = nnpp_edge("evaluate", "--terrain", terrain, *words).out
    for word in (" nnpp ", "speed-up", "fallback", " corridor-narrow-eager "):
        assert word in table


def test_the_narrow_corridor_is_the_learned_regions_without_a_network():
    """It searches no more than the usual corridor, and where that is too narrow it widens and looks
    everywhere. An untrained network, whose region is the whole map, finds the same paths.
    """
    case = next(terrain_cases(dems_of(()), "soft", 256))
    bands, untrained = controls()
    narrow = bands.planner(Ground(case.cost))
    other_control = untrained.planner(Ground(case.cost))
    probability = untrained.model.answer((5.0, 6.0), (50.0, 40.0))
    assert probability.min() > untrained.model.metadata.region_factor * probability.max()
    usual = Planner(case.cost)
    for start, goal in case.queries:
        plan = narrow.plan(start, goal, method="corridor", keep_regions=True)
        other = usual.plan(start, goal, method="corridor", keep_regions=True)
        assert plan.ok and plan.region.area() <= other.region.area()
        assert plan.cost >= plan.lower_bound * (1.0 - 1e-6)
        same = untrained.plan(other_control, (start, goal))
        assert same.method == "nnpp" and same.cost == pytest.approx(plan.cost)
    walled = case.cost.copy()
    walled[:, 80] = np.inf
    shut_in = bands.planner(Ground(walled))
    assert shut_in.plan((4, 4), (4, 150), method="corridor").status == Status.NO_PATH


def test_two_models_stand_beside_each_other(terrain, tiny_model):
    model = NetworkModel(tiny_model)
    rivals = exact_and(["nnpp", "astar"], {"one": model, "two": model})
    assert [rival.name for rival in rivals] == ["astar", "nnpp", "nnpp:two"]
    cases = terrain_cases(dems_of((terrain,)), "soft", 64)
    _, one, two = evaluated(evaluate(cases, rivals, 4, repeats=1))
    assert one["gap_mean"] == two["gap_mean"]


def test_limits_and_weight_of_ones_own_are_taken(nnpp_edge, terrain):
    words = "--sizes 64 --queries 6 --repeats 1 --methods astar --json"

    def judged(*more):
        return nnpp_edge("evaluate", "--terrain", terrain, *words.split(), *more)

    def cc(*more):
        return judged(*more).json[0]["cc_mean"]

    assert cc("--omega", 0.05) < cc() != cc("--limit", "roughness_limit_m=2")
    own = ("--workload", "limit20", "--limit", "hard_slope_deg=15")
    judged(*own).refused("leave out --limit")


def test_a_held_out_stripe_is_evaluated_alone(nnpp_edge, terrain):
    """Its size decides, and the error says which sizes fit."""
    words = ("evaluate", "--terrain", terrain, "--methods", "astar", "--queries", 1, "--repeats", 1)
    held_out = (*words, "--held-out", "--validation-share", 0.25)
    nnpp_edge(*held_out, "--sizes", 64).refused("--sizes 40 is the largest that fits")
    assert nnpp_edge(*held_out, "--sizes", 16, "--json").json[0]["n"] == 1
    nnpp_edge(*words, "--held-out").refused("go together")


def test_terrain_without_two_passable_cells_is_refused():
    steep = np.indices((24, 24), np.float32)[0]
    dem = Dem(steep, 1.0, 1.0, None, Path("dem.npz"))
    with pytest.raises(InvalidQueryError, match="no two passable cells"):
        next(terrain_cases([dem], "limit1", 20))
