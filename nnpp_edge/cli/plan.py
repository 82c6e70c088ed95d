"""`nnpp-edge plan`: a path over an elevation map."""

import json
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.costmap import cost_of, make_rules, size_text, workload_option

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.region import Region
    from nnpp_edge.runtime.planners.plan import Plan
    from nnpp_edge.terrain.dem import Dem
    from nnpp_edge.terrain.route import Route

Cell = tuple[int, int]

_NOT_SQUARE = 0.02
_REPEATS = 3


@click.command(name="plan")
@click.argument("dem", type=options.PATH)
@click.option("--start", type=options.Cell(), help="Cell, row first, counted from 0.")
@click.option("--goal", type=options.Cell(), multiple=True,
              help="Likewise. Given several times, the path leads to the one that costs least to reach.")  # fmt: skip
@click.option("--start-xy", type=options.Numbers(float), metavar="X,Y", help="In the map's own coordinates.")
@click.option("--goal-xy", type=options.Numbers(float), metavar="X,Y", multiple=True, help="Likewise.")
@click.option("--method", type=click.Choice(["auto", "astar", "corridor", "nnpp"]), default="auto", show_default=True)
@click.option("--model", default="edge", show_default=True, help="Shipped network's name, or an ONNX file.")
@options.dem_input
@options.traversability
@workload_option
@click.option("--omega", type=float, default=0.011, show_default=True,
              help="Weight of the cost against length, per grey level.")  # fmt: skip
@click.option("--corner-cutting/--no-corner-cutting", default=True, show_default=True,
              help="Whether a diagonal step may pass beside an impassable cell.")  # fmt: skip
@click.option("--epsilon", type=click.FloatRange(min=0.0),
              help="Widen until the cost is certain to be within this share of the optimum; 0 is exact.")  # fmt: skip
@click.option("--time-limit", type=click.FloatRange(min=0.0, min_open=True), help="Seconds for one planning.")
@click.option("--landmarks", type=click.IntRange(0, 8), default=0,
              help="Landmarks to prepare first: exact A* then expands a fraction of the cells.")  # fmt: skip
@click.option("--compare", is_flag=True, help="Plan with exact A* and the corridor planner too.")
@click.option("--hillshade", is_flag=True, help="Draw the relief in place of the cost.")
@click.option("-o", "--output", type=options.PATH,
              help="Folder for path.geojson, path.csv, plan.png and plan.json.")  # fmt: skip
@options.as_json
def command(
    dem: Path, start: Cell | None, goal: tuple[Cell, ...], start_xy: tuple[float, ...] | None,
    goal_xy: tuple[tuple[float, ...], ...], method: str, model: str, cell_size: float | None,
    vertical_scale: float | None, rescale: float | None, workload: str | None, omega: float,
    corner_cutting: bool, epsilon: float | None, time_limit: float | None, landmarks: int, compare: bool,
    hillshade: bool, output: Path | None, as_json: bool, **limits: Any,
) -> None:  # fmt: skip
    """Plan a path over the elevation map DEM.

    Give start and goal as cells, or with --start-xy and --goal-xy in the map's coordinates; with several
    goals all are planned to, and the one that costs least to reach is taken. Times are those
    of a second planning: the first loads compiled code and the network. Exit codes: 0 for a path, 1 for
    NO_PATH or TIMEOUT, 2 where start or goal lies outside the map or is impassable.

    path.geojson is in the map's own coordinates, not in longitude and latitude; its properties say which.
    Without a georeference they are x = column and y = row, times the side of a cell, in metres.

    \b
    nnpp-edge plan dem.tif --start 20,30 --goal 380,360 --workload limit20 -o plan
    """
    _check_ends("start", [start] if start else [], [start_xy] if start_xy else [])
    _check_ends("goal", goal, goal_xy)
    rules = make_rules(workload, limits)

    from functools import partial
    from math import inf

    from nnpp_edge.files import make_folder
    from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
    from nnpp_edge.runtime.planners.planner import Planner
    from nnpp_edge.terrain.route import Route

    if output is not None:
        make_folder(output)
    terrain = options.load_dem(dem, cell_size, vertical_scale, rescale)
    _warn_if_not_square(terrain)
    cost = cost_of(terrain, rules)
    if not (cost < 1.0).any():
        if as_json:
            click.echo(json.dumps({"status": "INVALID_MAP"}))
        raise InvalidMapError(f"{dem}: wanted a map to plan on, got {size_text(_size(terrain))}, all impassable")
    begin = start or terrain.cell_of(*start_xy)  # type: ignore[misc]  # one of them was given
    goals = [*goal, *(terrain.cell_of(*place) for place in goal_xy)]
    planner = Planner(cost, omega=omega, corner_cutting=corner_cutting, model=model)
    if landmarks:
        planner.prepare(landmarks=landmarks)
    settings: dict[str, Any] = {"epsilon": inf if epsilon is None else epsilon, "time_limit_s": time_limit or inf}
    ranked = planner.nearest(begin, goals, count=len(goals), method=method, **settings)
    end = goals[ranked[0][0]]
    ask = partial(planner.plan, begin, end, **settings)
    plan = ask(method=method)
    if plan.source is None:  # no search was made
        if as_json:
            click.echo(json.dumps(plan.summary()))
        raise InvalidQueryError(_refusal(plan.status, begin, end, cost, terrain, rules))
    plan = _kept(plan)
    route = Route.of(plan.path, cost, terrain)
    rows, exact = _compare(ask, plan) if compare else ([], None)
    told = {
        **plan.summary(), "length_m": route.length_m if plan.ok else None, "start": begin, "goal": end,
        **_size(terrain), **({"compare": rows} if rows else {}),
    }  # fmt: skip
    if len(goals) > 1:
        told["goals"] = [_reached(goals[at], found) for at, found in ranked]
    if output is not None:
        _write(output, plan, route, cost, exact, hillshade, told)
    click.echo(json.dumps(told) if as_json else text(plan, route, told))
    if not plan.ok:
        click.get_current_context().exit(1)


