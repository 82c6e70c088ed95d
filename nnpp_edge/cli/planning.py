"""Planning for `nnpp-edge plan`, on maps in memory and on larger ones."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.cli.ground_options import GroundOptions
from nnpp_edge.cli.maps import Near, cost_of, priced, refuse, refuse_map, refuse_outside, shade_of, warn_if_not_square
from nnpp_edge.cli.plan_answer import Answer, Compared
from nnpp_edge.cli.requests import PlanRequest
from nnpp_edge.progress import bar
from nnpp_edge.runtime import Ground, Method, Planner, exercises, pose_costs
from nnpp_edge.runtime.arrays import Float2D, headings_along
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.compiled.notice import told_if_slow
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.runtime.map.attitude import attitudes
from nnpp_edge.runtime.memory import peak_bytes
from nnpp_edge.runtime.network import loading
from nnpp_edge.runtime.planners.methods import expects_network
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.query import PlanOptions, Query, problem_with
from nnpp_edge.runtime.planners.refine import BodyLines
from nnpp_edge.runtime.planners.windowed import WindowedPlanner
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.dem_windows import DemWindows
from nnpp_edge.terrain.georeference import Place
from nnpp_edge.terrain.route import Route

_REPEATS = 3
"""Plans by each method that --compare takes the median time of."""
_MOST_SHOWN = 1 << 20
"""Cells of a map whose poses are all checked for a picture, a tenth of a second."""
_AROUND = 64
"""Cells around a blocked start or goal in which a passable one is looked for."""
_MOST_PIXELS = 2000
"""Of a picture's longer side: as many as `viz` draws."""


def _ends(request: PlanRequest, place: Place) -> tuple[Cell, list[Cell], list[Cell]]:
    """Cells of the map that a path is to lead from, through and to.

    InvalidQueryError for several starts, goals with way points, and what lies outside the map.
    """
    start = request.start.one_cell(place, "--start")
    goals = [cell for end in request.goals for cell in end.cells(place)]
    via = [cell for end in request.via for cell in end.cells(place)]
    if via and len(goals) != 1:
        raise InvalidQueryError(f"--goal, with --via, must be one place, got {len(goals)}")
    refuse_outside(start, goals, place)
    return start, via, goals


def plan_in_memory(request: PlanRequest, path: Path, robot: GroundOptions, *, drawn: bool) -> Answer:
    """Plan on a map that is read into memory: to the nearest goal, or by way of other places."""
    body = robot.body()
    by_poses = body is not None and not body.is_disc
    with told_if_slow(f"reading {path}"):
        dem = robot.read(path)
    start, via, goals = _ends(request, dem)
    ways = (Query(start, goal).apart for goal in goals)
    expected = request.method == "nnpp" or any(
        expects_network(request.method, dem.shape, request.model, apart) for apart in ways
    )
    if expected and not by_poses:
        loading.begin_loading(request.model)
    warn_if_not_square(dem)
    limits = robot.limits()
    cost = cost_of(dem, limits)
    if not (cost < 1.0).any():
        refuse_map(dem)
    ground = robot.of(dem)
    planner = Planner(
        priced(ground, cost), omega=request.omega, corner_cutting=request.corner_cutting, model=request.model
    )
    near = Near(dem, dem.elevation, cost, limits, body)
    if len(goals) == 1 and (problem := problem_with(planner.state.grid, start, goals[0])):
        refuse(problem, start, goals[0], near)
    if request.time_limit is not None:  # loading would use it up
        exercises.exercise()
    within: PlanOptions = {"refine": request.refine, **_limits(request)}  # type: ignore[typeddict-item]
    wanted: PlanOptions = {**within, "method": request.method, "keep_regions": drawn}
    tour = planner.plan_via(start, goals[0], via, best_order=request.best_order, **wanted) if via else None
    ranked = [(0, tour.plan)] if tour else planner.nearest(start, goals, count=len(goals), **wanted)
    goal, plan = goals[ranked[0][0]], ranked[0][1]
    if plan.source is None:  # no search was made
        refuse(plan.status, start, goal, near)
    compared: list[Compared] = []
    exact_path = point_path = None
    if request.compare:
        plan, compared, exact = _compare(partial(planner.plan, start, goal, **within), plan)
        exact_path = exact.path if exact.ok and plan.method != exact.method else None
        if drawn and body is not None and robot.step_cost == "paper":
            of_point = Planner(cost, omega=request.omega, corner_cutting=request.corner_cutting)
            point_path = of_point.plan(start, goal, method="astar").path
    plan = _on_the_ground(plan, ground)
    shut_in = plan.status == "NO_PATH" and tour is None and request.refine is None
    return Answer(
        plan,
        _route(plan, cost, dem, ground, planner),
        start,
        goal,
        cost,
        goals=[(goals[at], found) for at, found in ranked] if len(goals) > 1 else [],
        compared=compared,
        exact_path=exact_path,
        loading_included=not request.compare and request.time_limit is None,
        vehicle=body,
        stands=_stands(ground) if drawn else None,
        point_path=point_path,
        step_cost=robot.step_cost,
        tour=tour and tour.told(lambda leg: _on_the_ground(leg, ground)),
        reached=int(np.isfinite(planner.reach(start)).sum()) if shut_in else None,
        hard_slope_deg=inf if by_poses else limits.hard_slope_deg,
        shade=shade_of(dem) if request.hillshade and drawn else None,
    )


