"""`plan` and `costmap` on rasters that are read by windows: the same answers, and nothing
half-written.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
import rasterio.shutil

from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.terrain import dem as dems
from nnpp_edge.terrain.rasters import geotiff_stream
from nnpp_edge.terrain.synthetic import synthetic_terrain
from tests.strategies import flat

SMALL = "--memory 100kB"
ENDS = "--start 5,5 --goal 290,380"
LIMIT = "--workload limit25 --limit roughness_limit_m=3 --limit step_limit_m=3"


def refused(ended, *words):
    """Exit code 2, and after notes and progress one line with the error."""
    last = ended.err.splitlines()[-1]
    assert ended.code == 2 and last.startswith("error: ") and ended.err.count("error") == 1, (
        ended.err
    )
    assert all(word in last for word in words), last


def write(name, heights, **kind):
    rows, cols = heights.shape
    where = {
        "crs": "EPSG:32615",
        "transform": rasterio.Affine(2, 0, 4e5, 0, -2, 5e6),
        "nodata": np.nan,
    }
    kind = (
        {
            "driver": "GTiff",
            "compress": "deflate",
            "tiled": True,
            "blockxsize": 64,
            "blockysize": 64,
        }
        | kind
        | where
    )
    with rasterio.open(
        name, "w", width=cols, height=rows, count=1, dtype=heights.dtype, **kind
    ) as dataset:
        dataset.write(heights, 1)


@pytest.fixture
def ground(run):
    """ground.tif, tiled, with a hole."""
    heights = synthetic_terrain(np.random.default_rng(3), 400, 2.0)[:300]
    heights[100:104, 50:90] = np.nan
    write("ground.tif", heights)


def test_a_plan_by_windows_is_that_of_the_map_in_memory(run, told, ground):
    words = f"plan ground.tif {ENDS} {LIMIT}"
    whole = told(f"{words} --method corridor -o whole")
    ended = run(f"{words} -o windows {SMALL} --json")
    assert ended.code == 0
    assert (
        "warning: 300 × 400 cells need 2.9 MB in memory, 0.1 MB are allowed: read by windows"
        in ended.err
    )
    found = ended.json
    same = ("status", "method", "source", "cost", "length", "length_m", "rows")
    assert [found[name] for name in same] == [whole[name] for name in same]
    # in memory the bound knows the cheapest cell
    assert 0.9 * whole["lower_bound"] < found["lower_bound"] <= whole["cost"]
    tables = [
        np.genfromtxt(f"{folder}/path.csv", delimiter=",", skip_header=1)
        for folder in ("whole", "windows")
    ]
    np.testing.assert_allclose(*tables, rtol=1e-5)
    assert Path("windows", "path.geojson").exists()
    assert cv2.imread("windows/plan.png") is not None


def test_a_broken_cog_is_one_line_and_nothing_half_written(run, ground):
    rasterio.shutil.copy("ground.tif", "cog.tif", driver="COG", compress="DEFLATE", blocksize=128)
    Path("out").mkdir()
    content = Path("cog.tif").read_bytes()
    at = len(content) * 7 // 10
    for broken in (content[:at] + b"\xff" * 2000 + content[at + 2000 :], content[:at]):
        Path("bad.tif").write_bytes(broken)
        for words in (f"plan bad.tif {ENDS} -o out", "costmap bad.tif -o out/cost.tif"):
            for memory in (SMALL, ""):
                refused(run(f"{words} {memory}"), "bad.tif: ")
                assert list(Path("out").iterdir()) == []


def test_a_raster_stored_as_one_block_is_not_read_by_windows(run, ground, monkeypatch):
    monkeypatch.setattr(dems, "_MOST_BLOCK_BYTES", 200_000)
    write("one.tif", flat(300, 400), tiled=False, blockysize=300)
    refused(
        run(f"plan one.tif {ENDS} {SMALL}"),
        "stored in blocks of 300 × 400 cells",
        "gdal_translate -of COG",
    )
    assert run(f"plan ground.tif {ENDS} {SMALL}").code == 0


def test_a_cost_map_written_as_a_stream_is_that_of_the_whole_map(run, told, ground):
    for folder in ("a", "b"):
        Path(folder).mkdir()
    whole = told(f"costmap ground.tif -o a/cost.tif {LIMIT}")
    ended = run(f"costmap ground.tif -o b/cost.tif {LIMIT} {SMALL} --json")
    assert "read by windows" in ended.err
    found = ended.json
    assert (found["rows"], found["passable_share"]) == (whole["rows"], whole["passable_share"])
    assert (whole["rows"], whole["files"]) == (300, ["a/cost.tif", "a/cost.png"])
    with rasterio.open("a/cost.tif") as one, rasterio.open("b/cost.tif") as other:
        np.testing.assert_array_equal(one.read(1), other.read(1))
        assert whole["passable_share"] == pytest.approx(np.isfinite(one.read(1)).mean())
        assert (one.crs, one.transform) == (other.crs, other.transform)
        assert np.isnan(other.nodata) and other.block_shapes == [(512, 512)]
    assert sorted(path.name for path in Path("b").iterdir()) == ["cost.png", "cost.tif"]
    assert cv2.imread("b/cost.png") is not None


def test_what_does_not_read_back_as_written_is_refused(tmp_path):
    refused = pytest.raises(OutputError, match="not what was written")
    with refused, geotiff_stream(tmp_path / "out.tif", (40, 30), None) as put:
        put(0, flat(40, 30, 1.0))
        put(20, flat(20, 30))  # overwrites what the first promised


@pytest.mark.parametrize(
    ("command", "number"),
    [("plan", signal.SIGTERM), ("costmap", signal.SIGTERM), ("costmap", signal.SIGKILL)],
)
def test_ended_half_way_it_leaves_no_output(run, command, number):
    write("large.tif", flat(2048, 16384), blockxsize=512, blockysize=128)
    Path("out").mkdir()
    more = {"plan": "--start 5,5 --goal 2000,16000 -o out/plan", "costmap": "-o out/cost.tif"}[
        command
    ]
    words = f"-m nnpp_edge.cli.main {command} large.tif --memory 1MB {more}".split()
    with subprocess.Popen(
        [sys.executable, *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        for line in process.stderr:
            if b": " in line and b" %" in line:  # the first progress
                os.kill(process.pid, number)
                break
        assert process.wait(60) != 0
    left = [each.name for each in Path("out").rglob("*") if each.is_file()]
    if number is signal.SIGKILL:  # then nobody can tidy up
        left = [name for name in left if not name.startswith(".")]
    assert left == []
