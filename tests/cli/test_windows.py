"""`plan` and `costmap` on rasters that are read by windows: the same answers, and nothing half-written."""

import json
import os
import signal
import subprocess
import sys

import cv2
import numpy as np
import pytest
import rasterio
import rasterio.shutil

from nnpp_edge.terrain.synthetic import synthetic_terrain

SMALL = ("--memory", "100kB")
ENDS = ("--start", "5,5", "--goal", "290,380")
LIMIT = ("--workload", "limit25", "--limit", "roughness_limit_m=3", "--limit", "step_limit_m=3")


def refused(ended, *words):
    """Exit code 2, and after notes and progress one line with the error."""
    last = ended.err.splitlines()[-1]
    assert ended.code == 2 and last.startswith("error: ") and ended.err.count("error") == 1, ended.err
    assert all(word in last for word in words), last


def write(path, heights, place=True, **kind):
    where = {"crs": "EPSG:32615", "transform": rasterio.Affine(2, 0, 4e5, 0, -2, 5e6)} if place else {}
    rows, cols = heights.shape
    kind = {"driver": "GTiff", "compress": "deflate", "tiled": True, "blockxsize": 64, "blockysize": 64, **kind}
    with rasterio.open(
        path, "w", width=cols, height=rows, count=1, dtype=heights.dtype, nodata=np.nan, **where, **kind
    ) as dataset:
        dataset.write(heights, 1)
    return path


@pytest.fixture
def ground(tmp_path):
    """A tiled GeoTIFF with a hole."""
    heights = synthetic_terrain(np.random.default_rng(3), 400, 2.0)[:300]
    heights[100:104, 50:90] = np.nan
    return write(tmp_path / "ground.tif", heights)


