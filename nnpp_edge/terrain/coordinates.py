"""Coordinate systems, by pyproj: from others onto a map and back, and metres of the ground under
it.
"""

import functools
import math
import warnings
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nnpp_edge.runtime.errors import InvalidQueryError, TerrainError, optional_module
from nnpp_edge.terrain.georeference import Place, Sides

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
_SAMPLES = Path(__file__).parent / "samples"
_OF_SAMPLES = {"earth": 9.80665, "moon": 1.62, "mars": 3.71}
"""m/s², by how the names of samples begin: they lie in no coordinate system."""
_SAME_BODY = 0.007
"""Share by which radii of a body differ: Mars has 3,376.2 km at its poles."""
_MEASURED_M = 100.0
"""Longest way by which a cell is measured: on larger cells geodesics leave the parallels."""
_WARNED_LENGTH = 0.03
"""Share by which a length on the map may be off before a user is warned."""


def lonlat_on_map(place: Place, points: Points) -> Points:
    """Map coordinates of longitudes and latitudes: WGS 84 on the Earth, elsewhere those of the
    body's own system.

    Here and below InvalidQueryError where the map has no coordinate system, or a point no place in
    it.
    """
    own = _system_of(place)
    return _moved(points, _lonlat_system(own), own)


def lonlat_at(place: Place, points: Points) -> Points:
    """Longitudes and latitudes of map coordinates, as `lonlat_on_map` takes them."""
    own = _system_of(place)
    return _moved(points, own, _lonlat_system(own))


def lonlat_corners(place: Place) -> Points:
    """(4, 2) those of the middles of a map's corner cells."""
    rows, cols = ((0, side - 1) for side in place.shape)
    corners = [place.map_coordinates(*cell) for cell in product(rows, cols)]
    return lonlat_at(place, np.array(corners))


def gravity_of(place: Place) -> float | None:
    """m/s² on the body that a map's coordinate system lies on, or a sample's name says; None where
    neither names one that is known.
    """
    if place.source.parent == _SAMPLES:
        return _OF_SAMPLES[place.source.name.partition("_")[0]]
    if place.georeference is None or place.georeference.crs is None:
        return None
    ellipsoid = _system_of(place).ellipsoid
    axis = ellipsoid.semi_major_metre if ellipsoid else 0.0
    for radius, gravity in _GRAVITY.items():
        if abs(axis / radius - 1.0) < _SAME_BODY:
            return gravity
    return None


def cell_on_ground(place: Place, *, warn: bool) -> Sides | None:
    """A cell's (size, width): metres of ground along a column and along a row at the middle of a
    map; None without a georeference.

    Without a coordinate system, or with a local one, they are the transform's, in metres or in the
    system's unit. To `warn` is a UserWarning where a length or slope is off by too much.

    Raises TerrainError for a transform that cannot be turned back and for latitudes beyond the
    poles, InvalidQueryError for a system that PROJ does not know, MissingExtraError where pyproj is
    not installed.
    """
    if place.georeference is None:
        return None
    source = place.source
    a, b, _, d, e, _ = transform = place.georeference.transform
    if not (math.isfinite(a * e - b * d) and a * e != b * d):
        raise TerrainError(f"{source}: wanted a transform that can be turned back, got {transform}")
    # a cell as it is drawn, in metres where the system counts in them
    drawn = np.array(place.georeference.drawn_sides)
    if place.georeference.crs is None:
        return drawn[0], drawn[1]
    system = _system_of(place)
    unit = system.axis_info[0].unit_conversion_factor if system.axis_info else 1.0
    drawn *= unit
    if system.is_geographic and system.ellipsoid:
        drawn *= system.ellipsoid.semi_major_metre
    if not (system.is_geographic or system.is_projected):
        return drawn[0], drawn[1]

    # as it lies on the ground
    with np.errstate(all="ignore"):
        lengths = _lengths(system, place, min(1.0, _MEASURED_M / drawn.max()))
    middle = lengths[:2, 4]
    said = f"{source}: {_name_of(system)}"
    if np.isfinite(middle).all():
        problems = _distortions(said, lengths)
    elif system.is_geographic:
        row, col = (0.5 * (side - 1) for side in place.shape)
        latitude = math.degrees(unit) * place.map_coordinates(row, col)[1]
        raise TerrainError(f"{source}: wanted latitudes within the poles, got {latitude:g}°")
    else:
        problems = [
            f"{said} does not reach the map's middle: cells are taken to be {drawn[0]:.4g} × "
            f"{drawn[1]:.4g} m"
        ]
        middle = drawn
    for words in problems if warn else ():
        warnings.warn(words, stacklevel=4)
    # the rest is noise, by which no cell would be square
    size, width = (float(f"{length:.7g}") for length in middle)
    return size, width


