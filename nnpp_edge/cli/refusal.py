"""Why a path cannot begin or end on a cell, and where it could."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from nnpp_edge.cli.plan_answer import Near
    from nnpp_edge.cli.plan_request import Ends
    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.runtime.errors import Status
    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.runtime.terrain.vehicle import Vehicle
    from nnpp_edge.terrain.georeference import Place

_LOOKED_AROUND = 64
"""Cells around an end that are tried for a place where the vehicle stands."""


def refusal(
    status: Status, cell: Cell, place: Place, near: Near, limits: Traversability, vehicle: Vehicle | None
) -> str:
    """Why there was no search from or to a cell, and for a blocked one which is the nearest passable cell."""
    import numpy as np

    name, _, problem = status.partition("_")
    end = f"{name.lower()} {cell}"
    if problem != "BLOCKED":
        return outside(name.lower(), cell, place)
    at = (cell[0] - near.origin[0], cell[1] - near.origin[1])
    if vehicle is not None and vehicle.is_disc and near.cost[at] < 1.0:
        return f"{end} is impassable: an obstacle or the map's edge lies within the vehicle's radius"
    if vehicle is not None and not vehicle.is_disc:
        where = _where_it_stands(cell, place, near, vehicle)
        return f"{end} is impassable: the vehicle stands there in no heading; {where}"
    reason = _why_blocked(at, near.elevation, place, limits)
    passable = np.argwhere(near.cost < 1.0)
    if not len(passable):
        return f"{end} is impassable: {reason}; so is all around it"
    nearest = passable[((passable - at) ** 2).sum(axis=1).argmin()] + near.origin
    return f"{end} is impassable: {reason}; the nearest passable cell is {tuple(nearest.tolist())}"


def refuse_outside(method: str, ends: Ends, place: Place) -> None:
    """InvalidQueryError where the start, or every goal, lies outside the map; for programs, the status as well."""
    from nnpp_edge.runtime.errors import InvalidQueryError, Status
    from nnpp_edge.runtime.planners.plan import Method, Plan

    (rows, cols), start = place.shape, Status.START_OUTSIDE_MAP
    for status, cells in ((start, [ends.start]), (Status.GOAL_OUTSIDE_MAP, ends.goals)):
        if not any(0 <= row < rows and 0 <= col < cols for row, col in cells):
            reason = outside("start" if status is start else "goal", cells[0], place)
            if click.get_current_context().params["as_json"]:
                click.echo(json.dumps(Plan(status, Method(method), reason=reason).summary()))
            raise InvalidQueryError(reason)


def outside(end: str, cell: Cell, place: Place) -> str:
    """What is said of a start or goal that lies outside the map."""
    return f"{end} {cell} lies outside the map of {place.shape[0]} × {place.shape[1]} cells{_spans(place)}"


def _spans(place: Place) -> str:
    """Which coordinates a map spans, as they are given, with a comma before; nothing where it has none."""
    if place.georeference is None:
        return ""
    import numpy as np

    from nnpp_edge.runtime.errors import NnppEdgeError

    rows, cols = place.shape
    corners = [place.map_coordinates(row - 0.5, col - 0.5) for row in (0, rows) for col in (0, cols)]
    (left, low), (right, high) = np.min(corners, 0), np.max(corners, 0)
    words = f", which spans x {left:.10g} to {right:.10g} and y {low:.10g} to {high:.10g}"
    try:
        from nnpp_edge.terrain.coordinates import lonlat_corners

        found = lonlat_corners(place)
    except NnppEdgeError:  # no coordinate system, or nothing that knows it
        return words
    (west, south), (east, north) = found.min(0), found.max(0)
    return f"{words}, longitude {west:.4f} to {east:.4f} and latitude {south:.4f} to {north:.4f}"


def _where_it_stands(cell: Cell, place: Place, near: Near, vehicle: Vehicle) -> str:
    """The nearest cell, if one is near, where the vehicle stands in some heading."""
    import numpy as np

    from nnpp_edge.runtime import pose_costs

    row, col = (max(each - _LOOKED_AROUND, 0) for each in cell)
    part = near.elevation[row : cell[0] + _LOOKED_AROUND + 1, col : cell[1] + _LOOKED_AROUND + 1]
    costs = pose_costs(part, place.cell_size_m, vehicle, cell_width_m=place.cell_width_m)
    stands = np.argwhere(np.isfinite(costs).any(0)) + np.array((row, col))
    if not len(stands):
        return f"nor on any cell within {_LOOKED_AROUND}"
    nearest = stands[((stands - cell) ** 2).sum(axis=1).argmin()]
    return f"the nearest cell where it does is {tuple(nearest.tolist())}"


def _why_blocked(cell: Cell, elevation: Float2D, place: Place, limits: Traversability) -> str:
    """What makes an impassable cell so."""
    import numpy as np

    from nnpp_edge.runtime.terrain.traversability import terrain_terms

    row0, col0 = max(cell[0] - 1, 0), max(cell[1] - 1, 0)
    patch = elevation[row0 : cell[0] + 2, col0 : cell[1] + 2]
    terms = terrain_terms(patch, place.cell_size_m, cell_width_m=place.cell_width_m)
    slope, roughness, step = terms[:, cell[0] - row0, cell[1] - col0].tolist()
    if np.isnan(slope):
        return "its elevation is unknown"
    found = (
        ("slope", np.degrees(slope), limits.hard_slope_deg, "°"),
        ("roughness", roughness, limits.hard_roughness_m, " m"),
        ("elevation difference", step, limits.hard_step_m, " m"),
    )
    for term, value, limit, unit in found:
        if value > limit:
            return f"{term} {value:.3g}{unit}, the hard limit is {limit:g}{unit}"
    return "slope, roughness and elevation difference are all at their limits"
