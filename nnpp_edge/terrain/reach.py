"""Areas within reach of a place, as areas in map coordinates: GeoJSON, or a GeoPackage. By rasterio."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.route import named_crs
from nnpp_edge.terrain.vectors import geopackage_bytes, polygons_wkb

Polygon = list[list[tuple[float, float]]]
"""Rings of x and y: the outer one, then its holes."""


@dataclass(frozen=True, eq=False)
class Reach:
    """The areas that can be reached within each of several costs; InvalidQueryError for levels that do not ascend."""

    field: Float2D
    """(H, W) cost of getting to each cell; inf where that is not possible, or costs more than the last level."""
    levels: tuple[float, ...]
    """Costs, ascending."""
    measure: str
    """Of the costs: ``cost``, ``time`` or ``energy``."""
    unit: str
    dem: Dem

    def __post_init__(self) -> None:
        if not self.levels or any(np.diff(self.levels) <= 0.0) or not all(map(math.isfinite, self.levels)):
            raise InvalidQueryError(f"levels must be ascending numbers, got {self.levels}")

    @property
    def cells(self) -> list[int]:
        """How many cells can be reached within each level."""
        return [int((self.field <= level).sum()) for level in self.levels]

    @property
    def areas_m2(self) -> list[float]:
        """Their area on the level."""
        return [cells * self.dem.cell_size_m * self.dem.cell_width_m for cells in self.cells]

    def raster(self) -> NDArray[np.float32]:
        """`field`, with NaN where nothing is reached."""
        return np.where(np.isfinite(self.field), self.field, np.float32(np.nan))

    def polygons(self, level: float) -> list[Polygon]:
        """The area within a level: along the cells' sides, with its holes; cells that touch at a corner are apart."""
        rasterio = optional_module("rasterio", "making polygons", "geo")
        features = optional_module("rasterio.features", "making polygons", "geo")
        height, width = self.dem.cell_size_m, self.dem.cell_width_m
        own = (width, 0.0, -0.5 * width, 0.0, height, -0.5 * height)
        transform = rasterio.Affine(*(self.dem.georeference.transform if self.dem.georeference else own))
        inside = self.field <= level
        found = features.shapes(inside.astype(np.uint8), mask=inside, connectivity=4, transform=transform)
        return [shape["coordinates"] for shape, _ in found]

    def geojson(self) -> bytes:
        """A feature for each level, the widest first; coordinates as in a path's GeoJSON."""
        found = []
        for level, properties in self._layers():
            geometry = {"type": "MultiPolygon", "coordinates": self.polygons(level)}
            found.append({"type": "Feature", "geometry": geometry, "properties": properties})
        return json.dumps({"type": "FeatureCollection", "features": found} | named_crs(self.dem)).encode()

    def geopackage(self) -> bytes:
        """These areas as a GeoPackage whose layer is `reach`; MissingExtraError where pyogrio is not installed."""
        layers = self._layers()
        shapes = [polygons_wkb([[np.array(r) for r in p] for p in self.polygons(level)]) for level, _ in layers]
        fields: dict[str, Sequence[object]] = {name: [p[name] for _, p in layers] for name in layers[0][1]}
        return geopackage_bytes("reach", "MultiPolygon", shapes, fields, self.dem)

    def _layers(self) -> list[tuple[float, dict[str, object]]]:
        """Each level with its properties, the widest first, so that the others are drawn on it."""
        found = zip(self.levels, self.cells, self.areas_m2, strict=True)
        return [
            (level, {"within": level, "measure": self.measure, "unit": self.unit, "cells": cells, "area_m2": area})
            for level, cells, area in reversed(list(found))
        ]
