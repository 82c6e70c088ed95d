import json

import numpy as np
import pytest

from nnpp_edge.profiling.evaluate import evaluate
from nnpp_edge.profiling.rivals import exact_and
from nnpp_edge.profiling.suites import TerrainFiles, dataset_cases, terrain_cases
from nnpp_edge.runtime import NetworkModel
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.dataset import Recipe, make_dataset
from nnpp_edge.terrain.synthetic import synthetic_terrain

KEYS = {
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
    "time_ms_median",
    "time_ms_p99",
    "speedup_median",
    "speedup_total",
    "expansions_median",
    "region_share_mean",
    "widened_share",
    "whole_map_share",
    "mm_mean",
}


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("terrain") / "dem.npz"
    dem = synthetic_terrain(np.random.default_rng(4), 160, 5.0)
    np.savez(path, elevation_m=dem, cell_size_m=5.0)
    return path


def test_a_row_for_each_workload_size_and_planner(nnpp_edge, terrain, tiny_model):
    ended = nnpp_edge(
        "evaluate",
        "--terrain",
        terrain,
        "--workload",
        "soft,limit15",
        "--sizes",
        "64,128",
        "--queries",
        12,
        "--methods",
        "corridor,nnpp",
        "--model",
        tiny_model,
        "--repeats",
        1,
        "--json",
    )
    assert ended.code == 0, ended.err
    rows = json.loads(ended.out)
    assert [(r["workload"], r["size"], r["method"]) for r in rows] == [
        (w, s, m) for w in ("soft", "limit15") for s in (64, 128) for m in ("astar", "corridor", "nnpp")
    ]
    for row in rows:
        assert set(row) >= KEYS
        assert (row["n"], row["success"]) == (12, 1.0)
        assert -1e-5 <= row["gap_mean"] <= row["gap_p99"] + 1e-9 <= row["gap_max"] + 1e-9
        assert row["success_raw"] + row["widened_share"] + row["whole_map_share"] == pytest.approx(1.0)
        assert row["time_ms_median"] <= row["time_ms_p99"]
        if row["method"] == "astar":
            assert row["gap_max"] == 0.0
            assert row["speedup_total"] == row["speedup_median"] == 1.0
            assert row["mm_mean"] is None
        else:
            assert 0.0 < row["region_share_mean"] <= 1.0
            assert 0.0 < row["mm_mean"] < 1.0


def test_the_table_names_every_planner(nnpp_edge, terrain, tiny_model):
    ended = nnpp_edge("evaluate", terrain, "--sizes", 64, "--queries", 5, "--model", tiny_model, "--repeats", 1)
    assert ended.code == 0
    for word in ("astar", "corridor", "nnpp", "speed-up", "fallback"):
        assert word in ended.out


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
    rows = evaluate(terrain_cases(TerrainFiles((terrain,)).read(), "soft", 64), rivals, 4, repeats=1)
    assert rows["nnpp"]["gap_mean"] == rows["nnpp:two"]["gap_mean"]


def test_a_data_set_can_be_judged_by(tmp_path, tiny_model, nnpp_edge):
    make_dataset(Recipe((), maps=8, size=64, blocks=16, poolings=((1, 1.0),)), tmp_path / "set", workers=1)
    case = next(dataset_cases(tmp_path / "set", "soft"))
    assert case.size == 64
    assert all(np.isfinite(case.cost[start]) for start, _ in case.queries)
    ended = nnpp_edge("evaluate", "--dataset", tmp_path / "set", "--queries", 5, "--model", tiny_model, "--json")
    assert ended.code == 0, ended.err
    assert {row["size"] for row in json.loads(ended.out)} == {64}
    ended = nnpp_edge("evaluate", "--dataset", tmp_path / "set", "--queries", 2, "--methods", "corridor", "--json")
    assert {row["size"] for row in json.loads(ended.out)} == {64}
    ended = nnpp_edge("evaluate", "--dataset", tmp_path / "set", "--workload", "limit3", "--model", tiny_model)
    ended.refused("limit3")


def test_wrong_use_is_one_line(nnpp_edge, terrain, tiny_model, bad_dem):
    assert nnpp_edge("evaluate").code == 2
    assert nnpp_edge("evaluate", terrain, "--methods", "best").code == 2
    nnpp_edge("evaluate", terrain, "--sizes", 512, "--model", tiny_model).refused("at least 512 × 512 cells")
    nnpp_edge("evaluate", terrain, "--model", "nosuch").refused("nosuch")
    path, word = bad_dem
    nnpp_edge("evaluate", path, "--model", tiny_model).refused(word)


def test_terrain_without_two_passable_cells_is_refused(tmp_path):
    np.savez(tmp_path / "dem.npz", elevation_m=np.indices((24, 24), np.float32)[0], cell_size_m=1.0)
    with pytest.raises(InvalidQueryError, match="no two passable cells"):
        next(terrain_cases(TerrainFiles((tmp_path / "dem.npz",)).read(), "limit1", 20))
