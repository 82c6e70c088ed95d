"""Vector files: points of a layer as places on a map, and GeoJSON as a GeoPackage, by pyogrio."""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.runtime.reading import parse, problem_with_file, read_text, refused_as
from nnpp_edge.terrain.coordinates import Points, on_earth, on_map
from nnpp_edge.terrain.gdal_files import NO_NETWORK
from nnpp_edge.terrain.georeference import Place

FORMATS = "GeoPackage, GeoJSON, GPX, Shapefile, FlatGeobuf"
_PLAIN = re.compile(
    rb"SQLite format 3\0|\0\0\x27\x0a|fgb\x03|(<\?xml[^>]*\?>)?\s*(<!--.*?-->\s*)*<gpx[\s>]",
    re.DOTALL,
)
"""How a GeoPackage, a Shapefile, a FlatGeobuf and GPX begin."""
_GEOJSON_TYPES = ("FeatureCollection", "Feature", "Point", "MultiPoint", "GeometryCollection")
_POINTS = np.dtype([("head", "V5"), ("xy", "<f8", 2)])
"""A point in WKB; where there are several they follow a head of 9 bytes."""


class VectorFileError(InvalidQueryError):
    """A vector file that cannot be used; the message names the file."""


class LayerPoints(NamedTuple):
    """Points of a layer, in their order."""

    places: Points
    """(N, 2) map coordinates."""
    remark: str
    """How their coordinate system was taken, where it is not the map's."""


def points_of(name: str, place: Place) -> LayerPoints:
    """The points of a layer, on the map.

    The name is that of a file of one of `FORMATS`, or FILE:LAYER where it has several, of which
    GPX's is that of the way points. Points of a layer that names no coordinate system are in the
    map's own; so are GeoJSON's without one on another body than the Earth.
    VectorFileError where there is no such file or layer, or it holds other things than
    points, or none; InvalidQueryError where its system does not lead to the map's.
    """
    path, layer = named_file(name)
    refused = refused_as(VectorFileError, f"{path}: wanted {FORMATS} with points")
    with _pyogrio(f"reading {path.name}") as pyogrio, refused:
        unnamed = _check_plain(path)
        layers = pyogrio.list_layers(path)[:, 0].tolist()
        if layer is None and len(layers) > 1 and layers[0] != "waypoints":
            raise VectorFileError(
                f"{path}: wanted one layer: name it as {path.name}:LAYER ({', '.join(layers)})"
            )
        layer = layer or layers[0]
        meta, _, read, _ = pyogrio.raw.read(path, layer=layer, columns=[], force_2d=True)
        shapes = [shape for shape in read if shape is not None]
        if any(shape[1] not in (1, 4) for shape in shapes):
            raise VectorFileError(
                f"{path}: wanted points, got other shapes ({meta['geometry_type']})"
            )
        points = [np.empty((0, 2))]
        for shape in shapes:
            head = 9 if shape[1] == 4 else 0
            points.append(np.frombuffer(shape, _POINTS, offset=head)["xy"])
    found = np.concatenate(points)
    found = found[np.isfinite(found).all(axis=1)]  # an empty point has no numbers
    if not len(found):
        raise VectorFileError(f"{path}: wanted points, got none")
    remark = ""
    if unnamed and not on_earth(place):
        remark = f"{path} names no coordinate system: taken in the map's own"
    elif meta["crs"] is not None:
        found, remark = on_map(place, found, meta["crs"], str(path))
    return LayerPoints(found, remark)


def named_file(name: str) -> tuple[Path, str | None]:
    """The file and the layer that FILE or FILE:LAYER names; VectorFileError where there is no such
    file.
    """
    problem = problem_with_file(name)
    if problem is None:
        return Path(name), None
    file, _, layer = name.rpartition(":")
    if layer and problem_with_file(file) is None:
        return Path(file), layer
    raise VectorFileError(f"{name}: wanted a vector file ({problem})")


def geopackage_bytes(layer: str, geojson: bytes) -> bytes:
    """A GeoPackage with a layer made of GeoJSON; MissingExtraError where pyogrio is not
    installed.
    """
    with _pyogrio("writing a GeoPackage") as pyogrio, TemporaryDirectory() as folder:
        file = Path(folder) / "layers.gpkg"
        meta, _, shapes, values = pyogrio.raw.read(geojson)
        kinds = {"geometry_type": meta["geometry_type"], "crs": meta["crs"]}
        pyogrio.raw.write(file, shapes, values, meta["fields"], layer=layer, driver="GPKG", **kinds)
        return file.read_bytes()


@contextmanager
def _pyogrio(purpose: str) -> Iterator[ModuleType]:
    """pyogrio without the network, and without GDAL's warnings: of a damaged file, which is
    refused, for instance.
    """
    pyogrio = optional_module("pyogrio", purpose, "vector")
    pyogrio.set_gdal_config_options(NO_NETWORK)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield pyogrio


def _check_plain(path: Path) -> bool:
    """Whether it is GeoJSON that names no coordinate system; VectorFileError for what GDAL would
    take for a list of other files and addresses, or read otherwise.
    """
    with path.open("rb") as file:
        head = file.read(1 << 12).lstrip(b"\xef\xbb\xbf \t\r\n")
    if head.startswith(b"{"):
        content = parse(read_text(path))
        plain = content.get("type") in _GEOJSON_TYPES
        unnamed = "crs" not in content
    else:
        unnamed = False
        plain = _PLAIN.match(head) is not None
    if not plain:
        raise VectorFileError(f"{path}: wanted {FORMATS}, got another kind of file")
    return unnamed
