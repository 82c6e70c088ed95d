"""Planning for `nnpp-edge plan`, on maps in memory and on larger ones, which lie in files."""

import math
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.cli.ground_options import GroundOptions
from nnpp_edge.cli.maps import (
    chart_of,
    filed,
    refuse,
    refuse_map,
    refuse_outside,
    warn_if_not_square,
)
from nnpp_edge.cli.plan_answer import Answer
from nnpp_edge.cli.requests import PlanRequest
from nnpp_edge.cli.text import Row
from nnpp_edge.runtime import Ground, Method, Plan, Planner, Vehicle, exercises
from nnpp_edge.runtime.cells import Cell, holding, nearest, widened
from nnpp_edge.runtime.compiled.notice import told_if_slow
from nnpp_edge.runtime.errors import InvalidQueryError, TerrainError
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.runtime.network import loading
from nnpp_edge.runtime.options import PlanOptions, StepOptions
from nnpp_edge.runtime.planners.query import problem_with
from nnpp_edge.runtime.tuning import LARGE_MAP
from nnpp_edge.terrain.dem import Dem, open_dem, part_of
from nnpp_edge.terrain.georeference import Place
from nnpp_edge.terrain.rasters import Raster
from nnpp_edge.terrain.route import Route
from nnpp_edge.viz.picture import Reached, body_outlines, plan_picture, refused_on
from nnpp_edge.viz.relief import Chart

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_REPEATS = 3
"""Plans by each method that --compare takes the median time of."""
_COMPARED = ("method", "source", "status", "cost", "length", "expansions")


def _ends(request: PlanRequest, place: Place) -> "Ends":
    """Cells of the map that a path is to lead from, through and to.

    InvalidQueryError for what lies outside the map.
    """
    start = request.start(place)
    goal = request.goal(place)
    via = [end(place) for end in request.via]
    refuse_outside(start, goal, place)
    return start, via, goal


Ends = tuple[Cell, list[Cell], Cell]


def _read(request: PlanRequest, path: Path, robot: GroundOptions, large: bool) -> tuple[Dem, Ends]:
    """The map, or of it what lies around the ends, and these on it."""
    if request.crop is None and not large:
        dem = robot.read(path)
        return dem, _ends(request, dem)
    with ExitStack() as stack:
        whole: Dem | Raster
        try:
            whole = stack.enter_context(open_dem(path, robot.cell_size))
        except TerrainError:  # of a format that is read as a whole
            if large:
                raise
            whole = robot.read(path)
        start, via, goal = ends = _ends(request, whole)
        if large and isinstance(whole, Raster):
            return filed(whole), ends
        around = holding(np.clip([start, *via, goal], 0, np.subtract(whole.shape, 1)))
        sides = (whole.cell_size_m, whole.cell_width_m)
        crop = request.crop or 0.0
        up, left = (math.ceil(min(crop / side, 1e9)) for side in sides)
        row, col, rows, cols = part = widened(around, (up, left), whole.shape)
        dem = part_of(whole, part)
    warnings.warn(
        f"cut out {rows} × {cols} cells: cell (row, col) of the file is now (row - {row}, "
        f"col - {col}); xy:X,Y is the same place on both maps",
        stacklevel=2,
    )

    def moved(cell: Cell) -> Cell:
        return cell[0] - row, cell[1] - col

    return dem, (moved(start), [*map(moved, via)], moved(goal))


