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

from dataclasses import replace

from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.any_angle import NO_DISC
from nnpp_edge.runtime.kernels.stations import freed
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import ANY_ANGLE, WAY_POINT_SAVES


def refines(name: str, grid: Grid) -> bool:
    """Whether paths are freed; InvalidQueryError for another name than ``any-angle``, or for this
    map's steps.
    """
    if name != "any-angle":
        raise InvalidQueryError(f"refine must be one of any-angle, got {name!r}")
    if grid.robot.line_refusal:
        raise InvalidQueryError(f"refine={name!r} {grid.robot.line_refusal}")
    return True


def refined(plan: Plan, state: MapState, deadline: Deadline = NEVER) -> Plan:
    """The plan with way points, where it has a path; the time that this takes is its stage
    ``refine``.

    From the deadline on nothing better is looked for: the line may then be the grid's path.
    """
    if not plan.ok:
        return plan
    watch = Work()
    room = state.room or NO_DISC
    points, cost = freed(
        state.grid.packed, room, plan.path, ANY_ANGLE, WAY_POINT_SAVES, deadline.at
    )
    along = state.along(points)
    took = watch.total_ms()
    total = plan.timings_ms.get("total", 0.0) + took
    timings = {**plan.timings_ms, "refine": took, "total": total}
    return replace(plan, waypoints=points, line_cost=cost, along=along, timings_ms=timings)
