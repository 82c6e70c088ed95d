"""From other coordinate systems onto a map and back, by pyproj: longitude and latitude, vector layers' systems."""

import functools
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.terrain.georeference import Place

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

Points = npt.NDArray[np.float64]
"""(N, 2) x and y, or longitude and latitude in degrees."""
WGS84 = "EPSG:4326"


def lonlat_on_map(place: Place, points: Points) -> Points:
    """Map coordinates of longitudes and latitudes: WGS 84 on the Earth, elsewhere those of the body's own system.

    Raises InvalidQueryError where the map has no coordinate system, or a point no place in it.
    """
    own = _system_of(place)
    try:
        return _moved(points, _pyproj().CRS.from_user_input(WGS84), own)
    except InvalidQueryError:
        if own.geodetic_crs is None or not _other_body(own):
            raise
    return _moved(points, own.geodetic_crs, own)


def on_map(place: Place, points: Points, crs: str, source: str) -> tuple[Points, str]:
    """Map coordinates of points in a layer's system, and a word on it where that is not the map's; `source` has them.

    Raises InvalidQueryError where the map has no coordinate system, or a point no place in it.
    """
    own, theirs = _system_of(place), _pyproj().CRS.from_user_input(crs)
    if own.equals(theirs, ignore_axis_order=True):
        return points, ""
    return _moved(points, theirs, own), f"{source}: reprojected from {theirs.name} to {own.name}"


def lonlat_of(place: Place, points: Points) -> Points:
    """WGS 84 longitudes and latitudes of map coordinates.

    Raises InvalidQueryError where the map has no coordinate system, or one of another body than the Earth.
    """
    own = _system_of(place)
    if _other_body(own):
        raise InvalidQueryError(f"{place.source}: longitude and latitude on the Earth are wanted, got {own.name}")
    return _moved(points, own, _pyproj().CRS.from_user_input(WGS84))


def lonlat_corners(place: Place) -> Points:
    """(4, 2) longitudes and latitudes of the middles of a map's corner cells, as `lonlat_on_map` takes them.

    Raises InvalidQueryError where the map has no coordinate system, or a corner no place on the globe.
    """
    own, (rows, cols) = _system_of(place), place.shape
    corners = np.array([place.map_coordinates(row, col) for row in (0, rows - 1) for col in (0, cols - 1)])
    geodetic = own.geodetic_crs if _other_body(own) else None
    return _moved(corners, own, geodetic or _pyproj().CRS.from_user_input(WGS84))


def _pyproj() -> ModuleType:
    return optional_module("pyproj", "longitude and latitude, or another coordinate system,", "geo")


def _system_of(place: Place) -> "CRS":
    """The map's coordinate system; InvalidQueryError without one."""
    crs = place.georeference.crs if place.georeference else None
    if crs is None:
        raise InvalidQueryError(f"{place.source}: wanted a map with a coordinate system, the file names none")
    pyproj = _pyproj()
    try:
        found: CRS = pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError as error:
        raise InvalidQueryError(f"{place.source}: wanted a coordinate system that PROJ knows ({error})") from error
    return found


def _other_body(system: "CRS") -> bool:
    """Whether a system is another body's than the Earth: then there is no way from WGS 84."""
    try:
        _transformer(WGS84, system.to_wkt())
    except _pyproj().exceptions.ProjError:
        return True
    return False


def _moved(points: Points, begin: "CRS", end: "CRS") -> Points:
    """The same points in another system; InvalidQueryError where there is no way, or one has no place there."""
    pyproj = _pyproj()
    try:
        transformer = _transformer(begin.to_wkt(), end.to_wkt())
    except pyproj.exceptions.ProjError:
        raise InvalidQueryError(f"there is no way from {begin.name} to {end.name}: they are of two bodies") from None
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
