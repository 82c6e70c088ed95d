"""`plan` on a map that is larger than memory."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from nnpp_edge.cli.maps import warn_if_not_square
from nnpp_edge.cli.plan_answer import Answer
from nnpp_edge.cli.refusal import Near, refuse, refuse_map, refuse_outside
from nnpp_edge.progress import bar
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.memory import peak_bytes
from nnpp_edge.runtime.planners.windowed import WindowedPlanner
from nnpp_edge.terrain.route import Route

if TYPE_CHECKING:
    from nnpp_edge.cli.options import TerrainOptions
    from nnpp_edge.cli.plan import Request
    from nnpp_edge.cli.vehicle_options import VehicleOptions
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.terrain.dem_windows import DemWindows

_AROUND = 64
"""Cells around a blocked start or goal in which a passable one is looked for."""
_MOST_PIXELS = 2000
"""Of a picture's longer side: as many as `viz` draws."""


def plan_by_windows(request: Request, path: Path, terrain: TerrainOptions, vehicle: VehicleOptions) -> Answer:
    """Plan on a map of which only the coarse levels and what lies under a corridor are in memory."""
    _refuse_unfit(request)
    limits, within = terrain.limits(), request.limits
    with terrain.open(path) as ground:
        warn_if_not_square(ground)
        start, via, goals = request.ends(ground)
        refuse_outside(start, goals, ground)
        planner = WindowedPlanner(
            ground,
            limits,
            omega=request.omega,
            corner_cutting=request.corner_cutting,
            mobility=vehicle.mobility(ground),
            progress=_Bars(ground.shape[0]),
        )
        if not planner.any_passable:
            refuse_map(ground)
        tour = planner.plan_via(start, goals[0], via, best_order=request.best_order, **within) if via else None
        plans = [(goals[0], tour.plan)] if tour else [(goal, planner.plan(start, goal, **within)) for goal in goals]
        ranked = sorted(plans, key=lambda found: (not found[1].ok, found[1].cost))
        goal, plan = ranked[0]
        if plan.source is None:  # no search was made
            refuse(
                plan.status, start, goal, _around(planner, ground, limits, start if "START" in plan.status else goal)
            )
        _, costs = planner.costs.along(plan.path)
        assert plan.along is not None
        factor, cost = planner.coarse_costs(_MOST_PIXELS)
        return Answer(
            plan,
            Route(plan.path, plan.along, costs, ground),
            start,
            goal,
            cost,
            factor=factor,
            goals=ranked if len(goals) > 1 else [],
            windows=_read(planner, ground),
            tour=tour,
            hard_slope_deg=limits.hard_slope_deg,
        )


def _around(planner: WindowedPlanner, ground: DemWindows, limits: Traversability, cell: Cell) -> Near:
    """Heights and costs around a cell of the map, or at its border where the cell lies outside."""
    (row0, row1), (col0, col1) = (
        (min(max(at - _AROUND, 0), side - 1), max(min(at + _AROUND + 1, side), 1))
        for at, side in zip(cell, planner.shape, strict=True)
    )
    part = (row0, col0, max(row1 - row0, 1), max(col1 - col0, 1))
    _, elevation, cost = next(planner.costs.windows([part]))
    return Near(ground, elevation, cost, limits, origin=(row0, col0))


class _Bars:
    """A progress bar for each time that the map's rows are read."""

    def __init__(self, rows: int) -> None:
        self._rows, self._open, self._what = rows, ExitStack(), ""

    def __call__(self, what: str, done: int) -> None:
        """Show how far this reading has come."""
        if what != self._what:
            self._open.close()
            self._advance, self._what = self._open.enter_context(bar(what, self._rows)), what
        self._advance(done)
        if done == self._rows:
            self._open.close()
            self._what = ""


def _refuse_unfit(request: Request) -> None:
    """InvalidQueryError for what needs the whole map."""
    given = {
        f"--method {request.method}": request.method in ("astar", "nnpp"),
        "--compare": request.compare,
        "--landmarks": request.landmarks > 0,
        "--hillshade": request.hillshade,
        "--refine": request.refine is not None,
    }
    if wrong := [name for name, asked in given.items() if asked]:
        raise InvalidQueryError(
            f"{', '.join(wrong)} needs the whole map in memory: leave it out for the corridor method, which reads by "
            "windows, or cut out a part of the map"
        )


def _read(planner: WindowedPlanner, ground: DemWindows) -> dict[str, float]:
    """What was read: GB of heights as they are stored, cells read again as a share, seconds, and peak memory."""
    reading = planner.reading()
    return {
        "gigabytes": 1e-9 * reading.cells_read * ground.raster.dtype.itemsize,
        "read_again": reading.read_again,
        "map_s": 1e-3 * reading.map_ms,
        "peak_memory_gb": 1e-9 * peak_bytes(),
    }
