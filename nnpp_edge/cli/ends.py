"""Where a path begins, leads through and ends, in a user's words: cells, coordinates, and points of vector layers."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, NamedTuple

import click

from nnpp_edge.cli.options import Parsed

if TYPE_CHECKING:
    from pathlib import Path

    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.terrain.georeference import Place

PLACES = "ROW,COL as two whole numbers, xy:X,Y, lonlat:LON,LAT, or a vector file"
_NUMBERS = re.compile(r"\s*([+-]?\d+)\s*,\s*([+-]?\d+)\s*|(xy|lonlat):([^,]+),([^,]+)")


class End(NamedTuple):
    """A place, or several in the order of a layer's points, as the user named them."""

    word: str
    cell: Cell | None = None
    xy: tuple[float, float] | None = None
    """In the map's own system."""
    lonlat: tuple[float, float] | None = None

    @property
    def file(self) -> Path | None:
        """The vector file, if it is one."""
        if self.cell or self.xy or self.lonlat:
            return None
        from nnpp_edge.terrain.vectors import named_file

        return named_file(self.word)[0]

    def cells(self, place: Place) -> list[Cell]:
        """The cells of a map below; a layer that had to be reprojected is told of on stderr.

        InvalidQueryError for what has no place on the map's plane. A cell may lie outside the map.
        """
        if self.cell is not None:
            return [self.cell]
        if self.xy is not None:
            return [place.cell_of(*self.xy)]
        if self.lonlat is not None:
            import numpy as np

            from nnpp_edge.terrain.coordinates import lonlat_on_map

            points = lonlat_on_map(place, np.array([self.lonlat]))
        else:
            from nnpp_edge.terrain.vectors import points_of

            points, word = points_of(self.word, place)
            if word:
                click.echo(word, err=True)
        return [place.cell_of(x, y) for x, y in points.tolist()]

    def one_cell(self, place: Place, option: str) -> Cell:
        """The cell below; InvalidQueryError where the layer has another number of points."""
        from nnpp_edge.runtime.errors import InvalidQueryError

        if len(cells := self.cells(place)) != 1:
            raise InvalidQueryError(f"{option} must be one place, got {len(cells)}")
        return cells[0]


def _end(word: str) -> End:
    if found := _NUMBERS.fullmatch(word):
        row, col, system, x, y = found.groups()
        if system is None:
            return End(word, (int(row), int(col)))
        at = float(x), float(y)
        if not all(map(math.isfinite, at)):
            raise ValueError
        return End(word, xy=at) if system == "xy" else End(word, lonlat=at)
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