def test_a_plan_by_windows_is_that_of_the_map_in_memory(nnpp_edge, ground, tmp_path):
    words = ("plan", ground, *ENDS, *LIMIT, "--json", "--method")
    whole = json.loads(nnpp_edge(*words, "corridor", "-o", tmp_path / "whole").out)
    ended = nnpp_edge(*words, "auto", "-o", tmp_path / "windows", *SMALL)
    assert ended.code == 0
    assert "warning: 300 × 400 cells need 2.9 MB in memory, 0.1 MB are allowed: read by windows" in ended.err
    told = json.loads(ended.out)
    same = ("status", "method", "source", "cost", "length", "lower_bound", "bound", "expansions", "length_m", "rows")
    assert [told[name] for name in same] == [whole[name] for name in same]
    assert told["windows"]["peak_memory_gb"] > 0.0 and told["windows"]["read_again"] > 0.0
    for name in ("path.geojson", "path.csv"):
        assert (tmp_path / "windows" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert cv2.imread(str(tmp_path / "windows" / "plan.png")) is not None
    assert "by windows" in nnpp_edge("plan", ground, *ENDS, *LIMIT, *SMALL).out


def test_vrt_of_tiles_and_rescaling_and_places(nnpp_edge, ground, tmp_path):
    (tmp_path / "map.vrt").write_text(
        '<VRTDataset rasterXSize="400" rasterYSize="300"><SRS>EPSG:32615</SRS>'
        "<GeoTransform>400000, 2, 0, 5000000, 0, -2</GeoTransform>"
        '<VRTRasterBand dataType="Float32" band="1"><NoDataValue>nan</NoDataValue><SimpleSource>'
        '<SourceFilename relativeToVRT="1">ground.tif</SourceFilename><SourceBand>1</SourceBand>'
        '<SrcRect xOff="0" yOff="0" xSize="400" ySize="300"/><DstRect xOff="0" yOff="0" xSize="400" ySize="300"/>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    words = ("plan", tmp_path / "map.vrt", "--allow-vrt", "--rescale", 1, "--start", "xy:400011,4999989", "--json")
    words = (*words, "--goal", "200,200", "--goal", "290,380", *LIMIT)
    whole = json.loads(nnpp_edge(*words, "--method", "corridor").out)
    told = json.loads(nnpp_edge(*words, *SMALL).out)
    assert told["start"] == whole["start"] == [5, 5]
    for name in ("goal", "goals", "cost", "length_m", "cell_size_m"):
        assert told[name] == whole[name]


def test_unknown_ground_and_walls_are_outcomes(nnpp_edge, tmp_path):
    nothing = write(tmp_path / "nothing.tif", np.full((300, 400), np.nan, np.float32))
    refused(nnpp_edge("plan", nothing, *ENDS, *SMALL), "all impassable")
    heights = np.zeros((300, 400), np.float32)
    heights[150] = np.nan
    ended = nnpp_edge("plan", write(tmp_path / "split.tif", heights), *ENDS, *SMALL)
    assert ended.code == 1 and ended.out.startswith("NO_PATH")


def test_a_broken_cog_is_one_line_and_nothing_half_written(nnpp_edge, ground, tmp_path):
    cog, bad, folder = (tmp_path / name for name in ("cog.tif", "bad.tif", "out"))
    rasterio.shutil.copy(ground, cog, driver="COG", compress="DEFLATE", blocksize=128)
    folder.mkdir()
    content = cog.read_bytes()
    at = len(content) * 7 // 10
    for broken in (content[:at] + b"\xff" * 2000 + content[at + 2000 :], content[:at]):
        bad.write_bytes(broken)
        for words in (("plan", bad, *ENDS, "-o", folder), ("costmap", bad, "-o", folder / "cost.tif")):
            for memory in (SMALL, ()):
                refused(nnpp_edge(*words, *memory), "bad.tif: ")
                assert list(folder.iterdir()) == []


def test_a_raster_stored_as_one_block_is_not_read_by_windows(nnpp_edge, ground, monkeypatch, tmp_path):
    from nnpp_edge.terrain import dem_windows

    monkeypatch.setattr(dem_windows, "_MOST_BLOCK_BYTES", 200_000)
    path = write(tmp_path / "one.tif", np.zeros((300, 400), np.float32), tiled=False, blockysize=300)
    refused(nnpp_edge("plan", path, *ENDS, *SMALL), "stored in blocks of 300 × 400 cells", "gdal_translate -of COG")
    assert nnpp_edge("plan", ground, *ENDS, *SMALL).code == 0


def test_a_cost_map_written_as_a_stream_is_that_of_the_whole_map(nnpp_edge, ground, tmp_path):
    a, b = (tmp_path / name / "cost.tif" for name in "ab")
    a.parent.mkdir()
    b.parent.mkdir()
    whole = json.loads(nnpp_edge("costmap", ground, "-o", a, *LIMIT, "--json").out)
    ended = nnpp_edge("costmap", ground, "-o", b, *LIMIT, "--json", *SMALL)
    assert "read by windows" in ended.err
    told = json.loads(ended.out)
    assert (told["rows"], told["passable_share"]) == (whole["rows"], whole["passable_share"])
    for share, cost in whole["cost_quantiles"].items():
        assert told["cost_quantiles"][share] == pytest.approx(cost, abs=1e-4)
    for term, share in whole["saturated_share"].items():
        assert told["saturated_share"][term] == pytest.approx(share, abs=0.01)
    with rasterio.open(a) as one, rasterio.open(b) as other:
        np.testing.assert_array_equal(one.read(1), other.read(1))
        assert (one.crs, one.transform) == (other.crs, other.transform)
        assert np.isnan(other.nodata) and other.block_shapes == [(512, 512)]
    assert sorted(path.name for path in b.parent.iterdir()) == ["cost.png", "cost.tif"]
    assert cv2.imread(str(b.with_suffix(".png"))) is not None
    refused(nnpp_edge("costmap", ground, "-o", tmp_path / "cost.npz", *SMALL), ".tif")


def test_what_does_not_read_back_as_written_is_refused(tmp_path):
    from nnpp_edge.runtime.errors import OutputError
    from nnpp_edge.terrain.rasters import geotiff_stream

    refused = pytest.raises(OutputError, match="not what was written")
    with refused, geotiff_stream(tmp_path / "out.tif", (40, 30), None) as put:
        put(0, np.ones((40, 30), np.float32))
        put(20, np.zeros((20, 30), np.float32))  # overwrites what the first promised


@pytest.mark.parametrize(
    ("command", "number"), [("plan", signal.SIGTERM), ("costmap", signal.SIGTERM), ("costmap", signal.SIGKILL)]
)
def test_ended_half_way_it_leaves_no_output(tmp_path, command, number):
    path, folder = tmp_path / "large.tif", tmp_path / "out"
    folder.mkdir()
    write(path, np.zeros((2048, 16384), np.float32), blockxsize=512, blockysize=128)
    output = folder / "cost.tif" if command == "costmap" else folder / "plan"
    ends = ("--start", "5,5", "--goal", "2000,16000") if command == "plan" else ()
    words = (sys.executable, "-m", "nnpp_edge.cli.main", command, path, *ends, "-o", output, "--memory", "1MB")
    process = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    for line in process.stderr:
        if b": " in line and b" %" in line:  # the first progress
            os.kill(process.pid, number)
            break
    assert process.wait(60) != 0
    process.stderr.close()
    process.stdout.close()
    left = [each.name for each in folder.rglob("*") if each.is_file()]
    if number is signal.SIGKILL:  # then nobody can tidy up
        left = [name for name in left if not name.startswith(".")]
    assert left == []
