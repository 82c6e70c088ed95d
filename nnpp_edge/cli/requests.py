"""Where a path of `plan` begins, leads through and ends."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import click

from nnpp_edge.cli.options import MANY, Parsed

if TYPE_CHECKING:
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.terrain.georeference import Place

_NUMBERS = re.compile(r"\s*([+-]?\d+)\s*,\s*([+-]?\d+)\s*|(xy|lonlat):([^,]+),([^,]+)")


class End(NamedTuple):
    """A place, or several in the order of a layer's points, as the user named them."""

    cells: "Callable[[Place], list[Cell]]"
    """The cells of a map below, perhaps outside it; InvalidQueryError for what has no place on the
    map's plane.
    """
    file: Path | None = None
    """The vector file, if it is one."""

    def one_cell(self, place: "Place", option: str) -> "Cell":
        """The cell below; InvalidQueryError where the layer has another number of points."""
        from nnpp_edge.runtime.errors import InvalidQueryError

        if len(cells := self.cells(place)) != 1:
            raise InvalidQueryError(f"{option} must be one place, got {len(cells)}")
        return cells[0]


def _end(word: str) -> End:
    if found := _NUMBERS.fullmatch(word):
        row, col, system, x, y = found.groups()
        at = float(row or x), float(col or y)
        if not all(map(math.isfinite, at)):
            raise ValueError
        if system is None:
            return End(lambda place: [(int(row), int(col))])
        return End(
            lambda place: [place.cell_of(*at)] if system == "xy" else _below_lonlat(place, at)
        )
    from nnpp_edge.terrain.vectors import named_file

    if "," in word or not word:
        raise ValueError
    # VectorFileError, a ValueError, where there is none
    return End(partial(_below_layer, word), named_file(word)[0])


def _below_lonlat(place: "Place", at: tuple[float, float]) -> "list[Cell]":
    import numpy as np

    from nnpp_edge.terrain.coordinates import lonlat_on_map

    return [place.cell_of(x, y) for x, y in lonlat_on_map(place, np.array([at])).tolist()]


def _below_layer(word: str, place: "Place") -> "list[Cell]":
    """The cells below a layer's points; a line on stderr says if they had to be reprojected."""
    from nnpp_edge.terrain.vectors import points_of

    points = points_of(word, place)
    if points.remark:
        click.echo(points.remark, err=True)
    return [place.cell_of(x, y) for x, y in points.places.tolist()]


PLACE = Parsed(
    "PLACE", "ROW,COL as two whole numbers, xy:X,Y, lonlat:LON,LAT, or a vector file", _end
)
Start = Annotated[End, PLACE, "ROW,COL from 0, xy:X,Y, lonlat:LON,LAT, or a vector file's point."]


FORMATS = {"gpkg": ("pyogrio", "vector"), "gpx": ("pyproj", "geo")}
"""What --format adds as path.NAME: the module that makes it, and the extra that brings that."""


@dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """Between which places `plan` plans, and what it shows beside the path."""

    start: Start
    goals: Annotated[
        tuple[End, ...], "--goal", PLACE, MANY, "As --start; of several, the nearest is used."
    ]
    via: Annotated[
        tuple[End, ...], PLACE, MANY, "Pass through this place, or a vector file's points."
    ] = ()
    best_order: Annotated[bool, "Visit the places of --via, 12 at most, in the cheapest order."] = (
        False
    )
    compare: Annotated[bool, "Plan with exact A* and the corridor planner too."] = False
    crop: Annotated[
        float | None,
        "Read and search only the map this many metres around start, goal and via.",
    ] = None
    formats: Annotated[
        tuple[str, ...],
        "--format",
        click.Choice(list(FORMATS)),
        MANY,
        "Also write path.gpkg or path.gpx.",
    ] = ()

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        if self.best_order and not self.via:
            raise click.UsageError("--best-order orders the places of --via: give --via too")

    @property
    def files(self) -> list[Path]:
        """Vector files that are read."""
        return [end.file for end in (self.start, *self.via, *self.goals) if end.file is not None]
