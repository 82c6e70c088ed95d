"""`nnpp-edge costmap`: what it writes, what it says, what it refuses."""

import json
import sys

import cv2
import numpy as np
import pytest

from nnpp_edge.runtime import Traversability, traversability_cost
from nnpp_edge.terrain.dem import Dem, read_dem, write_raster
from tests.cli.grounds import PLACE


@pytest.fixture
def hills(tmp_path):
    """A hilly GeoTIFF with a hole, cells of 2 m, and its heights."""
    row, col = np.mgrid[0:60, 0:50]
    heights = (4.0 * np.sin(row / 6.0) * np.cos(col / 9.0)).astype(np.float32)
    heights[10:14, 20:30] = np.nan
    write_raster(tmp_path / "hills.tif", heights, Dem(heights, 2.0, 2.0, PLACE, tmp_path))
    return tmp_path / "hills.tif", heights


def test_a_geotiff_keeps_the_place_and_marks_what_is_impassable(nnpp_edge, hills, tmp_path):
    path, heights = hills
    ended = nnpp_edge("costmap", path, "-o", tmp_path / "cost.tif", "--limit", "hard_slope_deg=15")
    assert (ended.code, ended.err) == (0, "")
    cost = traversability_cost(heights, 2.0, Traversability(hard_slope_deg=15))
    back = read_dem(tmp_path / "cost.tif")
    np.testing.assert_array_equal(back.elevation, np.where(np.isinf(cost), np.nan, cost))
    assert back.georeference.transform == PLACE.transform and "SVY21" in back.georeference.crs
    assert np.isinf(cost).sum() > 40
    for word in ("60 × 50 cells of 2 m", "passable", "cost.tif", "cost.png"):
        assert word in ended.out
    assert cv2.imread(str(tmp_path / "cost.png")) is not None
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cost.png", "cost.tif", "hills.tif"]


def test_arrays_need_no_rasterio(nnpp_edge, hills, tmp_path, monkeypatch):
    _, heights = hills
    np.savez(tmp_path / "hills.npz", elevation_m=heights, cell_size_m=2.0, cell_width_m=3.0)
    monkeypatch.setitem(sys.modules, "rasterio", None)
    wanted = traversability_cost(heights, 2.0, cell_width_m=3.0)
    assert nnpp_edge("costmap", tmp_path / "hills.npz", "-o", tmp_path / "cost.npy").code == 0
    np.testing.assert_array_equal(np.load(tmp_path / "cost.npy"), wanted)
    assert nnpp_edge("costmap", tmp_path / "hills.npz", "-o", tmp_path / "cost.npz").code == 0
    with np.load(tmp_path / "cost.npz") as archive:
        np.testing.assert_array_equal(archive["cost"], wanted)
        assert (archive["cell_size_m"], archive["cell_width_m"]) == (2.0, 3.0)
    nnpp_edge("costmap", tmp_path / "hills.npz", "-o", tmp_path / "cost.tif").refused("nnpp-edge[geo]")


def test_json_tells_the_same_figures(nnpp_edge, hills, tmp_path):
    path, heights = hills
    words = ("costmap", path, "-o", tmp_path / "cost.npy", "--picture", tmp_path / "other.png", "--json")
    told = json.loads(nnpp_edge(*words, "--workload", "limit12").out)
    cost = np.load(tmp_path / "cost.npy")
    limits = Traversability(slope_limit_deg=12, hard_slope_deg=12)
    np.testing.assert_array_equal(cost, traversability_cost(heights, 2.0, limits))
    assert (told["rows"], told["cols"], told["cell_size_m"]) == (60, 50, 2.0)
    assert told["passable_share"] == pytest.approx(np.isfinite(cost).mean())
    assert told["cost_quantiles"]["0.5"] == pytest.approx(np.median(cost[np.isfinite(cost)]), abs=1e-5)
    known = np.isfinite(heights).sum()
    too_steep = np.isinf(cost).sum() - (heights.size - known)
    assert told["saturated_share"]["slope"] == pytest.approx(too_steep / known, abs=1e-5)
    assert told["files"] == [str(tmp_path / "cost.npy"), str(tmp_path / "other.png")]


def test_a_saturated_term_is_a_warning_and_leaves_stdout_to_the_result(nnpp_edge, tmp_path):
    rough = np.random.default_rng(2).uniform(0, 30, (40, 40)).astype(np.float32)
    np.savez(tmp_path / "rough.npz", elevation_m=rough, cell_size_m=50.0)
    ended = nnpp_edge("costmap", tmp_path / "rough.npz", "-o", tmp_path / "cost.npy", "--json")
    assert ended.code == 0 and json.loads(ended.out)
    assert ended.err.startswith("warning: ") and "elevation difference" in ended.err


def test_a_map_without_a_passable_cell_is_written_all_the_same(nnpp_edge, tmp_path):
    cliff = np.arange(30.0, dtype=np.float32) * np.ones((30, 1), np.float32)
    np.savez(tmp_path / "cliff.npz", elevation_m=cliff, cell_size_m=1.0)
    ended = nnpp_edge("costmap", tmp_path / "cliff.npz", "-o", tmp_path / "cost.tif", "--workload", "limit20")
    assert ended.code == 0 and "no cell is passable" in ended.out
    assert (tmp_path / "cost.png").exists()


def test_a_bad_elevation_map_is_one_line(nnpp_edge, bad_dem, tmp_path):
    path, word = bad_dem
    nnpp_edge("costmap", path, "-o", tmp_path / "out.tif").refused(word)
    assert not (tmp_path / "out.tif").exists()
