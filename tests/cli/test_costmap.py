"""`nnpp-edge costmap`: what it writes, what it says, what it refuses."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from nnpp_edge.runtime import Traversability, traversability_cost
from nnpp_edge.terrain.dem import read_dem
from tests.cli.grounds import PLACE


def test_a_geotiff_keeps_the_place_and_marks_what_is_impassable(run, hills):
    weights = "--limit slope_weight=0.3 --limit step_weight=0.5"
    ended = run(f"costmap hills.tif -o cost.tif --limit hard_slope_deg=15 {weights}")
    assert (ended.code, ended.err) == (0, "")
    limits = Traversability(hard_slope_deg=15, slope_weight=0.3, step_weight=0.5)
    cost = traversability_cost(hills, 2.0, limits)
    back = read_dem("cost.tif")
    np.testing.assert_array_equal(back.elevation, np.where(np.isinf(cost), np.nan, cost))
    assert back.georeference.transform == PLACE.transform and "SVY21" in back.georeference.crs
    assert np.isinf(cost).sum() > 40
    assert all(
        word in ended.out for word in ("80 × 90 cells of 2 m", "passable", "cost.tif", "cost.png")
    )
    assert cv2.imread("cost.png") is not None
    assert sorted(path.name for path in Path().iterdir()) == [
        "cost.png",
        "cost.tif",
        "hills.npz",
        "hills.tif",
    ]


def test_arrays_need_no_rasterio(run, hills, monkeypatch):
    np.savez("wide.npz", elevation_m=hills, cell_size_m=2.0, cell_width_m=3.0)
    monkeypatch.setitem(sys.modules, "rasterio", None)
    wanted = traversability_cost(hills, 2.0, cell_width_m=3.0)
    assert run("costmap wide.npz -o cost.npy").code == run("costmap wide.npz -o cost.npz").code == 0
    np.testing.assert_array_equal(np.load("cost.npy"), wanted)
    with np.load("cost.npz") as archive:
        np.testing.assert_array_equal(archive["cost"], wanted)
        assert (archive["cell_size_m"], archive["cell_width_m"]) == (2.0, 3.0)


def test_a_map_without_a_passable_cell_is_written_all_the_same(run):
    cliff = np.arange(30.0, dtype=np.float32) * np.ones((30, 1), np.float32)
    np.savez("cliff.npz", elevation_m=cliff, cell_size_m=1.0)
    ended = run("costmap cliff.npz -o cost.tif --workload limit20")
    assert ended.code == 0 and "0.00 % of cells" in ended.out and Path("cost.png").exists()
    assert ended.err.startswith("warning: ") and "slope" in ended.err


@pytest.mark.filterwarnings("error")
def test_cells_of_any_size_are_drawn(run, hills):
    for words in ("--cell-size 1e9", "--cell-size 1e-6", "--rescale 1e9", "--rescale 1e-6"):
        ended = run(f"costmap hills.npz -o cost.npy {words}")
        assert ended.code == 0 and "cost.png" in ended.out, ended.err
        assert Path("cost.png").stat().st_size > 1000
    run("costmap hills.npz -o cost.npy --cell-size 1e-9").refused("sides of 1e-06 to")