def _distortions(said: str, lengths: Points) -> list[str]:
    """A warning of lengths and slopes that are off anywhere on the map."""
    down, right, falling, rising = lengths
    with np.errstate(all="ignore"):
        skew = (falling**2 - rising**2) / (4.0 * down * right)  # cos(row, column)
        unlike = lengths[:2] / lengths[:2, 4:5] - 1.0
        off = np.fmax.reduce(np.abs((*unlike, skew)), axis=None)
    if off <= _WARNED_LENGTH:
        return []
    return [
        f"{said}: some lengths and slopes are up to {100.0 * off:.0f} % off, as the map's cells "
        "are skewed or unlike those at its middle: cut out a smaller part or reproject it"
    ]


def _lengths(system: "CRS", place: Place, share: float) -> Points:
    """(4, 9) metres of ground along a column, a row and both diagonals of cells: at the rim, the
    fifth at the middle.

    They are measured on a `share` of a cell; NaN where the map leaves the globe.
    """
    globe = system.geodetic_crs
    geod = system.get_geod()
    assert globe is not None and geod is not None  # of a projected or a geographic system
    radians = globe.axis_info[0].unit_conversion_factor
    transform = _transformer(system.to_wkt(), globe.to_wkt()).transform
    shares = np.array(list(product((0.0, 0.5, 1.0), repeat=2)))
    middles = shares * (np.array(place.shape) - 1)
    # half a step down, right and along both diagonals, back and forth
    steps = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])
    halves = 0.5 * share * np.stack((-steps, steps))[:, :, None]
    x, y = place.map_coordinates(*np.moveaxis(middles + halves, -1, 0))
    lon, lat = radians * np.array(transform(x, y))
    lat[np.abs(lat) > 0.5 * math.pi] = math.nan
    metres = geod.inv(lon[0], lat[0], lon[1], lat[1], radians=True)[2]
    return np.asarray(metres) / share


def _pyproj() -> ModuleType:
    return optional_module("pyproj", "longitude and latitude, or another coordinate system,", "geo")


def _system_of(place: Place) -> "CRS":
    """A map's coordinate system; InvalidQueryError without one."""
    if place.georeference is None or place.georeference.crs is None:
        raise InvalidQueryError(
            f"{place.source}: wanted a map with a coordinate system, the file names none"
        )
    pyproj = _pyproj()
    try:
        found: CRS = pyproj.CRS.from_user_input(place.georeference.crs)
    except pyproj.exceptions.CRSError as error:
        raise InvalidQueryError(
            f"{place.source}: wanted a coordinate system that PROJ knows ({error})"
        ) from error
    return found


def _name_of(system: "CRS") -> str:
    """A coordinate system's name, for messages."""
    return "a system without a name" if system.name == "unknown" else system.name


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
    """These points in another system; InvalidQueryError where one has no place there."""
    transformer = _transformer(begin.to_wkt(), end.to_wkt())
    found = np.column_stack(transformer.transform(*points.T))
    for x, y in points[~np.isfinite(found).all(1)]:
        place = f"({x:g}, {y:g})"
        if begin.is_geographic:
            place = f"longitude {x:g}, latitude {y:g}"
        raise InvalidQueryError(f"{place} of {_name_of(begin)} has no place in {_name_of(end)}")
    return found


@functools.lru_cache(maxsize=8)
def _transformer(begin: str, end: str) -> "Transformer":
    found: Transformer = _pyproj().Transformer.from_crs(begin, end, always_xy=True)
    return found
