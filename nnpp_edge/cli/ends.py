"""Where a path begins, leads through and ends, in a user's words: cells, coordinates, and points of vector layers."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli.options import Parsed

if TYPE_CHECKING:
    from pathlib import Path

    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.terrain.georeference import Place

PLACES = "ROW,COL as two whole numbers, xy:X,Y, lonlat:LON,LAT, or a vector file"
_CELL = re.compile(r"\s*([+-]?\d+)\s*,\s*([+-]?\d+)\s*")
_COORDINATES = re.compile(r"(xy|lonlat):([^,]+),([^,]+)")


@dataclass(frozen=True)
class End:
    """A place, or several in the order of a layer's points, as the user named them."""

    word: str
    cell: Cell | None = None
    coordinates: tuple[float, float] | None = None
    """In the map's own system, or longitude and latitude in degrees where `lonlat`."""
    lonlat: bool = False

    @property
    def file(self) -> Path | None:
        """The vector file, if it is one."""
        if self.cell is not None or self.coordinates is not None:
            return None
        from nnpp_edge.terrain.vectors import named_file

        return named_file(self.word)[0]

    def cells(self, place: Place) -> list[Cell]:
        """The cells of a map below; a layer that had to be reprojected is told of on stderr.

        InvalidQueryError for what has no place on the map's plane. A cell may lie outside the map.
        """
        if self.cell is not None:
            return [self.cell]
        if self.coordinates is not None and not self.lonlat:
            return [place.cell_of(*self.coordinates)]
        import numpy as np

        if self.coordinates is not None:
            from nnpp_edge.terrain.coordinates import lonlat_on_map

            points = lonlat_on_map(place, np.array([self.coordinates]))
        else:
            from nnpp_edge.terrain.vectors import points_of

            points, word = points_of(self.word, place)
            if word:
                click.echo(word, err=True)
        return [place.cell_of(x, y) for x, y in points.tolist()]


def _end(word: str) -> End:
    if found := _CELL.fullmatch(word):
        return End(word, (int(found[1]), int(found[2])))
    if found := _COORDINATES.fullmatch(word):
        x, y = float(found[2]), float(found[3])
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError
        return End(word, None, (x, y), found[1] == "lonlat")
    from nnpp_edge.terrain.vectors import VectorFileError, named_file

    if "," in word or not word:
        raise ValueError
    try:
        named_file(word)
    except VectorFileError as error:
        raise ValueError from error
    return End(word)


def Where() -> Parsed:
    """A cell, coordinates, or a vector layer's points."""
    return Parsed("PLACE", PLACES, _end)
