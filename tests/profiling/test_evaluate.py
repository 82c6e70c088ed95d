"""`nnpp-edge evaluate`: rows of planners on the same queries."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.profiling.evaluate import evaluate, evaluated
from nnpp_edge.profiling.rivals import controls, exact_and
from nnpp_edge.profiling.suites import dems_of, terrain_cases
from nnpp_edge.runtime import Ground, NetworkModel, Planner, Status
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.dem import Dem

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
def terrain(ground_file):
    return ground_file(160, 5.0)


def test_each_planner_has_a_row_lazily_and_eagerly(nnpp_edge, terrain, tiny_model):
    words = "--workload soft,limit15 --sizes 64,128 --queries 6 --repeats 1 --fresh-map --json"
    more = ("--methods", "corridor,nnpp", "--model", tiny_model)
    ended = nnpp_edge("evaluate", "--terrain", terrain, *words.split(), *more)
    assert ended.code == 0, ended.err
    told = ended.json
    places = product(("soft", "limit15"), (64, 128), METHODS, ("", "-eager"))
    wanted = [(workload, size, name + end) for workload, size, name, end in places]
    assert [(row["workload"], row["size"], row["method"]) for row in told] == wanted
    for lazy, eager in zip(told[::2], told[1::2], strict=True):
        assert all(lazy[key] == eager[key] for key in KEYS.split() if key != "method")
        assert (lazy["n"], lazy["success"]) == (6, 1.0)
        assert -1e-5 <= lazy["gap_mean"] <= lazy["gap_p99"] + 1e-9 <= lazy["gap_max"] + 1e-9
        found = lazy["success_raw"] + lazy["widened_share"] + lazy["whole_map_share"]
        assert found == pytest.approx(1.0)
        exact = lazy["method"] == "astar"
        assert (lazy["gap_max"] == 0.0 and lazy["mm_mean"] is None) or not exact
        assert exact or 0.0 < lazy["mm_mean"] < 1.0 >= lazy["region_share_mean"] > 0.0
        assert not exact or eager["fresh_speedup_median"] == 1.0
        assert np.isfinite([row[key] for row in (lazy, eager) for key in FRESH_KEYS.split()]).all()
        assert eager["costs_computed_mean"] == 1.0 >= lazy["costs_computed_mean"] > 0.0
        assert lazy["fresh_gap_mean"] == pytest.approx(eager["fresh_gap_mean"], abs=1e-6)
        if "nnpp" not in lazy["method"]:  # its lazy planner shows the network a sample of the map
            assert lazy["gap_mean"] == pytest.approx(lazy["fresh_gap_mean"], abs=1e-6)


def test_the_table_has_both(nnpp_edge, terrain):
    words = "--sizes 64 --queries 1 --repeats 1 --fresh-map --methods corridor"
    table = nnpp_edge("evaluate", "--terrain", terrain, *words.split()).out
    for word in (" corridor ", "speed-up", "fallback", " astar-eager "):
        assert word in table


def test_the_narrow_corridor_is_the_learned_regions_without_a_network():
    """It searches no more than the usual corridor, and where that is too narrow it widens and looks
    everywhere. An untrained network, whose region is the whole map, finds the same paths.
    """
    case = next(terrain_cases(dems_of(()), "soft", 256))
    bands, untrained = controls()
    narrow = bands.planner(Ground(case.cost))
    other_control = untrained.planner(Ground(case.cost))
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
    cases = terrain_cases(dems_of((terrain,)), "soft", 64)
    exact, one, two = evaluated(evaluate(cases, rivals, 2, repeats=1))
    assert (exact["method"], one["method"], two["method"]) == ("astar", "nnpp", "nnpp:two")
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
