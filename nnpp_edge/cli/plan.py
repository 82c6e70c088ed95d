"""`nnpp-edge plan`: a path over an elevation map."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from nnpp_edge.cli import options, vehicle_options
from nnpp_edge.cli.ends import End, Where
from nnpp_edge.cli.maps import cost_of, ground_of, priced, reads_by_windows, warn_if_not_square
from nnpp_edge.cli.options import TerrainOptions
from nnpp_edge.cli.plan_answer import Answer, Compared
from nnpp_edge.cli.plan_files import Outputs, outputs
from nnpp_edge.cli.refusal import Near, refuse, refuse_map, refuse_outside
from nnpp_edge.cli.vehicle_options import VehicleOptions
from nnpp_edge.runtime.compiled.notice import told_if_slow

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.runtime.map.ground import Ground
    from nnpp_edge.runtime.planners.plan import Plan
    from nnpp_edge.runtime.planners.planner import Planner
    from nnpp_edge.runtime.planners.query import PlanOptions
    from nnpp_edge.terrain.dem import Dem
    from nnpp_edge.terrain.georeference import Place
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


class Ends(NamedTuple):
    """Cells of the map that a path is to lead from, through and to."""

    start: Cell
    via: list[Cell]
    goals: list[Cell]


@dataclass(frozen=True)
class Request:
    """What is to be planned, and how: the options' values, as given."""

    start: End
    goals: tuple[End, ...]
    via: tuple[End, ...]
    best_order: bool
    method: str
    model: str
    omega: float
    corner_cutting: bool
    epsilon: float | None
    time_limit: float | None
    landmarks: int
    compare: bool
    step_cost: str
    refine: str | None
    hillshade: bool

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        if self.best_order and not self.via:
            raise click.UsageError("--best-order is of way points: give --via too")
        if self.via and self.compare:
            raise click.UsageError("--compare is of one leg: leave out --via")

    @property
    def limits(self) -> dict[str, float]:
        """How good, and until when, as far as was asked."""
        given = {"epsilon": self.epsilon, "time_limit_s": self.time_limit}
        return {name: number for name, number in given.items() if number is not None}

    def ends(self, place: Place) -> Ends:
        """Start, way points and goals as cells; InvalidQueryError for several starts, or goals with way points."""
        start = self.start.one_cell(place, "--start")
        goals = [cell for end in self.goals for cell in end.cells(place)]
        via = [cell for end in self.via for cell in end.cells(place)]
        if via and len(goals) != 1:
            from nnpp_edge.runtime.errors import InvalidQueryError

            raise InvalidQueryError(f"--goal, with --via, must be one place, got {len(goals)}")
        return Ends(start, via, goals)

    def may_ask_network(self, shape: tuple[int, int], ends: Ends) -> bool:
        """Whether the network will be asked, or `auto` is expected to ask it for one of the goals."""
        from nnpp_edge.runtime.planners.choice import expects_network
        from nnpp_edge.runtime.planners.query import Query

        ways = (Query(ends.start, goal).apart for goal in ends.goals)
        return self.method == "nnpp" or any(expects_network(self.method, shape, self.model, way) for way in ways)


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
@options.corner_cutting
@click.option("--epsilon", type=options.NOT_NEGATIVE, help="Cost at most this share above the optimum; 0 is exact.")
@click.option("--time-limit", type=options.POSITIVE, help="Seconds for one planning.")
@click.option(
    "--landmarks", type=click.IntRange(0, 8), default=0, help="Landmarks to prepare: exact A* expands fewer cells."
)
@click.option("--refine", type=click.Choice(["any-angle"]), help="Free the path from the grid: way points, too.")
@click.option("--compare", is_flag=True, help="Plan with exact A* and the corridor planner too.")
@options.hillshade
@vehicle_options.vehicle
@options.memory
@options.as_json
@outputs
@options.gathered("request", Request)
def command(
    dem: Path,
    outputs: Outputs,
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
    terrain.limits()  # what makes none is refused before any work
    read = [end.file for end in (request.start, *request.via, *request.goals) if end.file is not None]
    options.check_outputs(*outputs.paths, more_inputs=read, make_folders=True)
    directed, moves = request.step_cost != "paper", vehicle.make() is not None
    bytes_per_cell = _BYTES_PER_CELL + _BYTES_PER_POSED_CELL * moves + DIRECTED_BYTES_PER_CELL * directed
    if reads_by_windows(dem, terrain, memory, bytes_per_cell, whole=directed or moves):
        from nnpp_edge.cli.windows import plan_by_windows

        answer = plan_by_windows(request, dem, terrain, vehicle)
    else:
        answer = plan_in_memory(request, dem, terrain, vehicle, drawn=outputs.output is not None)
    answer.warn_if_steep()
    files = outputs.save(answer)
    click.echo(json.dumps(answer.figures(files)) if as_json else answer.text(files))
    if not answer.plan.ok:
        click.get_current_context().exit(1)


def plan_in_memory(
    request: Request, path: Path, terrain: TerrainOptions, vehicle: VehicleOptions, *, drawn: bool
) -> Answer:
    """Plan on a map that is read into memory: to the nearest goal, or by way of other places."""
    from functools import partial
    from math import inf

    import numpy as np

    from nnpp_edge.runtime import Planner
    from nnpp_edge.runtime.network.loading import begin_loading
    from nnpp_edge.runtime.planners.query import problem_with

    body = vehicle.make()
    by_poses = body is not None and not body.is_disc
    with told_if_slow(f"reading {path}"):
        dem = terrain.read(path)
    start, via, goals = ends = request.ends(dem)
    refuse_outside(start, goals, dem)
    if not by_poses and request.may_ask_network(dem.shape, ends):
        begin_loading(request.model)
    warn_if_not_square(dem)
    limits = terrain.limits()
    cost = cost_of(dem, limits)
    if not (cost < 1.0).any():
        refuse_map(dem)
    ground = ground_of(dem, limits, vehicle, request.step_cost)
    planner = Planner(
        priced(ground, cost), omega=request.omega, corner_cutting=request.corner_cutting, model=request.model
    )
    near = Near(dem, dem.elevation, cost, limits, body)
    if len(goals) == 1 and (problem := problem_with(planner.state.grid, start, goals[0])):
        refuse(problem, start, goals[0], near)
    _prepare(planner, request)
    within: PlanOptions = {"refine": request.refine, **request.limits}  # type: ignore[typeddict-item]
    wanted: PlanOptions = {**within, "method": request.method, "keep_regions": drawn}
    tour = planner.plan_via(start, goals[0], via, best_order=request.best_order, **wanted) if via else None
    ranked = [(0, tour.plan)] if tour else planner.nearest(start, goals, count=len(goals), **wanted)
    goal, plan = goals[ranked[0][0]], ranked[0][1]
    if plan.source is None:  # no search was made
        refuse(plan.status, start, goal, near)
    compared: list[Compared] = []
    exact_path = None
    if request.compare:
        plan, compared, exact = _compare(partial(planner.plan, start, goal, **within), plan)
        exact_path = exact.path if exact.ok and plan.method != exact.method else None
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
        point_path=_point_path(request, cost, start, goal) if drawn and body is not None else None,
        step_cost=request.step_cost,
        tour=tour and tour.told(lambda leg: _on_the_ground(leg, ground)),
        reached=int(np.isfinite(planner.reach(start)).sum()) if shut_in else None,
        hard_slope_deg=inf if by_poses else limits.hard_slope_deg,
        shade=options.shade_of(dem) if request.hillshade and drawn else None,
    )


