"""Our planners beside other libraries': the command, and the comparison on maps made by hand."""

import json
import sys
from itertools import product

import numpy as np
import pytest

from nnpp_edge.benchmarks import peers
from nnpp_edge.benchmarks.peers import peer_planners
from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime import Ground

SOLVE_THE_SAME = ("astar", "skimage.graph", "scipy dijkstra")


@pytest.fixture(scope="module")
def terrain(ground_file):
    return ground_file(80, 5.0)


def test_a_row_for_each_size_and_planner(nnpp_edge, terrain, tmp_path):
    words = ["--terrain", terrain, "--sizes", "64,96", "--queries", 12, "--json", "-o", tmp_path]
    ended = nnpp_edge("profile", "--peers", *words)
    assert ended.code == 0, ended.err
    facts = ended.json
    found, missing = peer_planners()
    assert facts["left_out"] == missing
    rows = facts["rows"]
    places = product(((64, "dem"), (96, "synthetic")), found)
    wanted = [(*place, planner.name) for place, planner in places]
    assert [(row["size"], row["terrain"], row["planner"]) for row in rows] == wanted
    for row in rows:
        assert (row["n"], row["failed"]) == (12, 0)
        assert 0.0 < row["time_ms_median"] <= row["time_ms_p95"]
        assert row["gap_max"] >= row["gap_mean"] >= -1e-6
        assert row["same_optimum"] or row["planner"] not in SOLVE_THE_SAME
    assert (rows[0]["times_astar_median"], rows[0]["gap_max"]) == (1.0, 0.0)
    assert json.loads((tmp_path / "peers.json").read_text()) == facts


def test_libraries_that_are_not_installed_are_named_and_left_out(nnpp_edge, terrain, monkeypatch):
    for module in ("pyastar2d", "skimage", "scipy"):
        monkeypatch.setitem(sys.modules, module, None)
    ended = nnpp_edge("profile", "--peers", "--terrain", terrain, "--sizes", 64, "--queries", 2)
    assert ended.code == 0, ended.err
    *table, last = ended.out.splitlines()
    assert last.startswith("left out, not installed: ")
    for words in ("[bench]", "pyastar2d", "scikit-image", "scipy"):
        assert words in last
    assert any("corridor" in line for line in table)
    assert not any("skimage.graph" in line for line in table)


def test_obstacles_are_obstacles_to_all_and_queries_without_a_path_are_passed_over():
    """Two of three queries have one."""
    cost = np.random.default_rng(5).uniform(0.0, 0.9, (32, 32)).astype(np.float32)
    cost[:30, 16] = np.inf
    cost[20:23, 3:6] = np.inf
    cost[21, 4] = 0.1  # an island
    queries = (((2, 2), (2, 30)), ((2, 2), (21, 4)), ((30, 1), (1, 29)))
    case = Case("made", 32, cost, queries, Ground(cost))
    for row in peers.compare(peer_planners()[0], [case], 2):
        assert (row["n"], row["failed"]) == (2, 0), row
        assert row["same_optimum"] or row["planner"] not in SOLVE_THE_SAME
        assert np.isfinite(row["gap_max"]), row
