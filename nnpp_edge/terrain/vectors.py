"""Points in GeoJSON as places on a map, and paths as GPX."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import numpy.typing as npt

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.reading import parse, read_text, refused_as
from nnpp_edge.terrain.coordinates import WGS84, Points, on_map
from nnpp_edge.terrain.georeference import Place


class VectorFileError(InvalidQueryError):
    """A vector file that cannot be used; the message names the file."""


def points_of(path: Path, place: Place) -> tuple[Points, str]:
    """Map coordinates (N, 2) of the points in a GeoJSON file, in their order, and a word where they were reprojected.

    They are longitude and latitude of WGS 84, or in the system that the member ``crs`` of 2008 names. VectorFileError
    where the file holds other things than points, or none; InvalidQueryError where its system does not lead to the
    map's.
    """
    with refused_as(VectorFileError, f"{path}: wanted GeoJSON with points (ogr2ogr makes it of other layers)"):
        content = parse(read_text(path))
        found = np.array(list(_points(content)), np.float64).reshape(-1, 2)
        if not len(found):
            raise VectorFileError(f"{path}: wanted points, got none")
        return on_map(place, found, content["crs"]["properties"]["name"] if content.get("crs") else WGS84, str(path))


def _points(shape: Any) -> Iterator[tuple[float, float]]:
    """x and y of each point in an object of GeoJSON; ValueError for what is none."""
    match shape:
        case {"type": "FeatureCollection", "features": list(inner)} | {"geometries": list(inner)}:
            for each in inner:
                yield from _points(each)
        case {"type": "Feature", "geometry": inner}:
            yield from _points(inner) if inner else ()
        case {"type": "Point", "coordinates": [x, y, *_]}:
            yield float(x), float(y)
        case {"type": "MultiPoint", "coordinates": list(inner)}:
            yield from ((float(x), float(y)) for x, y, *_ in inner)
        case _:
            raise ValueError(f"got {shape.get('type') if isinstance(shape, dict) else type(shape).__name__}")


def gpx_bytes(
    name: str, lonlat: Points, elevation_m: npt.NDArray[np.float64], stops: Mapping[str, tuple[float, float]]
) -> bytes:
    """A path as a GPX 1.1 track, and stops by name as way points; longitude and latitude of WGS 84."""
    out = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<gpx version="1.1" creator="nnpp-edge" xmlns="http://www.topografix.com/GPX/1/1">',
    ]
    for stop, (lon, lat) in stops.items():
        out.append(f'<wpt lat="{lat:.8f}" lon="{lon:.8f}"><name>{escape(stop)}</name></wpt>')
    out.append(f"<trk><name>{escape(name)}</name><trkseg>")
    for (lon, lat), height in zip(lonlat.tolist(), elevation_m.tolist(), strict=True):
        known = f"<ele>{height:.3f}</ele>" if math.isfinite(height) else ""
        out.append(f'<trkpt lat="{lat:.8f}" lon="{lon:.8f}">{known}</trkpt>')
    return "\n".join([*out, "</trkseg></trk>", "</gpx>", ""]).encode()