def _prepare(planner: Planner, request: Request) -> None:
    """Set landmarks, and load what would use up a time limit."""
    if request.landmarks:
        with told_if_slow("setting landmarks"):
            planner.prepare(landmarks=request.landmarks)
    if request.time_limit is not None:
        from nnpp_edge.runtime.exercises import exercise

        exercise()


def _on_the_ground(plan: Plan, ground: Ground) -> Plan:
    """The plan with the numbers along its way."""
    from dataclasses import replace

    from nnpp_edge.runtime.map.along import Along

    assert ground.elevation is not None and ground.mobility is not None
    return replace(plan, along=Along.of(plan.line, ground.elevation, ground.sides_m, ground.mobility, plan.along))


def _stands(ground: Ground) -> NDArray[np.bool_] | None:
    """Cells on which a body stands in some heading, for the picture; None for others, and on large maps."""
    import numpy as np

    from nnpp_edge.runtime import pose_costs

    dem, vehicle = ground.elevation, ground.vehicle
    if dem is None or vehicle is None or vehicle.is_disc or dem.size > _MOST_SHOWN:
        return None
    size, width = ground.sides_m
    stands: NDArray[np.bool_] = np.isfinite(pose_costs(dem, size, vehicle, cell_width_m=width).min(0))
    return stands


def _point_path(request: Request, cost: Float2D, start: Cell, goal: Cell) -> Cells | None:
    """A point's optimum, for the picture of a comparison."""
    from nnpp_edge.runtime import Planner

    if not request.compare or request.step_cost != "paper":
        return None
    planner = Planner(cost, omega=request.omega, corner_cutting=request.corner_cutting)
    return planner.plan(start, goal, method="astar").path


def _route(plan: Plan, cost: Float2D, dem: Dem, ground: Ground, planner: Planner) -> Route:
    """The route of a plan over known ground, with how a vehicle stands along it."""
    from dataclasses import replace

    from nnpp_edge.runtime.arrays import headings_along
    from nnpp_edge.runtime.map.attitude import attitudes
    from nnpp_edge.runtime.planners.refine import BodyLines
    from nnpp_edge.terrain.route import Route

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
    from dataclasses import replace
    from statistics import median

    from nnpp_edge.runtime import Method

    methods = list(dict.fromkeys((plan.method, Method.ASTAR, Method.CORRIDOR)))
    rounds = [{method: plan_by(method=method) for method in methods} for _ in range(1 + _REPEATS)]
    times = {method: median(plans[method].timings_ms["total"] for plans in rounds[1:]) for method in methods}
    last, exact = rounds[-1], rounds[-1][Method.ASTAR]
    compared = [Compared(last[method], exact, times[method], times[Method.ASTAR]) for method in methods]
    return replace(plan, timings_ms=last[plan.method].timings_ms), compared, exact
