"""`nnpp-edge evaluate`: the planners beside each other."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.evaluate_text import BODY_COLUMNS, COLUMNS, FRESH_COLUMNS, label, table
from nnpp_edge.cli.vehicle_options import VehicleOptions
from nnpp_edge.cli.vehicle_options import vehicle as vehicle_options

if TYPE_CHECKING:
    from nnpp_edge.profiling.suites import Case, Size

_WORKLOADS = "soft, limit20, limit15 or any limitN; with a vehicle body, body-rocks10 or any body-rocksN."
_PER_MAP = "Of a vehicle's queries, so many are answered by one planner; rows for each.  [default: 1]"
_ROCKS = "Share of the ground under rocks, 0 to 0.2, where the workload does not say."
_MODEL = "Shipped model or file for nnpp of a point; several are set beside each other."
_REPEATS = "Times each planner answers each query; its median time counts."
_FRESH_MAP = "Also from elevations to the path on a map that has just arrived, lazily and eagerly."
_MARKDOWN = "Print the tables as Markdown."
_MIN_DISTANCE = "Between start and goal, as a share of the map's longer side."


@click.command(name="evaluate")
@options.terrain_files()
@click.argument("more_terrain", nargs=-1, type=options.MAP, metavar="[FILE]...")
@click.option("--dataset", type=options.FOLDER, help="Judge by a data set's maps and queries instead.")
@click.option("--workload", "workloads", type=options.Names(), default="soft", help=_WORKLOADS)
@click.option("--synthetic", is_flag=True, help="Judge by synthetic terrain instead.")
@click.option("--sizes", type=options.Sizes(), default="256", help="Sides of the maps.")
@click.option("--queries", type=options.COUNT, default=300, help="For each row.")
@click.option("--min-distance", type=options.SHARE, default=0.35, help=_MIN_DISTANCE)
@click.option("--methods", type=options.Names(), default="astar,corridor,nnpp")
@click.option("--model", "models", type=options.ModelName(), multiple=True, default=("edge",), help=_MODEL)
@vehicle_options
@options.step_cost
@click.option("--queries-per-map", "per_map", type=options.Counts(), help=_PER_MAP)
@click.option("--rocks", type=options.Real(0.0, 0.2), default=0.0, help=_ROCKS)
@click.option("--repeats", type=options.COUNT, default=3, help=_REPEATS)
@click.option("--fresh-map", is_flag=True, help=_FRESH_MAP)
@click.option("--plot", type=options.NEW_FILE, help="PNG to draw: cost gap against time, every planner.")
@options.seed
@options.as_json
@click.option("--markdown", is_flag=True, help=_MARKDOWN)
def command(
    terrain: tuple[Path, ...],
    more_terrain: tuple[Path, ...],
    dataset: Path | None,
    cell_size: float | None,
    rescale: float | None,
    allow_vrt: bool,
    workloads: tuple[str, ...],
    synthetic: bool,
    sizes: "tuple[Size, ...]",
    queries: int,
    min_distance: float,
    methods: tuple[str, ...],
    models: tuple[str, ...],
    vehicle: VehicleOptions,
    step_cost: str,
    per_map: tuple[int, ...] | None,
    rocks: float,
    repeats: int,
    fresh_map: bool,
    plot: Path | None,
    seed: int,
    as_json: bool,
    markdown: bool,
) -> None:
    """Compare planners on many queries, in one interleaved run.

    Every planner gets the same maps and queries, in turns. Speed-ups and gaps are against exact A* on the
    same query. Times count the whole job, widening and fallback included.

    With --fresh-map each planner is also made anew of the elevations for every query, all of it on the clock, and
    so is the corridor as narrow as the learned region's (corridor-narrow): nnpp without a network.

    With --step-cost all planners go by the slope; the network has been trained for costs without a direction.

    The workloads body and body-rocksN, rocks on N percent of the ground, are those of a vehicle: a planner that has
    checked none of its poses is made for every query, or for --queries-per-map.

    \b
    nnpp-edge evaluate --terrain dem.tif --rescale 20 --workload soft,limit15 --sizes 256,512
    nnpp-edge evaluate --terrain dem.tif --rescale 20 --sizes 256,512,1024,2048 --fresh-map --markdown
    nnpp-edge evaluate --terrain dem.tif --vehicle small-rover --workload body,body-rocks10
    """
    from nnpp_edge.profiling import suites
    from nnpp_edge.profiling.evaluate import EAGER, evaluate
    from nnpp_edge.profiling.rivals import exact_and, narrow_corridor
    from nnpp_edge.progress import bar
    from nnpp_edge.runtime.map.slope_cost import slope_cost_of
    from nnpp_edge.runtime.network.inference import NetworkModel
    from nnpp_edge.runtime.planners.plan import Method
    from nnpp_edge.terrain.dataset import read_recipe

    files = (*terrain, *more_terrain)
    if bool(files) + (dataset is not None) + synthetic != 1:
        raise click.UsageError("give one of --terrain FILE, --dataset DIR and --synthetic")
    if fresh_map and dataset is not None:
        raise click.UsageError(
            "--fresh-map needs elevations, a data set holds cost maps: give --terrain or --synthetic"
        )
    if as_json and markdown:
        raise click.UsageError("give one of --json and --markdown")
    if unknown := set(methods) - set(Method):
        raise click.UsageError(f"--methods must be of {', '.join(Method)}, got {', '.join(sorted(unknown))}")
    body, directed = vehicle.make(), step_cost != "paper"
    if directed and dataset is not None:
        raise click.UsageError("--step-cost needs elevations, a data set holds cost maps: give --terrain")
    if directed:
        slope_cost_of(step_cost, vehicle.mobility())  # refused now
    of_vehicle = {"--vehicle": body, "--queries-per-map": per_map}
    bodies = _body_workloads(workloads, [name for name, value in of_vehicle.items() if value is not None])
    points = [name for name in workloads if name not in bodies]
    if dataset is not None and (bodies or rocks):
        raise click.UsageError("vehicles and rocks need elevations, a data set holds cost maps: give --terrain")
    options.check_outputs(("--plot", plot))
    needed = models if points and {Method.NNPP, Method.AUTO} & set(methods) else ()
    networks = {Path(name).stem: NetworkModel(name) for name in needed}
    control = [narrow_corridor()] if fresh_map else []
    of_point = exact_and(methods, networks) + control
    of_body = exact_and([name for name in methods if name != Method.NNPP], {}) + control
    dems = suites.TerrainFiles(files, rescale, cell_size, allow_vrt).read()
    suites.check_sizes(dems, sizes)
    mobility = vehicle.mobility(*dems[:1]) if directed else None

    def cases(name: str, size: "Size") -> "Iterator[Case]":
        for case in on_maps(name, size):
            ground = case.ground and replace(case.ground, step_cost=step_cost, mobility=mobility)
            yield replace(case, ground=ground)

    def on_maps(name: str, size: "Size") -> "Iterator[Case]":
        if dataset is not None:
            return suites.dataset_cases(dataset, name)
        if synthetic:
            return suites.synthetic_cases(name, size, seed, min_distance, body, rocks)
        return suites.terrain_cases(dems, name, size, seed, min_distance, body, rocks)

    runs = [
        (name, size, count)
        for name, size in product(workloads, (read_recipe(dataset).size,) if dataset else sizes)
        for count in (per_map if per_map and name in bodies else (1,))
    ]
    rows: list[dict[str, str | float | None]] = []
    with bar("evaluate", queries * len(runs)) as advance:
        for at, (name, size, count) in enumerate(runs):

            def of_run(done: int, before: int = at * queries) -> None:
                advance(before + done)

            rivals = of_body if name in bodies else of_point
            figures = evaluate(
                cases(name, size),
                rivals,
                queries,
                repeats=repeats,
                fresh_map=fresh_map,
                queries_per_map=count,
                progress=of_run,
            )
            place = {"workload": name, "size": suites.name_of(size)}
            rows += [{**place, **row} for row in figures.values()]
    standing = [row for row in rows if not str(row["method"]).endswith(EAGER)]
    if plot is not None:
        from nnpp_edge.viz.figures import pareto

        pareto([row | {"method": label(row)} for row in standing], plot)
    if as_json:
        click.echo(json.dumps(rows, indent=1))
        return
    tables = [([row for row in standing if row["workload"] not in bodies], COLUMNS)]
    if fresh_map:
        tables.append(([row for row in rows if row["workload"] not in bodies], FRESH_COLUMNS))
    tables.append(([row for row in rows if row["workload"] in bodies], BODY_COLUMNS))
    click.echo("\n\n".join(table(each, columns, markdown) for each, columns in tables if each))


def _body_workloads(names: Sequence[str], given: Sequence[str]) -> list[str]:
    """The workloads of a vehicle; UsageError where there are some without --vehicle, or an option for none."""
    from nnpp_edge.terrain.workloads import body_rocks, workload

    found = [name for name in names if body_rocks(name) is not None]
    for name in names:
        if name not in found:
            workload(name)  # InvalidQueryError where there is none of that name
    if found and "--vehicle" not in given:
        raise click.UsageError(f"--workload {found[0]} needs a vehicle: give --vehicle")
    if not found and given:
        raise click.UsageError(f"{given[0]} is for the workloads body and body-rocksN")
    return found
