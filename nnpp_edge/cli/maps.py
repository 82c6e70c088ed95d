"""A map as commands meet it: its size in words, whether it fits into memory, why a path cannot
begin on a cell.
"""

import json
import math
import warnings
from contextlib import suppress
from itertools import compress, product
from pathlib import Path
from typing import NoReturn

import click
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.progress import bar
from nnpp_edge.runtime import Ground, Planner
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, slices, widened
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, NnppEdgeError, Status
from nnpp_edge.runtime.memory import available_bytes, filed_zeros
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.terrain.traversability import (
    Traversability,
    traversability_cost,
    why_impassable,
)
from nnpp_edge.terrain import dem as dems
from nnpp_edge.terrain.coordinates import lonlat_corners
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.georeference import Place
from nnpp_edge.terrain.rasters import READ_IN_METRES, Raster
from nnpp_edge.viz.relief import Chart

_MOST_UNEQUAL_SIDES = 0.05
"""Cells whose sides differ by more than this share are warned of."""
_AROUND = 64
"""Cells around an impassable end that are tried for a passable one."""


def size_of(place: Place) -> dict[str, object]:
    """Rows, columns and the sides of a cell, ready for JSON."""
    rows, cols = place.shape
    return {
        "rows": rows,
        "cols": cols,
        "cell_size_m": place.cell_size_m,
        "cell_width_m": place.cell_width_m,
    }


def size_in_words(place: Place) -> str:
    """Rows, columns and the sides of a cell."""
    rows, cols = place.shape
    size = place.cell_size_m
    width = place.cell_width_m
    square = abs(size - width) <= 5e-4 * size
    cell = f"{size:.4g} m" if square else f"{size:.4g} m (north) × {width:.4g} m (east)"
    return f"{rows} × {cols} cells of {cell}"


def warn_if_not_square(place: Place) -> None:
    """Warn of cells whose sides differ."""
    if abs(place.cell_size_m - place.cell_width_m) > _MOST_UNEQUAL_SIDES * place.cell_size_m:
        warnings.warn(
            f"{size_in_words(place)}: slopes and lengths in metres take both sides into account, "
            "but the search treats cells as square",
            stacklevel=2,
        )


def cost_of(dem: Dem, limits: Traversability) -> Float2D:
    """The cost map of an elevation map."""
    return traversability_cost(
        dem.elevation, dem.cell_size_m, limits, cell_width_m=dem.cell_width_m
    )


def chart_of(dem: Dem, cost: Float2D) -> Chart:
    """The map to draw on."""
    return Chart(cost, dem.elevation, (dem.cell_size_m, dem.cell_width_m), dem.north_deg)


def reads_by_windows(
    dem: Path, memory: float | None, bytes_per_cell: int, *, whole: bool = False
) -> bool:
    """Whether a map needs more memory than is free, or than was given; then a warning says so.

    InvalidQueryError if it does and the `whole` map is needed, as for a vehicle and for directed
    step costs.
    """
    if (size := dems.size_of(dem)) is None:
        return False
    wanted = size[0] * size[1] * bytes_per_cell
    room = available_bytes() if memory is None else memory
    if wanted <= room:
        return False
    from rich.filesize import decimal

    left = "are free" if memory is None else "are allowed"
    cells = "{} × {} cells".format(*size)
    need = f"{cells} need {decimal(wanted)} in memory, {decimal(int(room))} {left}"
    if whole:
        raise InvalidQueryError(
            f"{need}: with a vehicle or a directed step cost it is planned in memory alone, so cut "
            "out a part of the map (--crop)"
        )
    warnings.warn(f"{need}: read by windows", stacklevel=2)
    return True


def filed(ground: Raster) -> Dem:
    """A map whose heights lie in a temporary file."""
    heights = filed_zeros(ground.shape, np.float32)
    with bar("rows of the map", ground.shape[0]) as advance:
        for part in ground.bands():
            heights[slices(part)] = ground.read(part)
            advance(part[0] + part[2])
    return Dem(heights, *ground.sides_m, ground.georeference, ground.source)


