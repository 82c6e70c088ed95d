import json

import numpy as np
import pytest

from nnpp_edge.profiling.evaluate import evaluate
from nnpp_edge.profiling.rivals import exact_and, narrow_corridor
from nnpp_edge.profiling.suites import TerrainFiles, terrain_cases
from nnpp_edge.runtime import Ground, NetworkModel, Planner, Status
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.synthetic import synthetic_terrain

KEYS = {
    *(
        "workload",
        "size",
        "method",
        "n",
        "success_raw",
        "success",
        "gap_mean",
        "gap_p95",
        "gap_p99",
        "gap_max",
    ),
    *("time_ms_median", "time_ms_p99", "speedup_median", "speedup_total", "expansions_median"),
    *("region_share_mean", "widened_share", "whole_map_share", "mm_mean"),
}
FRESH_KEYS = {
    *("fresh_ms_median", "fresh_ms_p99", "fresh_speedup_median", "fresh_gap_mean", "fresh_gap_p99"),
    "costs_computed_mean",
}


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("terrain") / "dem.npz"
    dem = synthetic_terrain(np.random.default_rng(4), 160, 5.0)
    np.savez(path, elevation_m=dem, cell_size_m=5.0)
    return path


def test_a_row_for_each_workload_size_and_planner(nnpp_edge, terrain, tiny_model):
    words = (
        "--workload",
        "soft,limit15",
        "--sizes",
        "64,128",
        "--queries",
        12,
        "--methods",
        "corridor,nnpp",
    )
    ended = nnpp_edge("evaluate", terrain, *words, "--model", tiny_model, "--repeats", 1, "--json")
    assert ended.code == 0, ended.err
    rows = json.loads(ended.out)
    assert [(r["workload"], r["size"], r["method"]) for r in rows] == [
        (w, s, m)
        for w in ("soft", "limit15")
        for s in (64, 128)
        for m in ("astar", "corridor", "nnpp")
    ]
    for row in rows:
        assert set(row) >= KEYS
        assert (row["n"], row["success"]) == (12, 1.0)
        assert -1e-5 <= row["gap_mean"] <= row["gap_p99"] + 1e-9 <= row["gap_max"] + 1e-9
        assert row["success_raw"] + row["widened_share"] + row["whole_map_share"] == pytest.approx(
            1.0
        )
        assert row["time_ms_median"] <= row["time_ms_p99"]
        if row["method"] == "astar":
            assert row["gap_max"] == 0.0
            assert row["speedup_total"] == row["speedup_median"] == 1.0
            assert row["mm_mean"] is None
        else:
            assert 0.0 < row["region_share_mean"] <= 1.0
            assert 0.0 < row["mm_mean"] < 1.0


def test_a_fresh_map_is_timed_from_its_elevations_on(nnpp_edge, terrain, tiny_model):
    words = ("--sizes", 96, "--queries", 5, "--model", tiny_model, "--repeats", 1, "--fresh-map")
    ended = nnpp_edge("evaluate", terrain, *words, "--json")
    assert ended.code == 0, ended.err
    rows = {row["method"]: row for row in json.loads(ended.out)}
    names = ("astar", "corridor", "nnpp", "corridor-narrow")
    assert list(rows) == [each for name in names for each in (name, f"{name}-eager")]
    for row in rows.values():
        assert set(row) >= KEYS | FRESH_KEYS and row["n"] == 5
        assert all(np.isfinite(row[key]) for key in FRESH_KEYS)
        assert 0.0 < row["fresh_ms_median"] <= row["fresh_ms_p99"]
        assert 0.0 < row["costs_computed_mean"] <= 1.0
        assert -1e-5 <= row["fresh_gap_mean"] <= row["fresh_gap_p99"] + 1e-9
    for name in names:
        lazy = rows[name]
        eager = rows[f"{name}-eager"]
        assert eager["costs_computed_mean"] == 1.0
        assert lazy["fresh_gap_mean"] == pytest.approx(eager["fresh_gap_mean"], abs=1e-6)
        assert all(lazy[key] == eager[key] for key in KEYS - {"method"})
        if name != "nnpp":  # whose lazy planner shows the network a sample of the map
            assert lazy["gap_mean"] == pytest.approx(lazy["fresh_gap_mean"], abs=1e-6)
    assert rows["astar-eager"]["fresh_speedup_median"] == 1.0
    ended = nnpp_edge("evaluate", terrain, *words, "--markdown")
    assert ended.code == 0
    assert all(
        word in ended.out
        for word in ("| nnpp |", "speed-up", "fallback", "| corridor-narrow-eager |")
    )


def test_the_narrow_corridor_is_the_learned_regions_without_a_network(terrain):
    """It searches no more than the usual corridor, and where that is too narrow it widens and looks
    everywhere.
    """
    case = next(terrain_cases(TerrainFiles((terrain,)).read(), "soft", 160))
    narrow = narrow_corridor().planner(Ground(case.cost))
    usual = Planner(case.cost)
    for start, goal in case.queries:
        plan = narrow.plan(start, goal, method="corridor", keep_regions=True)
        other = usual.plan(start, goal, method="corridor", keep_regions=True)
        assert plan.ok and plan.region.area() <= other.region.area()
        assert plan.cost >= plan.lower_bound * (1.0 - 1e-6)
    walled = case.cost.copy()
    walled[:, 80] = np.inf
    assert (
        narrow_corridor().planner(Ground(walled)).plan((4, 4), (4, 150), method="corridor").status
        == Status.NO_PATH
    )


def test_the_same_seed_asks_the_same(terrain):
    dems = TerrainFiles((terrain,)).read()
    first, second = (next(terrain_cases(dems, "soft", 64, seed=3)) for _ in range(2))
    assert first.queries == second.queries
    np.testing.assert_array_equal(first.cost, second.cost)
    assert min(np.hypot(a[0] - b[0], a[1] - b[1]) for a, b in first.queries) >= 0.35 * 64
    assert next(terrain_cases(dems, "soft", 64, seed=4)).queries != first.queries


def test_two_models_stand_beside_each_other(terrain, tiny_model):
    model = NetworkModel(tiny_model)
    rivals = exact_and(["nnpp", "astar"], {"one": model, "two": model})
    assert [rival.name for rival in rivals] == ["astar", "nnpp", "nnpp:two"]
    rows = evaluate(
        terrain_cases(TerrainFiles((terrain,)).read(), "soft", 64), rivals, 4, repeats=1
    )
    assert rows["nnpp"]["gap_mean"] == rows["nnpp:two"]["gap_mean"]


def test_limits_and_weight_of_ones_own_are_taken(nnpp_edge, terrain):
    words = (
        "evaluate",
        terrain,
        "--sizes",
        64,
        "--queries",
        6,
        "--repeats",
        1,
        "--methods",
        "astar",
        "--json",
    )

    def cc(*more):
        return json.loads(nnpp_edge(*words, *more).out)[0]["cc_mean"]

    assert cc("--omega", 0.05) < cc() != cc("--limit", "roughness_limit_m=2")
    nnpp_edge(*words, "--workload", "limit20", "--limit", "hard_slope_deg=15").refused(
        "leave out --limit"
    )


def test_terrain_without_two_passable_cells_is_refused(tmp_path):
    np.savez(tmp_path / "dem.npz", elevation_m=np.indices((24, 24), np.float32)[0], cell_size_m=1.0)
    with pytest.raises(InvalidQueryError, match="no two passable cells"):
        next(terrain_cases(TerrainFiles((tmp_path / "dem.npz",)).read(), "limit1", 20))
