"""A planned path on the ground: where its cells lie, how far along they are, and the files that say so."""

import io
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.georeference import Place

_EPSG = re.compile(r'(?:AUTHORITY|ID)\["EPSG",\s*"?(\d+)"?\]\]\s*$')


@dataclass(frozen=True, eq=False)
class Route:
    """A path over a DEM.

    Attributes
    ----------
    cells : (N, 2) int32
        Row and column, from start to goal; N may be 0.
    places : (N, 2) float64
        x and y: the map's own coordinates of the cells' centres. On a DEM without a georeference, metres from
        the centre of cell (0, 0), y downwards.
    elevation_m, cost : (N,) float32
    distance_m : (N,) float64
        Along the path, on the level.
    dem : Place
        The map that it leads over.
    standing : mapping of str to (N,) float
        How a vehicle stands on each cell: headings, angles and clearances by name; empty for a point.
    """

    cells: NDArray[np.int32]
    places: NDArray[np.float64]
    elevation_m: NDArray[np.float32]
    cost: NDArray[np.float32]
    distance_m: NDArray[np.float64]
    dem: Place
    standing: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    @classmethod
    def of(cls, cells: NDArray[np.int32], cost: NDArray[np.float32], dem: Dem) -> "Route":
        """The route of a path's cells, with the cost map that it was planned on."""
        rows, cols = cells[:, 0], cells[:, 1]
        return cls.along(cells, dem.elevation[rows, cols], cost[rows, cols], dem)

    @classmethod
    def along(
        cls, cells: NDArray[np.int32], elevation_m: NDArray[np.float32], cost: NDArray[np.float32], dem: Place
    ) -> "Route":
        """The route of a path's cells, with their heights and costs, on a map that need not be in memory."""
        sides = np.array([dem.cell_size_m, dem.cell_width_m])
        if dem.georeference is None:
            places = (cells * sides)[:, ::-1]
        else:
            found = [dem.georeference.map_coordinates(int(row), int(col)) for row, col in cells]
            places = np.array(found, np.float64).reshape(-1, 2)
        steps = np.hypot(*(np.diff(cells, axis=0) * sides).T)
        along = np.concatenate([[0.0], np.cumsum(steps)])[: len(cells)]
        return cls(cells, places, elevation_m, cost, along, dem)

    @property
    def length_m(self) -> float:
        """Length on the level; 0 without a path."""
        return float(self.distance_m[-1]) if len(self.cells) else 0.0

    def stands(self) -> dict[str, list[float | None]]:
        """`standing`, ready for JSON: None for what is not finite."""
        return {
            name: [round(number, 4) if math.isfinite(number) else None for number in numbers.tolist()]
            for name, numbers in self.standing.items()
        }

    def csv(self) -> bytes:
        """A line a cell, under a header; with a vehicle, how it stands there too."""
        out = io.StringIO()
        out.write(",".join(("row,col,x,y,elevation_m,cost,distance_m", *self.standing)) + "\n")
        columns = (self.cells.tolist(), self.places.tolist(), self.elevation_m, self.cost, self.distance_m)
        stands = zip(*self.standing.values(), strict=True) if self.standing else iter([()] * len(self.cells))
        for (row, col), (x, y), elevation, cost, distance, own in zip(*columns, stands, strict=True):
            out.write(f"{row},{col},{x!r},{y!r},{elevation:.7g},{cost:.6g},{distance:.10g}")
            out.write("".join(f",{number:.6g}" for number in own) + "\n")
        return out.getvalue().encode()

    def geojson(self, properties: dict[str, object]) -> bytes:
        """A feature with the path as a line: a point where it is one cell, no geometry where there is none.

        Coordinates are `places`, although RFC 7946 knows longitude and latitude on the Earth only: paths on
        other bodies have neither. `crs` in the properties is the coordinate system as WKT, or null. A system
        with an EPSG number is named the way of GeoJSON 2008 too, which GDAL and QGIS read.
        """
        places = self.places.tolist()
        geometry: dict[str, object] | None = None
        if places:
            one = len(places) == 1
            geometry = {"type": "Point" if one else "LineString", "coordinates": places[0] if one else places}
        place = self.dem.georeference
        meaning = "metres from the centre of cell (0, 0), y downwards" if place is None else "the map's own"
        crs = place.crs if place else None
        feature = {
            "type": "Feature",
            "geometry": geometry,
            "properties": {**properties, **self.stands(), "coordinates": meaning, "crs": crs},
        }
        if number := _EPSG.search(crs or ""):
            name = f"urn:ogc:def:crs:EPSG::{number[1]}"
            feature["crs"] = {"type": "name", "properties": {"name": name}}
        return json.dumps(feature, allow_nan=False).encode()
