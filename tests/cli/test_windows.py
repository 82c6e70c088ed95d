"""`plan` on rasters that are read by windows: the same answers, and nothing half-written."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio.shutil

from nnpp_edge.runtime.map.along import Numbers
from nnpp_edge.terrain import rasters
from nnpp_edge.terrain.synthetic import synthetic_terrain
from tests.strategies import flat
from tests.terrain.test_dem import geotiff

SMALL = "--memory 100kB"
ENDS = "--start 5,5 --goal 290,380"
TILED = {
    "compress": "deflate",
    "tiled": True,
    "blockxsize": 64,
    "blockysize": 64,
    "crs": "EPSG:32615",
}
LIMIT = "--workload limit25 --limit roughness_limit_m=3 --limit step_limit_m=3"


@pytest.fixture
def ground(run):
    """ground.tif, tiled, with a hole."""
    heights = synthetic_terrain(np.random.default_rng(3), 400, 2.0)[:300]
    heights[100:104, 50:90] = np.nan
    geotiff("ground.tif", heights, nodata=np.nan, **TILED)


def test_a_plan_by_windows_is_that_of_the_map_in_memory(run, told, ground):
    words = f"plan ground.tif {ENDS} {LIMIT} --via 250,100 --via 60,200 --best-order"
    whole = told(f"{words} --method corridor -o whole")
    ended = run(f"{words} -o windows {SMALL} --json")
    assert ended.code == 0
    assert (
        "warning: 300 × 400 cells need 2.9 MB in memory, 100.0 kB are allowed: read by windows"
        in ended.err
    )
    found = ended.json
    assert found["via"]["stops"] == whole["via"]["stops"]
    same = ("cost", *Numbers._fields)
    for one, other in (
        (found, whole),
        *zip(found["via"]["legs"], whole["via"]["legs"], strict=True),
    ):
        assert [one[name] for name in same] == [other[name] for name in same]
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
        for memory in (SMALL, ""):
            *_, last = run(f"plan bad.tif {ENDS} -o out {memory}").err.splitlines()
            assert last.startswith("error: bad.tif: ")
            assert list(Path("out").iterdir()) == []


def test_a_raster_stored_as_one_block_is_not_read_by_windows(run, ground, monkeypatch):
    monkeypatch.setattr(rasters, "_MOST_BLOCK_BYTES", 200_000)
    geotiff("one.tif", flat(300, 400), blockysize=300, compress="deflate", crs="EPSG:32615")
    run(f"plan one.tif {ENDS} {SMALL}").refused(
        "stored in blocks of 300 × 400 cells", "gdal_translate -of COG"
    )
    assert run(f"plan ground.tif {ENDS} {SMALL}").code == 0