def refuse_map(place: Place) -> NoReturn:
    """InvalidMapError for a map without a passable cell; for programs, the status as well."""
    context = click.get_current_context(silent=True)
    if context is not None and context.params.get("as_json"):
        click.echo(json.dumps({"status": "INVALID_MAP"}))
    raise InvalidMapError(
        f"{place.source}: wanted a map to plan on, got {size_in_words(place)}, all impassable; "
        f"{READ_IN_METRES}"
    )


def refuse_outside(start: Cell, goal: Cell, place: Place) -> None:
    """InvalidQueryError where the start or the goal lies outside the map."""
    rows, cols = place.shape
    for status, cell in ((Status.START_OUTSIDE_MAP, start), (Status.GOAL_OUTSIDE_MAP, goal)):
        if not (0 <= cell[0] < rows and 0 <= cell[1] < cols):
            _refuse(status, _outside(status, cell, place))


def refuse(
    status: Status, start: Cell, goal: Cell, dem: Dem, planner: Planner, ground: Ground
) -> NoReturn:
    """InvalidQueryError for an end that is no place to be: the reason, and the nearest passable
    cell.
    """
    cell = start if status.startswith("START") else goal
    if status.endswith("OUTSIDE_MAP"):
        _refuse(status, _outside(status, cell, dem))
    _refuse(status, _blocked(status, cell, dem, planner, ground))


def _refuse(status: Status, reason: str) -> NoReturn:
    """InvalidQueryError; for programs that asked for a plan, the status as well."""
    given = click.get_current_context().params
    if given["as_json"] and "method" in given:
        click.echo(
            json.dumps(Plan(status, Method(given["method"] or "auto"), reason=reason).summary())
        )
    raise InvalidQueryError(reason)


def _outside(status: Status, cell: Cell, place: Place) -> str:
    """That a cell lies outside the map, with the coordinates that the map spans, as they
    are given.
    """
    rows, cols = place.shape
    end = status.partition("_")[0].lower()
    corners = product((-0.5, rows - 0.5), (-0.5, cols - 0.5))
    points = np.array([place.map_coordinates(*corner) for corner in corners])
    x, y = (_span(each, ".10g") for each in points.T)
    words = f"{end} {cell} lies outside the map of {rows} × {cols} cells"
    words += f", which spans x {x} and y {y}"
    with suppress(NnppEdgeError):  # no coordinate system, or nothing that knows it
        lon, lat = (_span(each, ".4f") for each in lonlat_corners(place).T)
        words += f", longitude {lon} and latitude {lat}"
    return words


def _span(values: NDArray[np.float64], form: str) -> str:
    """The least and the greatest of them, in a form."""
    return f"{format(values.min(), form)} to {format(values.max(), form)}"


def _blocked(status: Status, cell: Cell, dem: Dem, planner: Planner, ground: Ground) -> str:
    """Why no path begins or ends on a cell, and the nearest one around where it could."""
    end = f"{status.partition('_')[0].lower()} {cell} is impassable"
    row, col, rows, cols = part = widened((*cell, 1, 1), (_AROUND, _AROUND), dem.shape)
    grid = planner.state.grid
    stance = grid.robot.stance
    reason = stance.why_blocked(cell)
    if not reason:
        at = (cell[0] - row, cell[1] - col)
        reason = why_impassable(dem.elevation[slices(part)], at, ground.sides_m, ground.limits)
    around = list(product(range(row, row + rows), range(col, col + cols)))
    passable = list(compress(around, stance.stands_at(grid, *around)))
    if not passable:
        return f"{end}: {reason}; so is all around it"
    where = "passable cell" if ground.body is None else "cell where it can stand"
    nearest = min(passable, key=lambda each: math.dist(each, cell))
    return f"{end}: {reason}; the nearest {where} is {nearest}"
