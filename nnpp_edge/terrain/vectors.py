"""Vector files: points of a layer as places on a map, by pyogrio; paths as GPX."""

import math
import re
import struct
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from xml.sax.saxutils import escape

import numpy as np
import numpy.typing as npt

from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.runtime.reading import parse, problem_with_file, read_text, refused_as
from nnpp_edge.terrain.coordinates import Points, on_map
from nnpp_edge.terrain.gdal_files import NO_NETWORK
from nnpp_edge.terrain.georeference import Place

FORMATS = "GeoPackage, GeoJSON, GPX, Shapefile, FlatGeobuf"
_STARTS = (b"SQLite format 3\0", b"\0\0\x27\x0a", b"fgb\x03")
"""Of a GeoPackage, a Shapefile and a FlatGeobuf."""
_GPX = re.compile(rb"(<\?xml[^>]*\?>)?\s*(<!--.*?-->\s*)*<gpx[\s>]", re.DOTALL)
_GEOJSON_TYPES = ("FeatureCollection", "Feature", "Point", "MultiPoint", "GeometryCollection")
_SHAPES = {2: "a line", 3: "a polygon", 5: "lines", 6: "polygons", 7: "a collection"}
"""By their numbers in WKB; a point is 1, points are 4."""
_HEAD_BYTES = 1 << 12


class VectorFileError(InvalidQueryError):
    """A vector file that cannot be used; the message names the file."""


def points_of(name: str, place: Place) -> tuple[Points, str]:
    """Map coordinates (N, 2) of a layer's points, in their order, and a word where they had to be reprojected.

    The name is that of a file of one of `FORMATS`, or FILE:LAYER where several of its layers hold points. Points of a
    layer that names no coordinate system are in the map's own. VectorFileError where there is no such file or layer,
    or it holds other things than points, or none; InvalidQueryError where its system does not lead to the map's.
    """
    path, layer = named_file(name)
    _check_plain(path)
    refused = refused_as(VectorFileError, f"{path}: wanted {FORMATS} with a layer of points")
    with _pyogrio(f"reading {path.name}") as pyogrio, refused:
        layer = layer or _only_layer(pyogrio, path)
        meta, _, shapes, _ = pyogrio.raw.read(path, layer=layer, columns=[], force_2d=True)
    found = np.array([point for shape in shapes for point in _points(path, shape)]).reshape(-1, 2)
    if not len(found):
        raise VectorFileError(f"{path}: wanted a layer of points, got {layer!r}, which holds none")
    return (found, "") if meta["crs"] is None else on_map(place, found, meta["crs"], str(path))


def named_file(name: str) -> tuple[Path, str | None]:
    """The file and the layer that FILE or FILE:LAYER names; VectorFileError where there is no such file."""
    problem = problem_with_file(path := Path(name))
    if problem is None:
        return path, None
    file, _, layer = name.rpartition(":")
    if file and layer and problem_with_file(Path(file)) is None:
        return Path(file), layer
    raise VectorFileError(f"{name}: wanted a vector file ({problem})")


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


@contextmanager
def _pyogrio(purpose: str) -> Iterator[ModuleType]:
    """pyogrio without the network, and without GDAL's warnings: of a damaged file, which is refused, for instance."""
    pyogrio = optional_module("pyogrio", purpose, "vector")
    pyogrio.set_gdal_config_options(NO_NETWORK)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield pyogrio


def _check_plain(path: Path) -> None:
    """VectorFileError for what GDAL would take for a list of other files and addresses, or read otherwise."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES).lstrip(b"\xef\xbb\xbf \t\r\n")
    if head.startswith(_STARTS) or _GPX.match(head):
        return
    if head.startswith(b"{"):
        with refused_as(VectorFileError, f"{path}: wanted GeoJSON"):
            if parse(read_text(path)).get("type") in _GEOJSON_TYPES:
                return
    raise VectorFileError(f"{path}: wanted {FORMATS}, got another kind of file")


def _only_layer(pyogrio: ModuleType, path: Path) -> str:
    """The one layer that holds points; VectorFileError where there is none, or there are several."""
    layers = {str(layer): str(kind or "") for layer, kind in pyogrio.list_layers(path)}
    if len(layers) == 1:
        return next(iter(layers))

    def count(name: str) -> int:
        return int(pyogrio.read_info(path, layer=name, force_feature_count=True)["features"])

    found = [name for name, kind in layers.items() if "Point" in kind and count(name)]
    if len(found) == 1:
        return found[0]
    several = f"several: name one as {path.name}:LAYER ({', '.join(found)})"
    which = several if found else f"none ({', '.join(layers)})"
    raise VectorFileError(f"{path}: wanted one layer of points, got {which}")


def _points(path: Path, shape: bytes | None) -> list[tuple[float, float]]:
    """The points in a shape (WKB, little-endian, of two dimensions); VectorFileError for another kind."""
    if shape is None:
        return []
    (kind,) = struct.unpack_from("<I", shape, 1)
    if kind not in (1, 4):
        raise VectorFileError(f"{path}: wanted points, got {_SHAPES.get(kind, 'another shape')}")
    starts = (5,) if kind == 1 else range(14, len(shape), 21)
    found = [struct.unpack_from("<dd", shape, start) for start in starts]
    return [(x, y) for x, y in found if math.isfinite(x)]