def text(plan: "Plan", route: "Route", told: dict[str, Any]) -> str:
    """The result for people."""
    from nnpp_edge.viz.sheet import metres

    source = f"{plan.method} ({plan.source})"
    lines = {str(plan.status): f"{source}: {plan.reason}" if plan.reason else source, "map": size_text(told)}
    if "goals" in told:
        shown = (f"{row['goal']} {row['status' if row['cost'] is None else 'cost']}" for row in told["goals"])
        lines["goals"] = ", ".join(shown)
    if plan.ok:
        lines["path"] = f"{len(plan.path)} cells, {metres(route.length_m)}"
        lines["cost"] = f"{plan.cost:.6g}, {_promise(plan, told)}"
        lines["CC"] = f"{plan.traverse_cost:.6g}"
    elif len(plan.path):
        lines["path"] = f"{len(plan.path)} cells so far, {metres(route.length_m)}"
    lines["expansions"] = str(plan.expansions)
    stages = ", ".join(f"{name} {ms:.2f}" for name, ms in plan.timings_ms.items() if name != "total")
    lines["time"] = f"{plan.timings_ms['total']:.2f} ms ({stages})"
    if "files" in told:
        lines["written"] = ", ".join(told["files"])
    body = "\n".join(f"{name:<12}{value}" for name, value in lines.items())
    return body + ("\n" + _table(told["compare"]) if "compare" in told else "")


def _promise(plan: "Plan", told: dict[str, Any]) -> str:
    """How far from the optimum the path's cost is, or may be."""
    if plan.bound <= 1.0 + 1e-6:
        return "the optimum"
    gap = told["compare"][0]["gap"] if "compare" in told else None
    if gap is not None:
        return f"{100.0 * gap:.2f} % above the optimum"
    return f"at most {plan.bound:.3f} times the optimum (no path costs less than {plan.lower_bound:.6g})"


def _table(rows: list[dict[str, Any]]) -> str:
    """The comparison for people."""
    from nnpp_edge.progress import render_table

    def shown(value: Any, form: str) -> str:
        return "–" if value is None else form.format(value)

    body = [
        [
            row["method"], row["source"], row["status"], shown(row["cost"], "{:.6g}"),
            shown(None if row["gap"] is None else 100.0 * row["gap"], "{:.2f} %"), f"{row['time_ms']:.2f}",
            shown(row["speedup"], "{:.2f}"), str(row["expansions"]),
        ]
        for row in rows
    ]  # fmt: skip
    return render_table(("method", "source", "status", "cost", "gap", "ms", "speed-up", "expansions"), body)


def _compare(ask: Callable[..., "Plan"], plan: "Plan") -> "tuple[list[dict[str, Any]], Plan]":
    """The plan's method, exact A* and the corridor planner in turns, median times; and the exact plan."""
    from statistics import median

    from nnpp_edge.runtime.planners.plan import Method

    methods = list(dict.fromkeys((plan.method, Method.ASTAR, Method.CORRIDOR)))
    rounds = [{method: ask(method=method) for method in methods} for _ in range(1 + _REPEATS)][1:]
    times = {method: median(plans[method].timings_ms["total"] for plans in rounds) for method in methods}
    exact = rounds[-1][Method.ASTAR]
    rows = []
    for method, found in rounds[-1].items():
        both = found.ok and exact.ok
        gap = (found.cost / exact.cost - 1.0 if exact.cost else 0.0) if both else None
        row = {key: found.summary()[key] for key in ("method", "source", "status", "cost", "length", "expansions")}
        speedup = times[Method.ASTAR] / times[method] if both else None
        rows.append({**row, "gap": gap, "time_ms": times[method], "speedup": speedup})
    return rows, exact


