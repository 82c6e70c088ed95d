"""Coordinate systems, by pyproj: from others onto a map and back, and metres of the ground under
it.
"""

import functools
import math
import warnings
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nnpp_edge.runtime.errors import InvalidQueryError, TerrainError, optional_module
from nnpp_edge.terrain.georeference import Georeference, Place, Sides

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

Points = npt.NDArray[np.float64]
"""(N, 2) x and y, or longitude and latitude in degrees."""
WGS84 = "EPSG:4326"
_GRAVITY = {
    6_378_137.0: 9.80665,  # the Earth
    1_737_400.0: 1.62,  # the Moon
    3_396_190.0: 3.71,  # Mars
    2_440_530.0: 3.70,  # Mercury
    6_051_800.0: 8.87,  # Venus
    482_000.0: 0.28,  # Ceres
    2_575_000.0: 1.35,  # Titan
}
"""m/s² by the semi-major axis of a body."""
_SAME_BODY = 0.007
"""Share by which radii of a body differ: Mars has 3,376.2 km at its poles."""
_MEASURED_M = 100.0
"""Longest way by which a cell is measured: on larger cells geodesics leave the parallels."""
_SCALE_TOLD = 0.05
_RIM_TOLD = 0.03
"""Shares by which a projection's metre at the map's middle, and any length on the map, is off when
that is told.
"""


def lonlat_on_map(place: Place, points: Points) -> Points:
    """Map coordinates of longitudes and latitudes: WGS 84 on the Earth, elsewhere those of the
    body's own system.

    Here and below InvalidQueryError where the map has no coordinate system, or a point no place in
    it.
    """
    own = _system_of(place.georeference, place.source)
    return _moved(points, _lonlat_system(own), own)


def lonlat_at(place: Place, points: Points) -> Points:
    """Longitudes and latitudes of map coordinates, as `lonlat_on_map` takes them."""
    own = _system_of(place.georeference, place.source)
    return _moved(points, own, _lonlat_system(own))


def lonlat_corners(place: Place) -> Points:
    """(4, 2) those of the middles of a map's corner cells."""
    corners = [
        place.map_coordinates(row, col)
        for row in (0, place.shape[0] - 1)
        for col in (0, place.shape[1] - 1)
    ]
    return lonlat_at(place, np.array(corners))


def lonlat_of(place: Place, points: Points) -> Points:
    """WGS 84 longitudes and latitudes of map coordinates; InvalidQueryError on another body than
    the Earth.
    """
    own = _system_of(place.georeference, place.source)
    globe = _lonlat_system(own)
    if not globe.equals(_pyproj().CRS.from_user_input(WGS84)):
        raise InvalidQueryError(
            f"{place.source}: longitude and latitude on the Earth are wanted, got {own.name}"
        )
    return _moved(points, own, globe)


def on_map(place: Place, points: Points, crs: str, source: str) -> tuple[Points, str]:
    """Map coordinates of points of the layer `source`, and a word on it where its system is not the
    map's.
    """
    own = _system_of(place.georeference, place.source)
    theirs = _pyproj().CRS.from_user_input(crs)
    if own.equals(theirs, ignore_axis_order=True):
        return points, ""
    return _moved(points, theirs, own), f"{source}: reprojected from {theirs.name} to {own.name}"


def gravity_of(place: Place) -> float | None:
    """m/s² on the body that a map's coordinate system lies on; None where it names none, or one
    that is not known.
    """
    if place.georeference is None or place.georeference.crs is None:
        return None
    ellipsoid = _system_of(place.georeference, place.source).ellipsoid
    axis = ellipsoid.semi_major_metre if ellipsoid else 0.0
    return next(
        (g for radius, g in _GRAVITY.items() if abs(axis / radius - 1.0) < _SAME_BODY), None
    )


