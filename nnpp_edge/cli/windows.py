"""`plan` and `costmap` on maps that are larger than memory: which these are, and planning on one."""

from __future__ import annotations

import warnings
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from nnpp_edge.cli.options import TerrainOptions
from nnpp_edge.cli.plan_answer import Answer, Near, Planned, WindowsRead, refuse_impassable, warn_if_not_square
from nnpp_edge.cli.refusal import refuse_outside

if TYPE_CHECKING:
    from nnpp_edge.cli.plan_request import Request
    from nnpp_edge.cli.vehicle_options import VehicleOptions
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.runtime.planners.plan import Plan
    from nnpp_edge.runtime.planners.windowed import WindowedPlanner
    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.terrain.dem_windows import DemWindows

_AROUND = 64
"""Cells around a blocked start or goal in which a passable one is looked for."""
_MOST_PIXELS = 2000
"""Of a picture's longer side: as many as `viz` draws."""


def reads_by_windows(
    dem: Path, terrain: TerrainOptions, memory: float | None, bytes_per_cell: int, *, whole: bool = False
) -> bool:
    """Whether a map needs more memory than is free, or than was given; then a warning says so.

    InvalidQueryError if it does and the `whole` map is needed, as for a vehicle and for directed step costs.
    """
    from nnpp_edge.runtime.memory import available_bytes
    from nnpp_edge.terrain.dem_windows import size_of

    size = size_of(dem, allow_vrt=terrain.allow_vrt)
    if size is None:
        return False
    wanted, room = size[0] * size[1] * bytes_per_cell, available_bytes() if memory is None else memory
    if wanted <= room:
        return False
    left = "are free" if memory is None else "are allowed"
    need = f"{size[0]} × {size[1]} cells need {_size(wanted)} in memory, {_size(room)} {left}"
    if whole:
        from nnpp_edge.runtime.errors import InvalidQueryError

        raise InvalidQueryError(
            f"{need}: a vehicle or a directed step cost is planned for in memory alone, so cut out a part of the map"
        )
    warnings.warn(f"{need}: read by windows", stacklevel=2)
    return True


def plan_by_windows(
    request: Request,
    dem: Path,
    terrain: TerrainOptions,
    limits: Traversability,
    vehicle: VehicleOptions,
    *,
    hillshade: bool,
    drawn: bool,
) -> Planned:
    """Plan on a map of which only the coarse levels and what lies under a corridor are in memory."""
    from nnpp_edge.runtime.planners.windowed import WindowedPlanner
    from nnpp_edge.terrain.route import Route

    _check(request, hillshade)
    with terrain.open(dem) as ground:
        warn_if_not_square(ground)
        start, via, goals = ends = request.ends(ground)
        refuse_outside(request.method, ends, ground)
        progress = _Bars(ground.shape[0])
        planner = WindowedPlanner(
            ground,
            limits,
            omega=request.omega,
            corner_cutting=request.corner_cutting,
            mobility=vehicle.mobility(ground),
            progress=progress,
        )
        if not planner.any_passable:
            refuse_impassable(ground)
        given = {"epsilon": request.epsilon, "time_limit_s": request.time_limit}
        within = {name: number for name, number in given.items() if number is not None}
        tour = planner.plan_via(start, goals[0], via, best_order=request.best_order, **within) if via else None
        ranked = [(goals[0], tour.plan)] if tour else _nearest(planner, start, goals, within)
        goal, plan = ranked[0]
        _, costs = planner.costs.along(plan.path)
        assert plan.along is not None
        answer = Answer(
            plan,
            Route(plan.path, plan.along, costs, ground),
            start,
            goal,
            ranked if len(goals) > 1 else [],
            compared=[],
            exact_path=None,
            loading_included=True,
            windows=_read(planner, ground),
            tour=tour,
            hard_slope_deg=limits.hard_slope_deg,
        )
        factor, costs = planner.coarse_costs(_MOST_PIXELS)
        return Planned(answer, costs, None, factor, _around(planner, goal if "GOAL" in plan.status else start))


class _Bars:
    """A progress bar for each time that the map's rows are read."""

    def __init__(self, rows: int) -> None:
        self._rows, self._open, self._what = rows, ExitStack(), ""

    def __call__(self, what: str, done: int) -> None:
        """Show how far this reading has come."""
        from nnpp_edge.progress import bar

        if what != self._what:
            self._open.close()
            self._advance, self._what = self._open.enter_context(bar(what, self._rows)), what
        self._advance(done)
        if done == self._rows:
            self._open.close()
            self._what = ""


def _check(request: Request, hillshade: bool) -> None:
    """InvalidQueryError for what needs the whole map."""
    from nnpp_edge.runtime.errors import InvalidQueryError

    given = (
        (f"--method {request.method}", request.method in ("astar", "nnpp")),
        ("--compare", request.compare),
        ("--landmarks", request.landmarks > 0),
        ("--hillshade", hillshade),
    )
    if wrong := [name for name, asked in given if asked]:
        raise InvalidQueryError(
            f"{', '.join(wrong)} needs the whole map in memory: leave it out for the corridor method, which reads by "
            "windows, or cut out a part of the map"
        )


def _nearest(
    planner: WindowedPlanner, start: Cell, goals: list[Cell], within: dict[str, float]
) -> list[tuple[Cell, Plan]]:
    """A plan to each goal, the one that costs least first."""
    plans = [(goal, planner.plan(start, goal, **within)) for goal in goals]
    return sorted(plans, key=lambda found: (not found[1].ok, found[1].cost))


def _read(planner: WindowedPlanner, ground: DemWindows) -> WindowsRead:
    from nnpp_edge.runtime.memory import peak_bytes

    reading = planner.reading()
    gigabytes = 1e-9 * reading.cells_read * ground.raster.dtype.itemsize
    return WindowsRead(gigabytes, reading.read_again, 1e-3 * reading.map_ms, 1e-9 * peak_bytes())


def _around(planner: WindowedPlanner, cell: Cell) -> Near:
    """Heights and costs around a cell of the map, or at its border where the cell lies outside."""
    (row0, row1), (col0, col1) = (
        (min(max(at - _AROUND, 0), side - 1), max(min(at + _AROUND + 1, side), 1))
        for at, side in zip(cell, planner.shape, strict=True)
    )
    part = (row0, col0, max(row1 - row0, 1), max(col1 - col0, 1))
    _, elevation, cost = next(planner.costs.windows([part]))
    return Near((row0, col0), elevation, cost)


def _size(count: float) -> str:
    """Bytes for people."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"
