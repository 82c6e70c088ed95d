"""Why a path cannot begin or end on a cell, and where it could."""

import json
from typing import NamedTuple, NoReturn

import click
import numpy as np

from nnpp_edge.cli.maps import size_in_words
from nnpp_edge.runtime import Vehicle, pose_costs
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, NnppEdgeError, Status
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.terrain.traversability import Traversability, terrain_terms
from nnpp_edge.terrain.coordinates import lonlat_corners
from nnpp_edge.terrain.georeference import Place
from nnpp_edge.viz.sheet import Cells

_LOOKED_AROUND = 64
"""Cells around an end that are tried for a place where the vehicle stands."""


class Near(NamedTuple):
    """A part of a map, from its first cell on, and who drives there."""

    place: Place
    elevation: Float2D
    cost: Float2D
    limits: Traversability
    vehicle: Vehicle | None = None
    origin: Cell = (0, 0)


def refuse_map(place: Place) -> NoReturn:
    """InvalidMapError for a map without a passable cell; for programs, the status as well."""
    if click.get_current_context().params["as_json"]:
        click.echo(json.dumps({"status": "INVALID_MAP"}))
    raise InvalidMapError(f"{place.source}: wanted a map to plan on, got {size_in_words(place)}, all impassable")


def refuse_outside(start: Cell, goals: list[Cell], place: Place) -> None:
    """InvalidQueryError where the start, or every goal, lies outside the map."""
    rows, cols = place.shape
    for status, cells in ((Status.START_OUTSIDE_MAP, [start]), (Status.GOAL_OUTSIDE_MAP, goals)):
        if not any(0 <= row < rows and 0 <= col < cols for row, col in cells):
            _refuse(status, _outside(status, cells[0], place))


def refuse(status: Status, start: Cell, goal: Cell, near: Near) -> NoReturn:
    """InvalidQueryError for an end that is no place to be: the reason, and the nearest passable cell."""
    cell = start if status.startswith("START") else goal
    _refuse(status, _outside(status, cell, near.place) if "OUTSIDE" in status else _blocked(status, cell, near))


def _refuse(status: Status, reason: str) -> NoReturn:
    """InvalidQueryError; for programs that asked for a plan, the status as well."""
    given = click.get_current_context().params
    if given["as_json"] and "method" in given:
        click.echo(json.dumps(Plan(status, Method(given["method"]), reason=reason).summary()))
    raise InvalidQueryError(reason)


def _outside(status: Status, cell: Cell, place: Place) -> str:
    end, (rows, cols) = status.partition("_")[0].lower(), place.shape
    return f"{end} {cell} lies outside the map of {rows} × {cols} cells{_spans(place)}"


def _spans(place: Place) -> str:
    """Which coordinates a map spans, as they are given, with a comma before; nothing where it has none."""
    if place.georeference is None:
        return ""

    rows, cols = place.shape
    corners = [place.map_coordinates(row - 0.5, col - 0.5) for row in (0, rows) for col in (0, cols)]
    (left, low), (right, high) = np.min(corners, 0), np.max(corners, 0)
    words = f", which spans x {left:.10g} to {right:.10g} and y {low:.10g} to {high:.10g}"
    try:
        found = lonlat_corners(place)
    except NnppEdgeError:  # no coordinate system, or nothing that knows it
        return words
    (west, south), (east, north) = found.min(0), found.max(0)
    return f"{words}, longitude {west:.4f} to {east:.4f} and latitude {south:.4f} to {north:.4f}"


def _blocked(status: Status, cell: Cell, near: Near) -> str:
    end = f"{status.partition('_')[0].lower()} {cell} is impassable"
    vehicle, at = near.vehicle, (cell[0] - near.origin[0], cell[1] - near.origin[1])
    if vehicle is not None and vehicle.is_disc and near.cost[at] < 1.0:
        return f"{end}: an obstacle or the map's edge lies within the vehicle's radius"
    if vehicle is not None and not vehicle.is_disc:
        return f"{end}: the vehicle stands there in no heading; {_where_it_stands(cell, near, vehicle)}"
    reason = _why_blocked(at, near)
    passable = np.argwhere(near.cost < 1.0)
    if not len(passable):
        return f"{end}: {reason}; so is all around it"
    return f"{end}: {reason}; the nearest passable cell is {_nearest(passable + near.origin, cell)}"


def _nearest(cells: Cells, cell: Cell) -> tuple[int, ...]:
    return tuple(cells[((cells - cell) ** 2).sum(axis=1).argmin()].tolist())


def _where_it_stands(cell: Cell, near: Near, vehicle: Vehicle) -> str:
    """The nearest cell, if one is near, where the vehicle stands in some heading."""
    row, col = (max(each - _LOOKED_AROUND, 0) for each in cell)
    part = near.elevation[row : cell[0] + _LOOKED_AROUND + 1, col : cell[1] + _LOOKED_AROUND + 1]
    costs = pose_costs(part, near.place.cell_size_m, vehicle, cell_width_m=near.place.cell_width_m)
    stands = np.argwhere(np.isfinite(costs).any(0)) + np.array((row, col))
    if not len(stands):
        return f"nor on any cell within {_LOOKED_AROUND}"
    return f"the nearest cell where it does is {_nearest(stands, cell)}"


def _why_blocked(cell: Cell, near: Near) -> str:
    row0, col0 = max(cell[0] - 1, 0), max(cell[1] - 1, 0)
    patch, limits = near.elevation[row0 : cell[0] + 2, col0 : cell[1] + 2], near.limits
    terms = terrain_terms(patch, near.place.cell_size_m, cell_width_m=near.place.cell_width_m)
    slope, roughness, step = terms[:, cell[0] - row0, cell[1] - col0].tolist()
    if np.isnan(slope):
        return "its elevation is unknown"
    for term, value, limit, unit in (
        ("slope", np.degrees(slope), limits.hard_slope_deg, "°"),
        ("roughness", roughness, limits.hard_roughness_m, " m"),
        ("elevation difference", step, limits.hard_step_m, " m"),
    ):
        if value > limit:
            return f"{term} {value:.3g}{unit}, the hard limit is {limit:g}{unit}"
    return "slope, roughness and elevation difference are all at their limits"