def cell_on_ground(
    source: Path, place: Georeference, shape: tuple[int, ...], *, warn: bool
) -> Sides:
    """A cell's (size, width): metres of ground along a column and along a row at the middle of a
    map (H, W).

    Without a coordinate system, or with a local one, they are the transform's, in metres or in the
    system's unit. To `warn` is a UserWarning where a projection's metre at the middle, or any
    length or slope, is off by too much.

    Raises TerrainError for a transform that cannot be turned back and for latitudes beyond the
    poles, InvalidQueryError for a system that PROJ does not know, MissingExtraError where pyproj is
    not installed.
    """
    a, b, _, d, e, _ = place.transform
    if not (math.isfinite(a * e - b * d) and a * e != b * d):
        raise TerrainError(
            f"{source}: wanted a transform that can be turned back, got {place.transform}"
        )
    drawn = np.array((math.hypot(b, e), math.hypot(a, d)))
    if place.crs is None:
        return drawn[0], drawn[1]
    system = _system_of(place, source)
    unit = system.axis_info[0].unit_conversion_factor if system.axis_info else 1.0
    drawn *= unit * (
        system.ellipsoid.semi_major_metre if system.is_geographic and system.ellipsoid else 1.0
    )
    if not (system.is_geographic or system.is_projected):
        return drawn[0], drawn[1]
    with np.errstate(all="ignore"):
        down, right, falling, rising = lengths = _lengths(
            system, place, shape, min(1.0, _MEASURED_M / drawn.max())
        )
        middle = lengths[:2, 4]
        # cos(row, column)
        tall, wide = drawn / middle
        skew = (falling**2 - rising**2) / (4.0 * down * right)
        off = np.fmax.reduce(
            np.abs((down / middle[0] - 1.0, right / middle[1] - 1.0, skew)), axis=None
        )
    said = f"{source}: {system.name}"
    told = []
    if not np.isfinite(middle).all():
        if system.is_geographic:
            latitude = (
                math.degrees(unit)
                * place.map_coordinates(shape[0] / 2 - 0.5, shape[1] / 2 - 0.5)[1]
            )
            raise TerrainError(f"{source}: wanted latitudes within the poles, got {latitude:g}°")
        middle = drawn
        off = 0.0
        told.append(
            f"{said} has no place for the map's middle: its metres are taken for metres of ground"
        )
    elif system.is_projected and max(abs(tall - 1.0), abs(wide - 1.0)) > _SCALE_TOLD:
        told.append(
            f"{said} draws a metre of ground at the map's middle as {tall:.3f} m along columns "
            f"and {wide:.3f} m "
            f"along rows: cells are {middle[0]:.4g} × {middle[1]:.4g} m of ground"
        )
    if off > _RIM_TOLD:
        told.append(
            f"{said}: some lengths and slopes are up to {100.0 * off:.0f} % off, as the map's "
            "cells are skewed or "
            "unlike those at its middle: cut out a smaller part, or reproject it"
        )
    for words in told if warn else ():
        warnings.warn(words, stacklevel=4)
    size, width = (
        float(f"{length:.7g}") for length in middle
    )  # the rest is noise, by which no cell would be square
    return size, width


def _lengths(system: "CRS", place: Georeference, shape: tuple[int, ...], share: float) -> Points:
    """(4, 9) metres of ground along a column, a row and both diagonals of cells: at the rim, the
    fifth at the middle.

    They are measured on a `share` of a cell; NaN where the map leaves the globe.
    """
    globe = system.geodetic_crs
    geod = system.get_geod()
    assert globe is not None and geod is not None  # of a projected or a geographic system
    radians = globe.axis_info[0].unit_conversion_factor
    middles = np.array([[(row, col) for row in (0.0, 0.5, 1.0) for col in (0.0, 0.5, 1.0)]]) * (
        np.array(shape) - 1
    )
    steps = 0.5 * share * np.array([[(1.0, 0.0)], [(0.0, 1.0)], [(1.0, 1.0)], [(1.0, -1.0)]])
    ends = []
    for points in (middles - steps, middles + steps):
        x, y = place.map_coordinates(points[..., 0], points[..., 1])
        lon, lat = _transformer(system.to_wkt(), globe.to_wkt()).transform(x, y)
        known = np.abs(lat * radians) <= 0.5 * math.pi
        ends += [np.where(known, angles * radians, math.nan) for angles in (lon, lat)]
    return np.asarray(geod.inv(ends[0], ends[1], ends[2], ends[3], radians=True)[2]) / share


def _pyproj() -> ModuleType:
    return optional_module("pyproj", "longitude and latitude, or another coordinate system,", "geo")


def _system_of(place: Georeference | None, source: Path) -> "CRS":
    """A map's coordinate system; InvalidQueryError without one."""
    if place is None or place.crs is None:
        raise InvalidQueryError(
            f"{source}: wanted a map with a coordinate system, the file names none"
        )
    pyproj = _pyproj()
    try:
        found: CRS = pyproj.CRS.from_user_input(place.crs)
    except pyproj.exceptions.CRSError as error:
        raise InvalidQueryError(
            f"{source}: wanted a coordinate system that PROJ knows ({error})"
        ) from error
    return found


def _lonlat_system(own: "CRS") -> "CRS":
    """In which a map's longitudes and latitudes are given: WGS 84 on the Earth, elsewhere the
    system's own globe.
    """
    pyproj = _pyproj()
    wgs84: CRS = pyproj.CRS.from_user_input(WGS84)
    try:
        _transformer(WGS84, own.to_wkt())
    except pyproj.exceptions.ProjError:  # there is no way to another body
        return own.geodetic_crs or wgs84
    return wgs84


def _moved(points: Points, begin: "CRS", end: "CRS") -> Points:
    """These points in another system; InvalidQueryError where there is no way, or one has no place
    there.
    """
    try:
        transformer = _transformer(begin.to_wkt(), end.to_wkt())
    except _pyproj().exceptions.ProjError:
        raise InvalidQueryError(
            f"there is no way from {begin.name} to {end.name}: they are of two bodies"
        ) from None
    found = np.column_stack(transformer.transform(*points.T))
    if len(lost := np.flatnonzero(~np.isfinite(found).all(1))):
        x, y = points[lost[0]].tolist()
        place = f"longitude {x:g}, latitude {y:g}" if begin.is_geographic else f"({x:g}, {y:g})"
        raise InvalidQueryError(f"{place} of {begin.name} has no place in {end.name}")
    return found


@functools.lru_cache(maxsize=8)
def _transformer(begin: str, end: str) -> "Transformer":
    found: Transformer = _pyproj().Transformer.from_crs(begin, end, always_xy=True)
    return found
