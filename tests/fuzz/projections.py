"""Planes of known slope anywhere on the Earth, the Moon and Mars, in many systems, beside
geodesics.
"""

import functools
import math
import re
import warnings
from typing import NamedTuple

import numpy as np
import pyproj
import rasterio

from nnpp_edge.runtime.terrain.traversability import terrain_terms
from nnpp_edge.terrain.dem import open_dem, read_dem
from tests.fuzz.cases import Finding

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


class Map(NamedTuple):
    """Where a plane lies, and how it rises."""

    crs: str
    middle: tuple[float, float]
    cell_m: float
    wider: float
    turned_deg: float
    shape: tuple[int, int]
    slope_deg: float
    towards_deg: float


def generate(rng):
    """A plane on a map anywhere that its system is used."""
    crs, *bounds = rng.choice(SYSTEMS.split("\n")[1:-1]).split()
    west, east, south, north = map(float, bounds)
    return Map(
        crs=crs,
        middle=(rng.uniform(west, east), rng.uniform(south, north)),
        cell_m=10.0 ** rng.uniform(-0.7, 3.0),
        wider=rng.choice((1.0, 1.0, 1.0, 0.5, 1.7)),
        turned_deg=rng.choice((0.0, 0.0, 0.0, rng.uniform(-180.0, 180.0))),
        shape=(rng.choice((5, 12, 30, 60)), rng.choice((5, 12, 30, 60))),
        slope_deg=rng.uniform(2.0, 50.0),
        towards_deg=rng.uniform(0.0, 360.0),
    )


@functools.lru_cache(maxsize=64)
def globe_of(crs):
    """To the system's longitude and latitude and back, degrees in their unit, geodesics, and about
    metres in x's.
    """
    system = pyproj.CRS(crs)
    globe = system.geodetic_crs
    degrees = math.degrees(globe.axis_info[0].unit_conversion_factor)
    unit = system.axis_info[0].unit_conversion_factor
    if system.is_geographic:
        unit *= system.ellipsoid.semi_major_metre
    there = pyproj.Transformer.from_crs(system, globe, always_xy=True)
    back = pyproj.Transformer.from_crs(globe, system, always_xy=True)
    return there, back, degrees, system.get_geod(), unit


def affine(case):
    """(2, 3) from a column and a row to x and y: cells are drawn as large as if metres were those
    of the ground.
    """
    _, back, degrees, _, unit = globe_of(case.crs)
    middle = np.array(back.transform(*(angle / degrees for angle in case.middle)))
    turned = rasterio.Affine.rotation(case.turned_deg) * rasterio.Affine.scale(case.wider, -1.0)
    sides = np.reshape(turned[:6], (2, 3))[:, :2] * case.cell_m / unit
    return np.column_stack((sides, middle - sides @ np.array(case.shape[::-1]) / 2))


def lonlat(case, cells):
    """(2, N) degrees of the middles of cells (N, 2)."""
    there, _, degrees, _, _ = globe_of(case.crs)
    x, y = affine(case) @ np.stack((cells[:, 1] + 0.5, cells[:, 0] + 0.5, np.ones(len(cells))))
    return degrees * np.array(there.transform(x, y))


def plane(case):
    """(H, W) heights that rise by the slope with the metres of ground from the map's middle."""
    lon, lat = lonlat(case, np.argwhere(np.ones(case.shape, bool)))
    middle = (np.full(len(lon), angle) for angle in case.middle)
    azimuth, _, metres = globe_of(case.crs)[3].inv(*middle, lon, lat)
    along = metres * np.cos(np.radians(np.asarray(azimuth) - case.towards_deg))
    return (math.tan(math.radians(case.slope_deg)) * along).reshape(case.shape)


def check(rng, place):
    """Slope beside that which the plane was made with, and lengths of steps beside geodesics."""
    case = generate(rng)
    heights = plane(case)
    if not np.isfinite(heights).all():
        return  # beyond the system's own bounds
    size = {"height": case.shape[0], "width": case.shape[1], "count": 1, "dtype": "float64"}
    where = rasterio.Affine(*affine(case).ravel())
    path = place.folder / "map.tif"
    with rasterio.open(path, "w", driver="GTiff", crs=case.crs, transform=where, **size) as file:
        file.write(heights, 1)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        dem = read_dem(path)
        with open_dem(path) as windows:
            in_windows = windows.cell_size_m, windows.cell_width_m
    sides = np.array((dem.cell_size_m, dem.cell_width_m))
    if in_windows != tuple(sides):
        raise Finding("other cells in windows", repr(case))
    off = [re.search(r"up to (\d+) % off", str(each.message)) for each in told]
    told_off = max((float(found[1]) / 100.0 for found in off if found), default=0.0)
    geod = globe_of(case.crs)[3]

    def metres(cells):
        lon, lat = lonlat(case, cells)
        return np.asarray(geod.inv(lon[:-1], lat[:-1], lon[1:], lat[1:])[2])

    middle = 0.5 * np.array(case.shape) - 0.5
    for side, half in zip(sides, 0.5 * np.eye(2), strict=True):
        if abs(metres(np.stack((middle - half, middle + half)))[0] / side - 1.0) > CELL_WITHIN:
            raise Finding("another side of a cell", f"{sides}\n{case}")
    if not told_off:
        slopes = terrain_terms(dem.elevation, cell_size_m=sides[0], cell_width_m=sides[1])[0]
        slope = slopes[case.shape[0] // 2, case.shape[1] // 2]
        if abs(math.tan(slope) / math.tan(math.radians(case.slope_deg)) - 1.0) > SLOPE_WITHIN:
            raise Finding("another slope", f"{math.degrees(slope):.3f}° {sides}\n{case}")
    ends = [[rng.randrange(1, side - 1) for side in case.shape] for _ in range(2)]
    cells = np.unique(np.linspace(*ends, 40).round().astype(int), axis=0)
    found = np.hypot(*(np.diff(cells, axis=0) * sides).T)
    off_by = np.abs(metres(cells) / found - 1.0).max(initial=0.0)
    if off_by > max(WITHIN, told_off) + 0.006:
        raise Finding("another length of a step", f"{off_by:.4f}, told {told_off} {sides}\n{case}")
