"""Where a path of `plan` begins, leads through and ends."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli.options import MANY, Parsed

if TYPE_CHECKING:
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.terrain.georeference import Place

_NUMBERS = re.compile(r"\s*([+-]?\d+)\s*,\s*([+-]?\d+)\s*|(xy|lonlat):([^,]+),([^,]+)")


End = Callable[["Place"], "Cell"]
"""The cell of a map below a place that the user named, perhaps outside it; InvalidQueryError for
what has no place on the map's plane.
"""


def _end(word: str) -> End:
    if (found := _NUMBERS.fullmatch(word)) is None:
        raise ValueError
    row, col, system, x, y = found.groups()
    at = float(row or x), float(col or y)
    if not all(map(math.isfinite, at)):
        raise ValueError
    if system is None:
        return lambda place: (int(row), int(col))
    return lambda place: place.cell_of(*at) if system == "xy" else _below_lonlat(place, at)


def _below_lonlat(place: "Place", at: tuple[float, float]) -> "Cell":
    import numpy as np

    from nnpp_edge.terrain.coordinates import lonlat_on_map

    ((x, y),) = lonlat_on_map(place, np.array([at])).tolist()
    return place.cell_of(x, y)


PLACE = Parsed("PLACE", "ROW,COL as two whole numbers, xy:X,Y or lonlat:LON,LAT", _end)
Start = Annotated[End, PLACE, "ROW,COL from 0, xy:X,Y or lonlat:LON,LAT."]


@dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """Between which places `plan` plans, and what it shows beside the path."""

    start: Start
    goal: Annotated[End, PLACE, "As --start."]
    via: Annotated[tuple[End, ...], PLACE, MANY, "Pass through this place."] = ()
    best_order: Annotated[bool, "Visit the places of --via, 12 at most, in the cheapest order."] = (
        False
    )
    compare: Annotated[bool, "Plan with exact A* and the corridor planner too."] = False
    crop: Annotated[
        float | None,
        "Read and search only the map this many metres around start, goal and via.",
    ] = None
    gpkg: Annotated[bool, "Also write path.gpkg, a GeoPackage."] = False

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        if self.best_order and not self.via:
            raise click.UsageError("--best-order orders the places of --via: give --via too")
