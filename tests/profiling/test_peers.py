import json
import sys

import numpy as np
import pytest

from nnpp_edge.benchmarks import peers
from nnpp_edge.benchmarks.peers import peer_planners
from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime import Ground

SOLVE_THE_SAME = ("astar", "skimage.graph", "scipy dijkstra")
OTHERS = {"pyastar2d": "pyastar2d", "skimage.graph": "skimage", "scipy dijkstra": "scipy"}


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("terrain") / "dem.npz"
    steps = np.random.default_rng(4).normal(0.0, 0.4, (80, 90))
    dem = np.cumsum(steps, axis=1).astype(np.float32)
    np.savez(path, elevation_m=dem, cell_size_m=5.0)
    return path


def test_a_row_for_each_size_and_planner(nnpp_edge, terrain, tmp_path):
    words = "profile --peers --sizes 64,96 --queries 12 --json"
    ended = nnpp_edge(*words.split(), "--terrain", terrain, "-o", tmp_path / "out")
    assert ended.code == 0, ended.err
    told = json.loads(ended.out)
    found, missing = peer_planners()
    assert told["left_out"] == missing
    places = [(row["size"], row["terrain"]) for row in told["rows"]]
    assert places == [(64, "dem")] * len(found) + [(96, "synthetic")] * len(found)
    assert [row["planner"] for row in told["rows"]] == 2 * [planner.name for planner in found]
    for row in told["rows"]:
        assert (row["n"], row["failed"], row["note"]) == (12, 0, "")
        assert 0.0 < row["time_ms_median"] <= row["time_ms_p95"]
        assert row["gap_max"] >= row["gap_mean"] >= -1e-6
        if row["planner"] in SOLVE_THE_SAME:
            assert row["same_optimum"], row
        if row["planner"] == "astar":
            assert row["times_astar_median"] == 1.0 and row["gap_max"] == 0.0
    assert json.loads((tmp_path / "out" / "peers.json").read_text()) == told


def test_libraries_that_are_not_installed_are_named_and_left_out(nnpp_edge, terrain, monkeypatch):
    for module in OTHERS.values():
        monkeypatch.setitem(sys.modules, module, None)
    ended = nnpp_edge("profile", "--peers", "--terrain", terrain, "--sizes", 64, "--queries", 2)
    assert ended.code == 0, ended.err
    last = ended.out.splitlines()[-1]
    for word in ("left out, not installed: ", "[bench]", "pyastar2d", "scikit-image", "scipy"):
        assert word in last
    assert "corridor" in ended.out and "skimage.graph" not in ended.out


def one_map(cost, *queries):
    cost = cost.astype(np.float32)
    return iter([Case("made", len(cost), cost, queries, Ground(cost))])


def test_a_planner_over_the_limit_is_left_out_and_says_so(monkeypatch):
    monkeypatch.setattr(peers, "LIMIT_S", 1e-9)
    planners = [p for p in peer_planners()[0] if p.name in ("astar", "corridor")]
    level = one_map(np.full((40, 40), 0.2), ((0, 0), (39, 39)))
    rows = peers.compare(planners, level, 1)
    assert rows["corridor"]["note"] == "left out: 0.0 s a query, over the limit of 1e-09 s"
    assert rows["corridor"]["n"] == 0 and rows["corridor"]["time_ms_median"] is None
    assert rows["astar"]["n"] == 1


def test_obstacles_are_obstacles_to_all_and_queries_without_a_path_are_passed_over():
    cost = np.random.default_rng(5).uniform(0.0, 0.9, (32, 32))
    cost[:30, 16] = np.inf
    cost[20:23, 3:6] = np.inf
    cost[21, 4] = 0.1  # an island
    found, _ = peer_planners()
    queries = [
        ((2, 2), (2, 30)),
        ((2, 2), (21, 4)),
        ((30, 1), (1, 29)),
    ]
    rows = peers.compare(found, one_map(cost, *queries), 3)
    for name, row in rows.items():
        assert (row["n"], row["failed"]) == (2, 0), name
        assert row["same_optimum"] or name not in SOLVE_THE_SAME
        assert np.isfinite(row["gap_max"]), name


def test_a_paths_cost_is_length_times_mean_weight():
    weights = np.array([[1.0, 2.0], [4.0, 8.0]], np.float32)
    path = np.array([(0, 0), (0, 1), (1, 0), (1, 0)])
    assert peers.path_cost(weights, path) == pytest.approx(1.5 + 3.0 * np.sqrt(2.0))
    jump = np.array([(0, 0), (0, 2)])
    assert peers.path_cost(np.ones((3, 3), np.float32), jump) == np.inf
