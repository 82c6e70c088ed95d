"""Metres of the ground, whatever a map's system draws; cells and slopes in many:
`tests.fuzz.projections`.
"""

import math

import numpy as np
import pyproj
import pytest
import rasterio

from nnpp_edge.terrain.dem import read_dem
from tests.terrain.test_dem import geotiff

MARS = "IAU_2015:49900"


def written(path, crs, lon, lat, side, heights):
    """A GeoTIFF of these heights, north up, whose middle lies there."""
    globe = pyproj.CRS(crs).geodetic_crs
    degrees = globe.axis_info[0].unit_conversion_factor / math.radians(1.0)
    x, y = pyproj.Transformer.from_crs(globe, crs, always_xy=True).transform(
        lon / degrees,
        lat / degrees,
    )
    rows, cols = heights.shape
    left = x - side * cols / 2
    top = y + side * rows / 2
    corner = rasterio.Affine(side, 0, left, 0, -side, top)
    tiles = {"tiled": True, "blockxsize": 16, "blockysize": 16}
    return geotiff(path, heights, crs=crs, transform=corner, **tiles)


@pytest.mark.parametrize("more", [(), ("--memory", "10kB")])
def test_a_plan_is_as_long_as_the_geodesic(tmp_path, nnpp_edge, more):
    path = written(tmp_path / "map.tif", "EPSG:3857", 11.0, 60.0, 30.0, np.zeros((64, 64)))
    words = "--start 5,8 --goal 5,58 --method corridor --json"
    ended = nnpp_edge("plan", path, *words.split(), *more)
    dem = read_dem(path)
    lonlat = pyproj.Transformer.from_crs("EPSG:3857", "EPSG:4326", always_xy=True)
    ends = [lonlat.transform(*dem.map_coordinates(5, col)) for col in (8, 58)]
    wanted = pyproj.Geod(ellps="WGS84").inv(*ends[0], *ends[1])[2]
    assert ended.json["length_m"] == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize(
    ("crs", "lon", "lat", "side", "told"),
    [
        ("EPSG:32633", 15.0, 50.0, 1.0, None),
        (MARS, 20.0, 80.0, 0.01, None),
        (MARS, 20.0, 80.0, 0.1, "up to 19 % off"),
        ("ESRI:54008", 90.0, 50.0, 10.0, "up to 77 % off"),  # sinusoidal: skewed on small maps too
        ("+proj=sinu", 90.0, 50.0, 10.0, "map.tif: a system without a name: some"),
    ],
)
def test_lengths_that_are_off_on_the_map_are_told(tmp_path, recwarn, crs, lon, lat, side, told):
    path = written(tmp_path / "map.tif", crs, lon, lat, side, np.zeros((40, 40)))
    recwarn.clear()
    read_dem(path)
    said = [str(each.message) for each in recwarn if "lengths and slopes" in str(each.message)]
    assert len(said) == (told is not None) and all(told in words for words in said)
    recwarn.clear()
    assert read_dem(path, cell_size_m=5.0).cell_size_m == 5.0 and not recwarn.list


def test_a_map_whose_middle_lies_off_the_globe_is_taken_as_drawn(tmp_path):
    far = rasterio.Affine(7, 0, 3e7, 0, -7, 9e6)
    path = geotiff(tmp_path / "a.tif", np.zeros((9, 9)), crs="ESRI:54009", transform=far)
    with pytest.warns(UserWarning, match="does not reach the map's middle"):
        assert read_dem(path).cell_size_m == 7.0
