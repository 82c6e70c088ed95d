"""A planned path on the ground: where its points lie, what is there, and the files that say so."""

import io
import json
import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from nnpp_edge.runtime.arrays import Float2D, Float32s, Floats, headings_along
from nnpp_edge.runtime.errors import optional_module
from nnpp_edge.runtime.map.along import Along, Line
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.robots.body.attitude import attitudes
from nnpp_edge.runtime.robots.body.poses import Poses
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.facts import Fact
from nnpp_edge.terrain.georeference import Place, Point

_LOCAL = 'LOCAL_CS["the map\'s own metres",UNIT["metre",1]]'
_EPSG = re.compile(r'(?:AUTHORITY|ID)\["EPSG",\s*"?(\d+)"?\]\]\s*$')


_STANDING = (
    ("pitch_deg", "°", "vehicle: pitched by at most {}"),
    ("roll_deg", "°", "vehicle: rolled by at most {}"),
    ("tilt_deg", "°", "vehicle: tilted by at most {}"),
    ("clearance_m", "m", "vehicle: clear by at least {}"),
    ("margin", "", ""),
)
"""Numbers of `Route.standing` whose extremes are facts of the path: unit, and words."""
Facts = dict[str, object]
"""Properties of a feature."""


@dataclass(frozen=True, eq=False)
class Route:
    """A path over a DEM."""

    line: Line
    """(M, 2) row and column of what is driven, from start to goal: cells, or way points; M may be
    0.
    """
    along: Along
    """This route with every place between way points at which something is known."""
    cost: Float32s
    """(N,) of the cell at each of these."""
    dem: Place
    standing: Mapping[str, Floats] = field(default_factory=dict)
    """How a vehicle stands on each cell, (N,): headings, angles and clearances by name; empty for a
    point.
    """

    @classmethod
    def of(cls, line: Line, along: Along, cost: Float2D, dem: Place) -> "Route":
        """The route of a line, with the cost map (H, W) that it was planned on."""
        rows, cols = np.rint(along.points).astype(np.int64).T
        return cls(line, along, cost[rows, cols], dem)

    @classmethod
    def of_plan(cls, plan: Plan, cost: Float2D, dem: Place, poses: Poses | None = None) -> "Route":
        """The route of a plan, with how a vehicle stands along it, by its poses if it is a body."""
        assert plan.along is not None
        route = cls.of(plan.line, plan.along, cost, dem)
        return route if plan.vehicle is None else replace(route, standing=_standing(plan, poses))

    @property
    def length_m(self) -> float:
        """Length on the level; 0 without a path."""
        return float(self.along.distance_m[-1]) if len(self.line) else 0.0

    @property
    def facts(self) -> list[Fact]:
        """The steepest that a body stands along the path, and its least clearance and margin; empty
        for a point.
        """
        found = []
        for name, unit, words in _STANDING:
            if name in self.standing:
                numbers = self.standing[name]
                steepest = unit == "°"
                extreme = np.abs(numbers).max() if steepest else numbers.min()
                named = f"{'steepest' if steepest else 'least'}_{name}"
                found.append(Fact(named, _known(float(extreme)), unit, words))
        return found

    def stands(self) -> dict[str, list[float | None]]:
        """`standing`, ready for JSON: None for what is not finite."""
        return {name: [*map(_known, each.tolist())] for name, each in self.standing.items()}

    def csv(self) -> bytes:
        """A line a cell, or a point along way points, under a header; with a vehicle, how it stands
        there too.
        """
        along = self.along
        rows, cols = along.points.T
        x, y = places_of(self.dem, along.points).T
        columns = [
            ("row", "%.10g", rows),
            ("col", "%.10g", cols),
            ("x", "%s", x),
            ("y", "%s", y),
            ("elevation_m", "%.7g", along.heights_m),
            ("cost", "%.6g", self.cost),
            ("distance_m", "%.10g", along.distance_m),
            ("ground_m", "%.10g", along.ground_m),
            ("time_s", "%.10g", along.time_s),
        ]
        if along.mobility.energy is not None:
            columns.append(("energy_j", "%.10g", along.energy_j))
        columns += [(name, "%.6g", numbers) for name, numbers in self.standing.items()]
        names, forms, numbers = zip(*columns, strict=True)
        out = io.BytesIO()
        np.savetxt(out, np.column_stack(numbers), forms, ",", header=",".join(names), comments="")
        return out.getvalue()

    def geojson(self, properties: Facts) -> bytes:
        """A feature with the path as a line: a point where it is one cell, no geometry where there
        is none.

        Coordinates are the map's own, although RFC 7946 knows longitude and latitude on the Earth
        only: paths on other bodies have neither. `crs` in the properties is the coordinate system
        as WKT, or null; `named_crs` names it to GDAL and QGIS.
        """
        place = self.dem.georeference
        meaning = "the map's own"
        if place is None:
            meaning = "metres from the centre of cell (0, 0), y downwards"
        crs = place and place.crs
        properties = {**properties, **self.stands(), "coordinates": meaning, "crs": crs}
        feature = self._feature(places_of(self.dem, self.line), properties)
        return json.dumps(feature, allow_nan=False).encode()

    def geopackage(self, properties: Facts) -> bytes:
        """Likewise with heights, as the layer `path` of a GeoPackage; MissingExtraError without
        pyogrio.
        """
        along = self.along
        places = np.column_stack((places_of(self.dem, along.points), along.heights_m))
        feature = self._feature(places, properties)
        return _geopackage("path", json.dumps(feature).encode())

    def _feature(self, places: Floats, properties: dict[str, object]) -> dict[str, object]:
        line: list[object] = places.tolist()
        geometry: dict[str, object] | None = None
        if len(line) == 1:
            geometry = {"type": "Point", "coordinates": line[0]}
        elif line:
            geometry = {"type": "LineString", "coordinates": line}
        feature = {"type": "Feature", "geometry": geometry, "properties": properties}
        return feature | named_crs(self.dem)


