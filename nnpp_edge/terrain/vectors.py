"""Vector files: points of a layer as places on a map, and GeoJSON as a GeoPackage, by pyogrio."""

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np

from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.runtime.reading import parse, problem_with_file, read_text, refused_as
from nnpp_edge.terrain.coordinates import Points, on_map
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


def points_of(name: str, place: Place) -> tuple[Points, str]:
    """Map coordinates (N, 2) of a layer's points, in their order, and a word where they had to be
    reprojected.

    The name is that of a file of one of `FORMATS`, or FILE:LAYER where it has several, of which
    GPX's is that of the way points. Points of a layer that names no coordinate system are in the
    map's own. VectorFileError where there is no such file or layer, or it holds other things than
    points, or none; InvalidQueryError where its system does not lead to the map's.
    """
    path, layer = named_file(name)
    refused = refused_as(VectorFileError, f"{path}: wanted {FORMATS} with points")
    with _pyogrio(f"reading {path.name}") as pyogrio, refused:
        _check_plain(path)
        layers = pyogrio.list_layers(path)[:, 0].tolist()
        if layer is None and len(layers) > 1 and layers[0] != "waypoints":
            raise VectorFileError(
                f"{path}: wanted one layer: name it as {path.name}:LAYER ({', '.join(layers)})"
            )
        meta, _, read, _ = pyogrio.raw.read(
            path,
            layer=layer or layers[0],
            columns=[],
            force_2d=True,
        )
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
    if meta["crs"] is None:
        return found, ""
    return on_map(place, found, meta["crs"], str(path))


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
    """A GeoPackage of one layer, of GeoJSON; MissingExtraError where pyogrio is not installed."""
    out = io.BytesIO()
    with _pyogrio("writing a GeoPackage") as pyogrio:
        meta, _, shapes, values = pyogrio.raw.read(geojson)
        kinds = {"geometry_type": meta["geometry_type"], "crs": meta["crs"]}
        pyogrio.raw.write(out, shapes, values, meta["fields"], layer=layer, driver="GPKG", **kinds)
    return out.getvalue()


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


def _check_plain(path: Path) -> None:
    """VectorFileError for what GDAL would take for a list of other files and addresses, or read
    otherwise.
    """
    with path.open("rb") as file:
        head = file.read(1 << 12).lstrip(b"\xef\xbb\xbf \t\r\n")
    if head.startswith(b"{"):
        plain = parse(read_text(path)).get("type") in _GEOJSON_TYPES
    else:
        plain = _PLAIN.match(head) is not None
    if not plain:
        raise VectorFileError(f"{path}: wanted {FORMATS}, got another kind of file")
