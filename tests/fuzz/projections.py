"""Planes of known slope anywhere on the Earth, the Moon and Mars, in many systems, beside
geodesics.
"""

import functools
import math
import re
import warnings

import numpy as np
import pyproj
import rasterio

from nnpp_edge.runtime.terrain.traversability import terrain_terms
from nnpp_edge.terrain.dem import open_dem, read_dem
from tests.fuzz.cases import Finding
from tests.terrain.test_dem import geotiff

SYSTEMS = """
EPSG:3857 -180 180 -84 84
EPSG:4326 -180 180 -89 89
EPSG:32633 5 25 0 84
EPSG:32733 9 21 -80 0
EPSG:3413 -180 180 40 89.9
EPSG:3031 -180 180 -89.9 -50
EPSG:2154 -5 10 41 52
EPSG:3035 -15 40 33 70
EPSG:2263 -75 -72 40 42
EPSG:27700 -8 2 49 61
EPSG:4807 -5 10 41 52
EPSG:5972 5 12 57 72
ESRI:54008 -170 170 -80 80
ESRI:54009 -150 150 -75 75
IAU_2015:30100 -179 179 -88 88
IAU_2015:30110 -179 179 -85 85
IAU_2015:30130 -180 180 60 89.9
IAU_2015:49910 -179 179 -85 85
IAU_2015:49935 -180 180 -89.9 -60
"""
"""The longitudes and latitudes at which each is used, and beyond."""
WITHIN = 0.03
SLOPE_WITHIN = 0.035
CELL_WITHIN = 2e-6
"""By which share a length, the tangent of a slope and the middle cell may be off where no warning
tells of more.
"""


@functools.lru_cache(maxsize=64)
def globe_of(crs):
    """To the system's longitude and latitude, degrees in their unit, geodesics, and about metres
    in x's.
    """
    system = pyproj.CRS(crs)
    globe = system.geodetic_crs
    degrees = math.degrees(globe.axis_info[0].unit_conversion_factor)
    unit = system.axis_info[0].unit_conversion_factor
    if system.is_geographic:
        unit *= system.ellipsoid.semi_major_metre
    there = pyproj.Transformer.from_crs(system, globe, always_xy=True)
    return there, degrees, system.get_geod(), unit


class Plane:
    """A plane on a map anywhere that its system is used."""

    def __init__(self, rng):
        crs, *bounds = rng.choice(SYSTEMS.split("\n")[1:-1]).split()
        west, east, south, north = map(float, bounds)
        self.crs = crs
        self.there, self.degrees, self.geod, unit = globe_of(crs)
        self.middle = rng.uniform(west, east), rng.uniform(south, north)
        self.shape = rng.choice((5, 12, 30, 60)), rng.choice((5, 12, 30, 60))
        self.slope_deg = rng.uniform(2.0, 50.0)
        # cells are drawn as large as if metres were those of the ground, oblong or turned
        cell = 10.0 ** rng.uniform(-0.7, 3.0) / unit
        wider = rng.choice((1.0, 1.0, 1.0, 0.5, 1.7))
        turned = rasterio.Affine.rotation(rng.choice((0.0, 0.0, 0.0, rng.uniform(-180.0, 180.0))))
        degrees = (angle / self.degrees for angle in self.middle)
        x, y = self.there.transform(*degrees, direction="INVERSE")
        rows, cols = self.shape
        to_corner = rasterio.Affine.translation(-cols / 2, -rows / 2)
        drawn = turned * rasterio.Affine.scale(wider * cell, -cell)
        self.affine = rasterio.Affine.translation(x, y) * drawn * to_corner
        towards = rng.uniform(0.0, 360.0)
        lon, lat = self.lonlat(np.argwhere(np.ones(self.shape, bool)))
        begin = (np.full(len(lon), angle) for angle in self.middle)
        azimuth, _, metres = self.geod.inv(*begin, lon, lat)
        along = metres * np.cos(np.radians(np.asarray(azimuth) - towards))
        heights = math.tan(math.radians(self.slope_deg)) * along
        self.heights = heights.reshape(self.shape)

    def lonlat(self, cells):
        """(2, N) degrees of the middles of cells (N, 2)."""
        x, y = self.affine * (cells[:, 1] + 0.5, cells[:, 0] + 0.5)
        return self.degrees * np.array(self.there.transform(x, y))

    def metres(self, cells):
        """(N - 1,) of the geodesics from cell to cell."""
        lon, lat = self.lonlat(cells)
        return np.asarray(self.geod.inv(lon[:-1], lat[:-1], lon[1:], lat[1:])[2])


def check(rng, place):
    """Slope beside that which the plane was made with, and lengths of steps beside geodesics."""
    plane = Plane(rng)
    if not np.isfinite(plane.heights).all():
        return  # beyond the system's own bounds
    path = geotiff(place.folder / "map.tif", plane.heights, crs=plane.crs, transform=plane.affine)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        dem = read_dem(path)
        with open_dem(path) as windows:
            in_windows = windows.cell_size_m, windows.cell_width_m
    sides = np.array((dem.cell_size_m, dem.cell_width_m))
    facts = f"{sides}\n{vars(plane)}"
    if in_windows != tuple(sides):
        raise Finding("other cells in windows", facts)
    off = [re.search(r"up to (\d+) % off", str(each.message)) for each in told]
    told_off = max((float(found[1]) / 100.0 for found in off if found), default=0.0)
    middle = 0.5 * np.array(plane.shape) - 0.5
    for side, half in zip(sides, 0.5 * np.eye(2), strict=True):
        across = plane.metres(np.stack((middle - half, middle + half)))[0]
        if abs(across / side - 1.0) > CELL_WITHIN:
            raise Finding("another side of a cell", facts)
    if not told_off:
        slopes = terrain_terms(dem.elevation, cell_size_m=sides[0], cell_width_m=sides[1])[0]
        slope = slopes[plane.shape[0] // 2, plane.shape[1] // 2]
        if abs(math.tan(slope) / math.tan(math.radians(plane.slope_deg)) - 1.0) > SLOPE_WITHIN:
            raise Finding("another slope", f"{math.degrees(slope):.3f}° {facts}")
    ends = [[rng.randrange(1, side - 1) for side in plane.shape] for _ in range(2)]
    cells = np.unique(np.linspace(*ends, 40).round().astype(int), axis=0)
    found = np.hypot(*(np.diff(cells, axis=0) * sides).T)
    off_by = np.abs(plane.metres(cells) / found - 1.0).max(initial=0.0)
    if off_by > max(WITHIN, told_off) + 0.006:
        raise Finding("another length of a step", f"{off_by:.4f}, told {told_off} {facts}")