def _geopackage(layer: str, geojson: bytes) -> bytes:
    """A GeoPackage with a layer made of GeoJSON; MissingExtraError where pyogrio is not
    installed.
    """
    pyogrio = optional_module("pyogrio", "writing a GeoPackage", "vector")
    with warnings.catch_warnings(), TemporaryDirectory() as folder:
        warnings.simplefilter("ignore")  # GDAL's
        file = Path(folder) / "layers.gpkg"
        meta, _, shapes, values = pyogrio.raw.read(geojson)
        kinds = {"geometry_type": meta["geometry_type"], "crs": meta["crs"]}
        pyogrio.raw.write(file, shapes, values, meta["fields"], layer=layer, driver="GPKG", **kinds)
        return file.read_bytes()


def _standing(plan: Plan, poses: Poses | None) -> dict[str, Floats]:
    """How a vehicle stands at each point along its plan, as of `Route.standing`."""
    if plan.along is None or len(plan.path) < 2:
        return {}
    heading = headings_along(plan.along.points)
    standing = {} if poses is None else attitudes(poses, plan.walked)._asdict()
    if (drive := plan.drive) is None:
        return {"heading_deg": heading, **standing}
    standing = {name: numbers[drive.steps] for name, numbers in standing.items()}
    gears = drive.gears.astype(np.float64)
    driven = {"heading_deg": drive.poses[:, 2], "gear": gears}
    return {**driven, **standing, "curvature_per_m": drive.curvatures_per_m}


def _known(number: float) -> float | None:
    """Four decimals, or None for what is not finite."""
    return round(number, 4) if math.isfinite(number) else None


def places_of(dem: Place, points: Line) -> Floats:
    """(N, 2) x and y, in the coordinates of `Place.located`, of rows and columns of cells' middles
    (N, 2).
    """
    return np.column_stack(dem.located.map_coordinates(*np.asarray(points, np.float64).T))


def named_crs(dem: Place) -> dict[str, object]:
    """The member by which GeoJSON of 2008 names a coordinate system: as GDAL and QGIS read it, by
    any of its names.

    It is the system's EPSG number, else its WKT; a map without a system lies in one of its own, in
    metres. Without the member, readers would take the coordinates for longitude and latitude on the
    Earth.
    """
    crs = (dem.georeference.crs if dem.georeference else None) or _LOCAL
    number = _EPSG.search(crs)
    name = f"urn:ogc:def:crs:EPSG::{number[1]}" if number else crs
    return {"crs": {"type": "name", "properties": {"name": name}}}


Polygon = list[list[Point]]
"""Rings of x and y: the outer one, then its holes."""


@dataclass(frozen=True, eq=False)
class Reach:
    """The areas that can be reached within each of several costs."""

    field: Float2D
    """(H, W) cost of getting to each cell; inf where that is not possible, or costs more than the
    last level.
    """
    levels: tuple[float, ...]
    """Costs, ascending."""
    measure: str
    """Of the costs: ``cost``, ``time`` or ``energy``."""
    unit: str
    dem: Dem

    @property
    def areas(self) -> list[dict[str, float]]:
        """Of each level: ``within``, the ``cells`` that can be reached within it, and their
        ``area_m2``.
        """
        cell_m2 = self.dem.cell_size_m * self.dem.cell_width_m
        found = []
        for level in self.levels:
            cells = int((self.field <= level).sum())
            area = round(cells * cell_m2, 3)
            found.append({"within": level, "cells": cells, "area_m2": area})
        return found

    def raster(self) -> Float2D:
        """`field`, with NaN where nothing is reached."""
        return np.where(np.isfinite(self.field), self.field, np.float32(np.nan))

    def polygons(self, level: float) -> list[Polygon]:
        """The area within a level: along the cells' sides, with its holes; cells that touch at a
        corner are apart.
        """
        rasterio = optional_module("rasterio", "making polygons", "geo")
        features = optional_module("rasterio.features", "making polygons", "geo")
        transform = rasterio.Affine(*self.dem.located.transform)
        inside = self.field <= level
        found = features.shapes(
            inside.astype(np.uint8),
            mask=inside,
            connectivity=4,
            transform=transform,
        )
        return [shape["coordinates"] for shape, _ in found]

    def geojson(self) -> bytes:
        """A feature for each level, the widest first, so that others are drawn on it; coordinates
        as a path's.
        """
        found = []
        for area in self.areas[::-1]:
            properties = {"measure": self.measure, "unit": self.unit, **area}
            geometry = {"type": "MultiPolygon", "coordinates": self.polygons(area["within"])}
            found.append({"type": "Feature", "geometry": geometry, "properties": properties})
        collection = {"type": "FeatureCollection", "features": found}
        return json.dumps(collection | named_crs(self.dem)).encode()
