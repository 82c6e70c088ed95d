"""Metres of the ground, whatever a map's coordinate system draws: cells, lengths and slopes, and what is told."""

import json
import math

import numpy as np
import pyproj
import pytest
import rasterio

from nnpp_edge.terrain.dem import open_dem, read_dem

MARS, MOON = "IAU_2015:49900", "IAU_2015:30100"
SYSTEMS = [  # system, longitude and latitude of the middle, side of a cell in the system's unit
    ("EPSG:3857", 11.0, 60.0, 1.0),
    ("EPSG:3857", -70.0, -33.0, 25.0),
    ("EPSG:32633", 17.9, 50.0, 1.0),
    ("EPSG:2263", -74.0, 40.7, 3.0),
    ("EPSG:3413", 20.0, 84.0, 10.0),
    ("EPSG:5972", 9.0, 60.0, 2.0),
    ("EPSG:4326", 8.0, 46.0, 1e-4),
    ("EPSG:4807", 2.0, 48.0, 1e-4),
    ("IAU_2015:49910", 20.0, 60.0, 20.0),
    ("IAU_2015:30130", 20.0, 86.0, 20.0),
    (MOON, 20.0, -60.0, 0.001),
]


def written(path, crs, lon, lat, side, heights):
    """A GeoTIFF of these heights, north up, whose middle lies there."""
    globe = pyproj.CRS(crs).geodetic_crs
    degrees = globe.axis_info[0].unit_conversion_factor / math.radians(1.0)
    x, y = pyproj.Transformer.from_crs(globe, crs, always_xy=True).transform(lon / degrees, lat / degrees)
    rows, cols = heights.shape
    corner = rasterio.Affine(side, 0, x - side * cols / 2, 0, -side, y + side * rows / 2)
    kind = {"driver": "GTiff", "height": rows, "width": cols, "count": 1, "dtype": "float32", "tiled": True}
    with rasterio.open(path, "w", crs=crs, transform=corner, blockxsize=16, blockysize=16, **kind) as file:
        file.write(heights.astype(np.float32), 1)
    return path


def ground(crs, points):
    """(N - 1,) metres between points (N, 2) in a system, by the radii of curvature of its ellipsoid."""
    system = pyproj.CRS(crs)
    to_globe = pyproj.Transformer.from_crs(system, system.geodetic_crs, always_xy=True)
    lon, lat = np.array(to_globe.transform(*np.transpose(points)))
    lon, lat = (each * system.geodetic_crs.axis_info[0].unit_conversion_factor for each in (lon, lat))
    a, b = system.ellipsoid.semi_major_metre, system.ellipsoid.semi_minor_metre
    mean = 0.5 * (lat[1:] + lat[:-1])
    across = a / np.sqrt(1.0 - (1.0 - b**2 / a**2) * np.sin(mean) ** 2)
    along = across**3 * (b / a**2) ** 2
    return np.hypot(along * np.diff(lat), across * np.cos(mean) * np.diff(lon))


@pytest.mark.filterwarnings("ignore:.* draws a metre of ground")
def test_cells_are_as_long_as_the_ground_under_them(tmp_path):
    for crs, *middle in SYSTEMS:
        path = written(tmp_path / "map.tif", crs, *middle, np.zeros((40, 60)))
        dem = read_dem(path)
        column = ground(crs, [dem.map_coordinates(row, 29.5) for row in (0, 39)])[0] / 39.0
        row = ground(crs, [dem.map_coordinates(19.5, col) for col in (0, 59)])[0] / 59.0
        assert (dem.cell_size_m, dem.cell_width_m) == pytest.approx((column, row), rel=1e-5), crs
        with open_dem(path) as windows:
            assert (windows.cell_size_m, windows.cell_width_m) == (dem.cell_size_m, dem.cell_width_m)


@pytest.mark.parametrize("more", [(), ("--memory", "10kB")])
def test_a_plan_is_as_long_as_the_geodesic_and_the_projections_scale_is_told(tmp_path, nnpp_edge, more):
    path = written(tmp_path / "map.tif", "EPSG:3857", 11.0, 60.0, 30.0, np.zeros((64, 64)))
    ended = nnpp_edge("plan", path, "--start", "5,8", "--goal", "5,58", "--method", "corridor", "--json", *more)
    with pytest.warns(UserWarning, match="draws a metre"):
        dem = read_dem(path)
    wanted = ground("EPSG:3857", [dem.map_coordinates(5, col) for col in (8, 58)])[0]
    assert json.loads(ended.out)["length_m"] == pytest.approx(wanted, rel=1e-3)
    assert "draws a metre of ground at the map's middle as 1.998 m along columns and 1.995 m" in ended.err


def test_lengths_that_are_off_on_the_map_are_told(tmp_path, recwarn):
    for *system, side, told in (
        ("EPSG:32633", 15.0, 50.0, 1.0, None),
        (MARS, 20.0, 80.0, 0.01, None),
        (MARS, 20.0, 80.0, 0.1, "up to 19 % off"),
        ("ESRI:54008", 90.0, 50.0, 10.0, "up to 77 % off"),  # sinusoidal: skewed even on a small map
    ):
        path = written(tmp_path / "map.tif", *system, side, np.zeros((40, 40)))
        recwarn.clear()
        read_dem(path)
        words = [str(each.message) for each in recwarn if "some lengths and slopes" in str(each.message)]
        assert len(words) == (told is not None) and all(told in word for word in words)
        recwarn.clear()
        assert read_dem(path, cell_size_m=5.0).cell_size_m == 5.0 and not recwarn.list


def test_a_map_whose_middle_lies_off_the_globe_is_taken_as_drawn(tmp_path):
    kind = {"driver": "GTiff", "height": 9, "width": 9, "count": 1, "dtype": "float32", "crs": "ESRI:54009"}
    with rasterio.open(tmp_path / "a.tif", "w", transform=rasterio.Affine(7, 0, 3e7, 0, -7, 9e6), **kind) as file:
        file.write(np.zeros((9, 9), np.float32), 1)
    with pytest.warns(UserWarning, match="no place for the map's middle"):
        assert read_dem(tmp_path / "a.tif").cell_size_m == 7.0
