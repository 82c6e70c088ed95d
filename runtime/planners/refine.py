"""Paths freed from the grid: way points anywhere, priced by the line integral of the cost.

What the grid says of cells is read as a cost for each cell's length along a line. In a cell's
middle that is what a straight step on such ground costs: 1 + 2·w in the ``paper`` model, with its
weight w = 255·ω·T, and the weight itself in ``length``. Between the middles it is bilinear, and
impassable cells are left out of the mean. So a straight step costs by the integral what it costs by
the grid. A diagonal step of ``paper`` costs more, √2 + √2·(w_i + w_j) on even ground: the paper
charges √2 for its length, but 1 for its weights. Where they weigh much, the grid's best path is
therefore another than the best line, and more has to be done than to smooth it.

Stations on the grid's path are moved across it, all of them together, to the cheapest choice
(dynamic programming), first far and coarsely, then near and finely; `tuning.ANY_ANGLE` lists the
stages. Then way points that save next to nothing are left out. The line never costs more than the
grid's path by the same integral: else it is that path.

A body's path is not freed: its legs lead in sixteen directions, each checked at its own heading.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Cells, Floats
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.kernels.any_angle import NO_DISC, line_cost
from nnpp_edge.runtime.kernels.stations import freed
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.turns import curvatures, with_arcs
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import ANY_ANGLE, WAY_POINT_SAVES

_ROUNDER = 1.02
"""Radius of the arcs that are laid, over that asked for: way points on an arc turn a little sharper
than it does.
"""
_COARSER = (1.0, 8.0, 64.0)
"""Multiples of what a way point must save, tried one after another where turns are too sharp."""


def refines(name: str, grid: Grid) -> bool:
    """Whether paths are freed; InvalidQueryError for another name than ``any-angle``, or for this
    map's steps.
    """
    if name != "any-angle":
        raise InvalidQueryError(f"refine must be one of any-angle, got {name!r}")
    if grid.robot.line_refusal:
        raise InvalidQueryError(f"refine={name!r} {grid.robot.line_refusal}")
    return True


class PricedLine(NamedTuple):
    """Way points, and the line integral along them."""

    points: Floats
    cost: float


class Refiner:
    """Frees paths of one map from the grid. Serves one thread at a time."""

    def __init__(self, state: MapState) -> None:
        self._state = state
        self._grid = state.grid
        self._room = state.room or NO_DISC
        self._sides_m = state.sides_m or (1.0, 1.0)

    def refined(
        self, plan: Plan, turning_radius_m: float | None = None, deadline: Deadline = NEVER
    ) -> Plan:
        """The plan with way points, where it has a path; the time that this takes is its stage
        ``refine``.

        No turn is sharper than the radius, by default the vehicle's: where no such line is found
        near the path, the plan says NO_PATH and why. From the deadline on nothing better is looked
        for: the line may then be the grid's path. InvalidQueryError where the radius is not
        positive, or the map's cells have no known size.
        """
        wanted = turning_radius_m
        if wanted is None and self._state.vehicle is not None:
            wanted = self._state.vehicle.turning_radius_m
        radius = self._radius(wanted)
        if not plan.ok:
            return plan
        watch = Work()
        line = self.line_along(plan.path, radius, deadline)
        if line is None:
            reason = (
                f"no line that turns with a radius of {wanted:g} m was found near the grid's path"
            )
            found = Plan(
                Status.NO_PATH, plan.method, plan.source, planner=plan.planner, reason=reason
            )
        else:
            along = self._state.along(line.points)
            found = replace(plan, waypoints=line.points, line_cost=line.cost, along=along)
        took = watch.total_ms()
        total = plan.timings_ms.get("total", 0.0) + took
        timings = {**plan.timings_ms, "refine": took, "total": total}
        return replace(found, timings_ms=timings)

    def line_along(
        self, path: Cells, radius: float = 0.0, deadline: Deadline = NEVER
    ) -> PricedLine | None:
        """A line near a path of cells that costs no more, with no turn sharper than `radius` cells;
        None without.
        """
        if len(path) < 2:
            return PricedLine(path.astype(np.float64), 0.0)
        for coarser in _COARSER:
            saves = WAY_POINT_SAVES * coarser
            line = PricedLine(
                *freed(self._grid.packed, self._room, path, ANY_ANGLE, saves, deadline.at)
            )
            if not radius or self._turns(line.points, radius):
                return line
            rounded = with_arcs(line.points, _ROUNDER * radius)
            if rounded is not None and self._turns(rounded, radius):
                cost = self.cost(rounded)
                if cost < math.inf:
                    return PricedLine(rounded, cost)
        return None

    def cost(self, points: Floats) -> float:
        """The line integral along way points; inf where it leads through what is impassable."""
        return float(line_cost(self._grid.packed, self._room, points))

    def _turns(self, points: Floats, radius: float) -> bool:
        """Whether no turn is sharper than a radius, in cells; on cells that are not square, in
        metres too.
        """
        scale = np.array(self._sides_m) / min(self._sides_m)
        return bool((curvatures(points * scale) * radius <= 1.0).all())

    def _radius(self, turning_radius_m: float | None) -> float:
        """In cells; 0 where any turn will do."""
        if turning_radius_m is None:
            return 0.0
        if not 0.0 < turning_radius_m < math.inf:
            raise InvalidQueryError(
                f"turning_radius_m must be a positive number of metres, got {turning_radius_m}"
            )
        if self._state.sides_m is None:
            raise InvalidQueryError(
                "turning_radius_m wants a map whose cells have a size: Planner.of_elevation"
            )
        return turning_radius_m / min(self._state.sides_m)
