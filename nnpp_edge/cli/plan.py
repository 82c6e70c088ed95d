"""`nnpp-edge plan`: a path over an elevation map."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options, vehicle_options
from nnpp_edge.cli.costmap import cost_of
from nnpp_edge.cli.ends import Where
from nnpp_edge.cli.options import TerrainOptions
from nnpp_edge.cli.plan_answer import (
    Answer,
    Compared,
    Near,
    Planned,
    refuse_impassable,
    warn_if_not_square,
    warn_if_steep,
)
from nnpp_edge.cli.plan_files import Outputs, outputs
from nnpp_edge.cli.plan_request import Ends, Request
from nnpp_edge.cli.refusal import refusal, refuse_outside
from nnpp_edge.cli.vehicle_options import VehicleOptions
from nnpp_edge.cli.windows import plan_by_windows, reads_by_windows
from nnpp_edge.runtime.compiled.notice import told_if_slow

if TYPE_CHECKING:
    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.runtime.map.slope_cost import Mobility
    from nnpp_edge.runtime.planners.on_map import PlannerOptions
    from nnpp_edge.runtime.planners.plan import Plan
    from nnpp_edge.runtime.planners.planner import Planner
    from nnpp_edge.runtime.planners.query import PlanOptions
    from nnpp_edge.runtime.planners.tour import Tour
    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.runtime.terrain.vehicle import Vehicle
    from nnpp_edge.terrain.dem import Dem
    from nnpp_edge.terrain.route import Route
    from nnpp_edge.viz.sheet import Cells

_REPEATS = 3
"""Plans by each method that --compare takes the median time of."""
_MOST_SHOWN = 1 << 20
"""Cells of a map whose poses are all checked for a picture, a tenth of a second."""
_BYTES_PER_POSED_CELL = 12
"""More for a vehicle: four codes and another height."""
_BYTES_PER_CELL = 24
"""At the peak of planning on a whole map: 19 to 23 measured, the most by `nnpp` (docs/decisions.md)."""


@click.command(name="plan")
@click.argument("dem", type=options.MAP)
@click.option(
    "--start", type=Where(), required=True, help="ROW,COL from 0, xy:X,Y, lonlat:LON,LAT, or a vector file's point."
)
@click.option(
    "--goal", "goals", type=Where(), multiple=True, required=True, help="Likewise; of several, the nearest is taken."
)
@click.option("--via", type=Where(), multiple=True, help="Go by way of this place, or of a vector file's points.")
@click.option("--best-order", is_flag=True, help="Visit the places of --via, 12 at most, in the cheapest order.")
@click.option("--method", type=click.Choice(["auto", "astar", "corridor", "nnpp"]), default="auto")
@options.model
@options.terrain
@options.step_cost
@options.omega
@click.option(
    "--corner-cutting/--no-corner-cutting", default=True, help="Allow diagonal steps beside impassable cells."
)
@click.option(
    "--epsilon",
    type=options.NOT_NEGATIVE,
    help="Cost at most this share above the optimum; 0 is exact.",
)
@click.option("--time-limit", type=options.POSITIVE, help="Seconds for one planning.")
@click.option(
    "--landmarks", type=click.IntRange(0, 8), default=0, help="Landmarks to prepare: exact A* expands fewer cells."
)
@click.option("--refine", type=click.Choice(["any-angle"]), help="Free the path from the grid: way points, too.")
@click.option("--compare", is_flag=True, help="Plan with exact A* and the corridor planner too.")
@click.option("--hillshade", is_flag=True, help="Draw the relief in place of the cost.")
@vehicle_options.vehicle
@options.memory
@options.as_json
@outputs
@options.gathered("request", Request)
def command(
    dem: Path,
    outputs: Outputs,
    hillshade: bool,
    memory: float | None,
    as_json: bool,
    terrain: TerrainOptions,
    vehicle: VehicleOptions,
    request: Request,
) -> None:
    """Plan a path over the elevation map DEM, a file or sample:NAME (such as moon_highlands or mars_victoria).

    Give start and goal as cells, in the map's coordinates, as longitude and latitude, or as a vector file's points
    (GeoPackage, GeoJSON, GPX, Shapefile, FlatGeobuf; FILE:LAYER of several layers). With several goals a path to each
    is planned, and the one that costs least is taken. The time shown includes loading compiled code and, as its stage
    `load`, waiting for the network, whose file is opened meanwhile; with --compare and --time-limit these are loaded
    first. Exit codes: 0 for a path, 1 for NO_PATH or TIMEOUT, 2 where start or goal lies outside the map or
    is impassable.

    A limit of slope is on the plane through a cell and its eight neighbours, not on a single step from cell to cell:
    a warning tells how many steps of the path are steeper.

    path.geojson is in the map's own coordinates, not in longitude and latitude; its properties say which.
    Without a georeference they are x = column and y = row, times the side of a cell, in metres.

    A raster too large for the memory that is free, or for --memory, is read by windows, and planned on by the
    corridor method alone.

    \b
    nnpp-edge plan dem.tif --start 20,30 --goal 380,360 --workload limit20 -o plan
    """
    from nnpp_edge.runtime.memory import DIRECTED_BYTES_PER_CELL

    vehicle.check_turns(request.refine)
    limits, body = terrain.limits(), vehicle.make()
    options.check_outputs(*outputs.paths, more_inputs=request.files, make_folders=True)
    directed = request.step_cost != "paper"
    bytes_per_cell = _BYTES_PER_CELL + (_BYTES_PER_POSED_CELL if body else 0) + DIRECTED_BYTES_PER_CELL * directed
    drawn = outputs.output is not None
    if reads_by_windows(dem, terrain, memory, bytes_per_cell, whole=directed or body is not None):
        planned = plan_by_windows(request, dem, terrain, limits, vehicle, hillshade=hillshade, drawn=drawn)
    else:
        planned = plan_whole(request, dem, terrain, limits, body, vehicle, hillshade=hillshade, drawn=drawn)
    answer = planned.answer
    if answer.plan.source is None:  # no search was made
        from nnpp_edge.runtime.errors import InvalidQueryError

        if as_json:
            click.echo(json.dumps(answer.plan.summary()))
        plan, near = answer.plan, planned.near
        cell = answer.start if plan.status.startswith("START") else answer.goal
        raise InvalidQueryError(refusal(plan.status, cell, answer.route.dem, near, limits, answer.vehicle))
    warn_if_steep(answer)
    files = outputs.save(planned)
    click.echo(json.dumps(answer.figures(files)) if as_json else answer.text(files))
    if not answer.plan.ok:
        click.get_current_context().exit(1)


def plan_whole(
    request: Request,
    dem: Path,
    terrain: TerrainOptions,
    limits: Traversability,
    vehicle: Vehicle | None,
    given: VehicleOptions,
    *,
    hillshade: bool,
    drawn: bool,
) -> Planned:
    """Plan on a map that is read into memory."""
    from nnpp_edge.runtime.network.loading import begin_loading

    by_poses = has_body(vehicle)  # whose network is another, and soon loaded
    with told_if_slow(f"reading {dem}"):
        ground = terrain.read(dem)
    ends = request.ends(ground)
    refuse_outside(request.method, ends, ground)
    if not by_poses and (request.method == "nnpp" or request.expects_network(ground, ends)):
        begin_loading(request.model)
    warn_if_not_square(ground)
    cost = cost_of(ground, limits)
    if not (cost < 1.0).any():
        refuse_impassable(ground)
    mobility, shade = given.mobility(ground), None
    answer = find(request, ends, ground, cost, limits, vehicle, mobility, keep_regions=drawn)
    if drawn and vehicle is not None and answer.plan.source is not None:
        answer = _beside_a_point(answer, request, ground, cost, vehicle)
    if hillshade and drawn:
        from nnpp_edge.viz.picture import hillshade as shaded

        shade = shaded(ground.elevation, ground.cell_size_m, ground.cell_width_m)
    return Planned(answer, cost, shade, 1, Near((0, 0), ground.elevation, cost))


def has_body(vehicle: Vehicle | None) -> bool:
    """Whether poses decide where a path may lead."""
    return vehicle is not None and not vehicle.is_disc


def find(
    request: Request,
    ends: Ends,
    dem: Dem,
    cost: Float2D,
    limits: Traversability,
    vehicle: Vehicle | None,
    mobility: Mobility,
    *,
    keep_regions: bool,
) -> Answer:
    """Plan to the nearest goal, once, or by way of other places; and by the other methods to compare."""
    from dataclasses import replace
    from functools import partial
    from math import inf

    import numpy as np

    from nnpp_edge.runtime import Ground, Planner
    from nnpp_edge.runtime.map.along import Along
    from nnpp_edge.runtime.planners.query import problem_with

    start, via, goals = ends
    given: PlannerOptions = {
        "omega": request.omega,
        "corner_cutting": request.corner_cutting,
        "model": request.model,
    }
    sides = dem.cell_size_m, dem.cell_width_m
    if vehicle is None and request.step_cost == "paper":
        planner = Planner(cost, **given)
    else:
        ground = Ground.of_elevation(
            dem.elevation,
            sides[0],
            limits,
            cell_width_m=sides[1],
            vehicle=vehicle,
            step_cost=request.step_cost,
            mobility=mobility,
        )
        planner = Planner(ground, **given)
    may_begin = len(goals) > 1 or problem_with(planner.state.grid, start, goals[0]) is None
    if request.landmarks and may_begin:
        with told_if_slow("setting landmarks"):
            planner.prepare(landmarks=request.landmarks)
    if request.time_limit is not None and may_begin:  # loading would use it up
        from nnpp_edge.runtime.exercises import exercise

        exercise()
    within: PlanOptions = {
        "refine": request.refine,
        "epsilon": inf if request.epsilon is None else request.epsilon,
        "time_limit_s": request.time_limit or inf,
    }
    wanted: PlanOptions = {**within, "method": request.method, "keep_regions": keep_regions}
    tour: Tour | None = None
    if via:
        tour = planner.plan_via(start, goals[0], via, best_order=request.best_order, **wanted)
    ranked = [(0, tour.plan)] if tour else planner.nearest(start, goals, count=len(goals), **wanted)
    goal, plan = goals[ranked[0][0]], ranked[0][1]
    compared: list[Compared] = []
    exact_path = None
    if request.compare and plan.source is not None:
        plan_by = partial(planner.plan, start, goal, **within)
        plan, compared, exact_path = _compare(plan_by, plan)

    def on_the_ground(found: Plan) -> Plan:
        return replace(found, along=Along.of(found.line, dem.elevation, sides, mobility, found.along))

    plan, tour = on_the_ground(plan), tour and tour.told(on_the_ground)
    shut_in = plan.status == "NO_PATH" and plan.source is not None and tour is None and request.refine is None
    return Answer(
        plan,
        _route(plan, cost, dem, vehicle, planner),
        start,
        goal,
        [(goals[at], found) for at, found in ranked] if len(goals) > 1 else [],
        compared,
        exact_path,
        loading_included=not request.compare and request.time_limit is None,
        vehicle=vehicle,
        step_cost=request.step_cost,
        tour=tour,
        reached=int(np.isfinite(planner.reach(start)).sum()) if shut_in else None,
        hard_slope_deg=inf if has_body(vehicle) else limits.hard_slope_deg,
    )


def _beside_a_point(answer: Answer, request: Request, dem: Dem, cost: Float2D, vehicle: Vehicle) -> Answer:
    """With what the picture shows beside a vehicle's path: where it stands, and with --compare a point's optimum."""
    from dataclasses import replace

    import numpy as np

    from nnpp_edge.runtime import Planner, pose_costs

    if dem.elevation.size <= _MOST_SHOWN and not vehicle.is_disc:
        poses = pose_costs(dem.elevation, dem.cell_size_m, vehicle, cell_width_m=dem.cell_width_m)
        answer = replace(answer, stands=np.isfinite(poses.min(0)))
    if request.compare and request.step_cost == "paper":
        planner = Planner(cost, omega=request.omega, corner_cutting=request.corner_cutting)
        answer = replace(answer, point_path=planner.plan(answer.start, answer.goal, method="astar").path)
    return answer


def _route(plan: Plan, cost: Float2D, dem: Dem, vehicle: Vehicle | None, planner: Planner) -> Route:
    """The route of a plan over known ground, with how a vehicle stands along it."""
    from dataclasses import replace

    from nnpp_edge.runtime.arrays import headings_along
    from nnpp_edge.runtime.map.attitude import attitudes
    from nnpp_edge.runtime.planners.refine import BodyLines
    from nnpp_edge.terrain.route import Route

    assert plan.along is not None
    route = Route.of(plan.line, plan.along, cost, dem)
    if vehicle is None or len(plan.path) < 2:
        return route
    standing = {"heading_deg": headings_along(plan.along.points)}
    if vehicle.is_disc:
        return replace(route, standing=standing)
    if plan.waypoints is None:
        standing |= attitudes(dem.elevation, plan.along.sides_m, vehicle, plan.path)._asdict()
    else:
        standing |= BodyLines(planner.state.grid).attitudes(plan.along.points)._asdict()
    return replace(route, standing=standing)


def _compare(plan_by: Callable[..., Plan], plan: Plan) -> tuple[Plan, list[Compared], Cells | None]:
    """Plan by the plan's method, exact A* and the corridor planner in turns.

    Returns the plan with the times of a repeat, the comparison, and the exact path if it is another method's.
    """
    from dataclasses import replace
    from statistics import median

    from nnpp_edge.runtime import Method

    methods = list(dict.fromkeys((plan.method, Method.ASTAR, Method.CORRIDOR)))
    rounds = [{method: plan_by(method=method) for method in methods} for _ in range(1 + _REPEATS)]
    times = {method: median(plans[method].timings_ms["total"] for plans in rounds[1:]) for method in methods}
    last = rounds[-1]
    exact = last[Method.ASTAR]
    compared = [Compared(last[method], exact, times[method], times[Method.ASTAR]) for method in methods]
    exact_path = exact.path if exact.ok and plan.method != exact.method else None
    return replace(plan, timings_ms=last[plan.method].timings_ms), compared, exact_path