def plan_on(
    request: PlanRequest,
    query: PlanOptions,
    steps: StepOptions,
    path: Path,
    robot: GroundOptions,
    *,
    model: str,
    drawn: bool,
    large: bool,
) -> Answer:
    """Plan on a map. The heights and costs of a `large` one lie in temporary files, and only the
    corridor method plans on it.
    """
    method = query.pop("method", Method.AUTO)
    if large:
        _check_large(request, query, robot, method)
        method = Method.CORRIDOR
    hint = "" if request.crop else " (--crop METRES reads only the map around the ends)"
    with told_if_slow(f"reading {path}{hint}"):
        dem, (start, via, goal) = _read(request, path, robot, large)
    may_ask = method == "nnpp" or (method == "auto" and max(dem.shape) >= LARGE_MAP)
    if may_ask and robot.posed is None:
        loading.begin_loading(model)
    warn_if_not_square(dem)
    with told_if_slow("costs of the map"):
        ground = robot.of(dem)
        cost = None if large else ground.costs(warn=True)
        if cost is not None and not (cost < 1.0).any():
            refuse_map(dem)
    planner = Planner(ground if cost is None else ground.priced(cost), model=model, **steps)
    grid = planner.state.grid
    if problem := problem_with(grid, start, goal):
        refuse(problem, start, goal, dem, planner, ground)
    if "time_limit_s" in query:  # loading would use it up
        exercises.exercise()
    wanted: PlanOptions = {**query, "method": method, "keep_regions": drawn and not large}
    with told_if_slow("planning"):
        tour = None
        if via:
            tour = planner.plan_via(start, goal, via, best_order=request.best_order, **wanted)
        plan = tour.plan if tour else planner.plan(start, goal, **wanted)
    if plan.source is None:  # no search was made
        refuse(plan.status, start, goal, dem, planner, ground)
    compared = list[Row]()
    exact = None
    if request.compare:

        def by(method: Method) -> Plan:
            asked: PlanOptions = {**query, "method": method}
            if tour:
                return planner.plan_via(start, goal, tour.stops[1:-1], **asked).plan
            return planner.plan(start, goal, **asked)

        with told_if_slow("comparing methods"):
            plan, compared, exact = _compare(by, plan)
    with told_if_slow("measuring the path"):
        plan = _on_the_ground(plan, ground)
        costs = grid.inner(grid.weights) if cost is None else cost
        route = Route.of_plan(plan, costs, dem, grid.robot.moves.poses)
        if cost is None:
            route = replace(route, cost=route.cost / np.float32(grid.model.scale or 1.0))
    stops = tour.stops if tour else (start, goal)
    ended = None
    searched = not (tour or large or "refine" in query)
    if plan.status == "NO_PATH" and searched:
        cells, from_start = planner.came_to(start)
        begun, other = ("start", goal) if from_start else ("goal", start)
        ended = Reached(cells, begun, nearest(cells, other))

    def picture() -> "Figure":
        if cost is None:
            return _coarse_picture(dem, planner, plan, stops)
        body = ground.vehicle
        beside = None
        if body is not None and request.compare and robot.step_cost == "paper":
            other = Ground(cost) if plan.states is None else replace(ground, vehicle=_spot(body))
            beside = Planner(other, **steps).plan(start, goal, method="astar").path
        headings = None if plan.drive is None else plan.drive.poses[:, 2]
        reference = None
        if exact and exact.ok and plan.method != exact.method:
            reference = exact.path if exact.states is None else exact.line
        return plan_picture(
            chart_of(dem, cost),
            plan,
            start=start,
            goal=goal,
            via=stops[1:-1],
            reference_path=reference,
            outlines=body_outlines(plan.line, body, ground.sides_m, headings),
            refused=refused_on(planner),
            point_path=beside,
            reached=ended,
        )

    return Answer(
        plan,
        route,
        picture,
        stops,
        compared=compared,
        loading_included=not request.compare and "time_limit_s" not in query,
        vehicle=ground.vehicle,
        step_cost=robot.step_cost,
        tour=tour and tour.told(lambda leg: _on_the_ground(leg, ground)),
        ended=ended,
        hard_slope_deg=ground.limits.hard_slope_deg,
    )


def _check_large(
    request: PlanRequest, query: PlanOptions, robot: GroundOptions, method: str
) -> None:
    """InvalidQueryError for what is not made on a map that does not fit into memory."""
    unfit = {
        f"--method {method}": method in ("astar", "nnpp"),
        "--compare": request.compare,
        "--refine": "refine" in query,
        "--start-heading, --goal-heading": any(name.endswith("_deg") for name in query),
    }
    if wrong := [name for name, asked in unfit.items() if asked]:
        raise InvalidQueryError(
            f"{', '.join(wrong)} needs the whole map in memory: leave it out for the corridor "
            "method, which reads by windows, or cut out a part of the map"
        )


def _spot(body: Vehicle) -> Vehicle:
    """The same body, which turns on the spot."""
    return replace(
        body, turning_radius_m=None, reverse_cost=None, gear_change_m=0.0, turns_on_spot=None
    )


def _coarse_picture(dem: Dem, planner: Planner, plan: Plan, stops: Sequence[Cell]) -> "Figure":
    """The path on the coarsest level of the map."""
    levels = planner.state.pyramid.levels
    factor = FACTOR ** (len(levels) - 1)
    coarse = levels[-1].grid
    cost = np.asarray(coarse.map() / np.float32(coarse.model.scale or 1.0))
    start, *via, goal = [(row // factor, col // factor) for row, col in stops]
    sides_m = (dem.cell_size_m * factor, dem.cell_width_m * factor)
    chart = Chart(cost, None, sides_m, dem.north_deg)
    return plan_picture(chart, replace(plan, path=plan.path // factor), start, goal, via=via)


def _on_the_ground(plan: Plan, ground: Ground) -> Plan:
    """The plan with the numbers along its way, also where it was made on costs alone."""
    if plan.along is not None:
        return plan
    assert ground.elevation is not None
    along = Along.of(plan.line, ground.elevation, ground.sides_m, ground.mobility)
    return replace(plan, along=along)


def _compare(plan_by: Callable[[Method], Plan], plan: Plan) -> tuple[Plan, list[Row], Plan]:
    """Plan by the plan's method, exact A* and the corridor planner in turns.

    Returns the plan with the times of a repeat, figures of each method with its median time, and
    the exact plan.
    """
    methods = list(dict.fromkeys((plan.method, Method.ASTAR, Method.CORRIDOR)))
    rounds = [{method: plan_by(method) for method in methods} for _ in range(1 + _REPEATS)]
    times = {
        method: median(plans[method].timings_ms["total"] for plans in rounds[1:])
        for method in methods
    }
    last = rounds[-1]
    exact = last[Method.ASTAR]
    rows = list[Row]()
    for method in methods:
        found = last[method]
        row = {name: found.summary()[name] for name in _COMPARED}
        row |= {"gap": None, "time_ms": times[method], "speedup": None}
        if found.ok and exact.ok:
            above = found.cost - exact.cost
            row["gap"] = above / abs(exact.cost) if exact.cost else 0.0  # energy may be got back
            row["speedup"] = times[Method.ASTAR] / times[method]
        rows.append(row)
    return replace(plan, timings_ms=last[plan.method].timings_ms), rows, exact