def plan_by_windows(request: PlanRequest, path: Path, robot: GroundOptions) -> Answer:
    """Plan on a map of which only the coarse levels and what lies under a corridor are in memory."""
    _refuse_unfit(request)
    limits, within = robot.limits(), _limits(request)
    with robot.open(path) as ground:
        warn_if_not_square(ground)
        start, via, goals = _ends(request, ground)
        planner = WindowedPlanner(
            ground,
            limits,
            omega=request.omega,
            corner_cutting=request.corner_cutting,
            mobility=robot.mobility(ground),
            progress=_bars(ground.shape[0]),
        )
        if not planner.any_passable:
            refuse_map(ground)
        tour = planner.plan_via(start, goals[0], via, best_order=request.best_order, **within) if via else None
        plans = [(goals[0], tour.plan)] if tour else [(goal, planner.plan(start, goal, **within)) for goal in goals]
        ranked = sorted(plans, key=lambda found: (not found[1].ok, found[1].cost))
        goal, plan = ranked[0]
        if plan.source is None:  # no search was made
            end = start if "START" in plan.status else goal
            refuse(plan.status, start, goal, _around(planner, ground, limits, end))
        _, costs = planner.costs.along(plan.path)
        assert plan.along is not None
        factor, cost = planner.coarse_costs(_MOST_PIXELS)
        reading = planner.reading()
        return Answer(
            plan,
            Route(plan.path, plan.along, costs, ground),
            start,
            goal,
            cost,
            factor=factor,
            goals=ranked if len(goals) > 1 else [],
            windows={
                "gigabytes": 1e-9 * reading.cells_read * ground.raster.dtype.itemsize,  # as they are stored
                "read_again": reading.read_again,
                "map_s": 1e-3 * reading.map_ms,
                "peak_memory_gb": 1e-9 * peak_bytes(),
            },
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


def _limits(request: PlanRequest) -> dict[str, float]:
    """How good, and until when, as far as was asked."""
    given = {"epsilon": request.epsilon, "time_limit_s": request.time_limit}
    return {name: number for name, number in given.items() if number is not None}


def _on_the_ground(plan: Plan, ground: Ground) -> Plan:
    """The plan with the numbers along its way."""
    assert ground.elevation is not None and ground.mobility is not None
    return replace(plan, along=Along.of(plan.line, ground.elevation, ground.sides_m, ground.mobility, plan.along))


def _stands(ground: Ground) -> NDArray[np.bool_] | None:
    """Cells on which a body stands in some heading, for the picture; None for others, and on large maps."""
    dem, vehicle = ground.elevation, ground.vehicle
    if dem is None or vehicle is None or vehicle.is_disc or dem.size > _MOST_SHOWN:
        return None
    size, width = ground.sides_m
    stands: NDArray[np.bool_] = np.isfinite(pose_costs(dem, size, vehicle, cell_width_m=width).min(0))
    return stands


def _route(plan: Plan, cost: Float2D, dem: Dem, ground: Ground, planner: Planner) -> Route:
    """The route of a plan over known ground, with how a vehicle stands along it."""
    assert plan.along is not None
    route, vehicle = Route.of(plan.line, plan.along, cost, dem), ground.vehicle
    if vehicle is None or len(plan.path) < 2:
        return route
    standing = {"heading_deg": headings_along(plan.along.points)}
    if not vehicle.is_disc and plan.waypoints is None:
        standing |= attitudes(dem.elevation, ground.sides_m, vehicle, plan.path)._asdict()
    elif not vehicle.is_disc:
        standing |= BodyLines(planner.state.grid).attitudes(plan.along.points)._asdict()
    return replace(route, standing=standing)


def _compare(plan_by: Callable[..., Plan], plan: Plan) -> tuple[Plan, list[Compared], Plan]:
    """Plan by the plan's method, exact A* and the corridor planner in turns.

    Returns the plan with the times of a repeat, the comparison, and the exact plan.
    """
    methods = list(dict.fromkeys((plan.method, Method.ASTAR, Method.CORRIDOR)))
    rounds = [{method: plan_by(method=method) for method in methods} for _ in range(1 + _REPEATS)]
    times = {method: median(plans[method].timings_ms["total"] for plans in rounds[1:]) for method in methods}
    last, exact = rounds[-1], rounds[-1][Method.ASTAR]
    compared = [Compared(last[method], exact, times[method], times[Method.ASTAR]) for method in methods]
    return replace(plan, timings_ms=last[plan.method].timings_ms), compared, exact


def _bars(rows: int) -> Callable[[str, int], None]:
    """A progress bar for each time that the map's rows are read."""
    shown, advance = ExitStack(), dict[str, Callable[[int], None]]()

    def show(what: str, done: int) -> None:
        if what not in advance:
            close()
            advance[what] = shown.enter_context(bar(what, rows))
        advance[what](done)
        if done == rows:
            close()

    def close() -> None:
        shown.close()
        advance.clear()

    return show


def _refuse_unfit(request: PlanRequest) -> None:
    """InvalidQueryError for what needs the whole map."""
    given = {
        f"--method {request.method}": request.method in ("astar", "nnpp"),
        "--compare": request.compare,
        "--hillshade": request.hillshade,
        "--refine": request.refine is not None,
    }
    if wrong := [name for name, asked in given.items() if asked]:
        raise InvalidQueryError(
            f"{', '.join(wrong)} needs the whole map in memory: leave it out for the corridor method, which reads by "
            "windows, or cut out a part of the map"
        )