def _write(
    folder: Path, plan: "Plan", route: "Route", cost: Any, exact: "Plan | None", shaded: bool, told: dict[str, Any]
) -> None:
    """Path, picture and figures; their names go into `told`."""
    from nnpp_edge.files import write_whole
    from nnpp_edge.viz.picture import hillshade, plan_picture, save_picture

    dem = route.dem
    names = ("path.geojson", "path.csv", "plan.png", "plan.json")
    told["files"] = [str(folder / name) for name in names]
    geojson, csv, png, figures = (folder / name for name in names)
    properties = {key: told[key] for key in ("status", "method", "source", "cost", "length_m")}
    write_whole(geojson, route.geojson(properties))
    write_whole(csv, route.csv())
    picture = plan_picture(
        cost, plan, start=told["start"], goal=told["goal"],
        shade=hillshade(dem.elevation, dem.cell_size_m, dem.cell_width_m) if shaded else None,
        reference_path=exact.path if exact is not None and exact.ok and plan.method != exact.method else None,
        cell_size_m=dem.cell_width_m, length_m=route.length_m,
    )  # fmt: skip
    save_picture(png, picture)
    write_whole(figures, json.dumps(told, indent=1).encode())


def _kept(plan: "Plan") -> "Plan":
    """The plan with regions of its own, which outlive the planner's next query."""
    from dataclasses import replace

    def kept(region: "Region | None") -> "Region | None":
        return None if region is None else region._replace(bitmap=region.bitmap.copy())

    return replace(plan, region=kept(plan.region), network_region=kept(plan.network_region))


def _size(terrain: "Dem") -> dict[str, Any]:
    rows, cols = terrain.elevation.shape
    return {"rows": rows, "cols": cols, "cell_size_m": terrain.cell_size_m, "cell_width_m": terrain.cell_width_m}


def _check_ends(name: str, cells: Sequence[Cell], places: Sequence[tuple[float, ...]]) -> None:
    """Start or goals, in one way."""
    if bool(cells) == bool(places):
        raise click.UsageError(f"give either --{name} ROW,COL or --{name}-xy X,Y")
    for place in places:
        if len(place) != 2:
            raise click.UsageError(f"--{name}-xy must be two numbers X,Y, got {len(place)}")


def _reached(goal: Cell, plan: "Plan") -> dict[str, Any]:
    return {"goal": goal, **{key: plan.summary()[key] for key in ("status", "cost")}}


def _warn_if_not_square(terrain: "Dem") -> None:
    size, width = terrain.cell_size_m, terrain.cell_width_m
    if abs(size - width) > _NOT_SQUARE * size:
        warnings.warn(
            f"cells are {size:.4g} m from north to south and {width:.4g} m from east to west, and the search takes "
            "them as square; slopes and the path's length in metres do not",
            stacklevel=2,
        )


def _refusal(status: str, start: Cell, goal: Cell, cost: Any, terrain: "Dem", rules: Any) -> str:
    """Why no search was made, and for a blocked cell which is the nearest passable one."""
    import numpy as np

    name, _, problem = status.partition("_")
    cell = start if name == "START" else goal
    what = f"{name.lower()} {cell}"
    if problem != "BLOCKED":
        return f"{what} lies outside the map of {cost.shape[0]} × {cost.shape[1]} cells"
    free = np.argwhere(cost < 1.0)
    nearest = tuple(free[((free - cell) ** 2).sum(axis=1).argmin()].tolist())
    return f"{what} is impassable: {_why_blocked(cell, terrain, rules)}; the nearest passable cell is {nearest}"


def _why_blocked(cell: Cell, terrain: "Dem", rules: Any) -> str:
    """What makes an impassable cell so."""
    import numpy as np

    from nnpp_edge.runtime.terrain.traversability import terrain_terms

    row0, col0 = max(cell[0] - 1, 0), max(cell[1] - 1, 0)
    patch = terrain.elevation[row0 : cell[0] + 2, col0 : cell[1] + 2]
    terms = terrain_terms(patch, terrain.cell_size_m, cell_width_m=terrain.cell_width_m)
    slope, roughness, step = terms[:, cell[0] - row0, cell[1] - col0].tolist()
    if np.isnan(slope):
        return "its elevation is unknown"
    found = (
        ("slope", np.degrees(slope), rules.hard_slope_deg, "°"),
        ("roughness", roughness, rules.hard_roughness_m, " m"),
        ("elevation difference", step, rules.hard_step_m, " m"),
    )
    for term, value, limit, unit in found:
        if value > limit:
            return f"{term} {value:.3g}{unit}, the hard limit is {limit:g}{unit}"
    return "slope, roughness and elevation difference are all at their limits"
