"""`nnpp-edge evaluate`: the planners beside each other."""

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.vehicle_options import VehicleOptions
from nnpp_edge.cli.vehicle_options import vehicle as vehicle_options

if TYPE_CHECKING:
    from nnpp_edge.profiling.suites import Case, Size
    from nnpp_edge.runtime.map.prices import Price

COLUMNS = {
    "workload": "workload",
    "size": "size",
    "method": "method",
    "n": "n",
    "success_raw": "success",
    "success": "after\nfallback",
    "gap_mean": "gap\nmean",
    "gap_p99": "gap\np99",
    "time_ms_median": "ms\nmedian",
    "time_ms_p99": "ms\np99",
    "speedup_median": "speed-up\nmedian",
    "speedup_total": "speed-up\ntotal",
    "expansions_median": "expan-\nsions",
    "region_share_mean": "region",
    "mm_mean": "MM",
    "cc_mean": "CC",
}
FRESH_COLUMNS = {
    "workload": "workload",
    "size": "size",
    "method": "method",
    "n": "n",
    "fresh_ms_median": "elevation →\npath, ms",
    "fresh_ms_p99": "p99",
    "fresh_speedup_median": "times as fast as\nastar-eager",
    "costs_computed_mean": "costs\ncomputed",
    "fresh_gap_mean": "gap\nmean",
    "fresh_gap_p99": "gap\np99",
    "time_ms_median": "standing\nmap, ms",
}
BODY_COLUMNS = {
    "workload": "workload",
    "size": "size",
    "method": "method",
    "price": "price",
    "n": "n",
    "unsolvable": "without\na path",
    "success_raw": "success",
    "success": "after\nfallback",
    "gap_mean": "gap\nmean",
    "gap_p99": "gap\np99",
    "checks_mean": "poses\nchecked",
    "checks_share_mean": "of all",
    "expansions_median": "expan-\nsions",
    "time_ms_median": "ms\nmedian",
    "time_ms_p99": "ms\np99",
    "fresh_ms_median": "elevation →\npath, ms",
    "fresh_ms_p99": "p99",
    "fresh_ms_p99_first": "p99 without\nfallback",
}
_SHARES = {"success_raw", "success", "region_share_mean", "costs_computed_mean", "checks_share_mean"}
_GAPS = {"gap_mean", "gap_p99", "fresh_gap_mean", "fresh_gap_p99"}
_WORKLOADS = "soft, limit20, limit15 or any limitN; with a vehicle body, body-rocks10 or any body-rocksN."
_PRICES = "By which the corridor of a vehicle prices blocks: eq1, body-fit, sampled.  [default: eq1]"
_ROCKS = "Share of the ground under rocks, 0 to 0.2, where the workload does not say."
_MODEL = "Shipped model or file for nnpp; several are set beside each other."
_REPEATS = "Times each planner answers each query; its median time counts."
_FRESH_MAP = "Also from elevations to the path on a map that has just arrived, lazily and eagerly."
_MARKDOWN = "Print the tables as Markdown."
_MIN_DISTANCE = "Between start and goal, as a share of the map's longer side."


@click.command(name="evaluate")
@options.terrain_files()
@click.argument("more_terrain", nargs=-1, type=options.PATH, metavar="[FILE]...")
@click.option("--dataset", type=options.FOLDER, help="Judge by a data set's maps and queries instead.")
@click.option("--workload", "workloads", type=options.Names(), default="soft", help=_WORKLOADS)
@click.option("--synthetic", is_flag=True, help="Judge by synthetic terrain instead.")
@click.option("--sizes", type=options.Sizes(), default="256", help="Sides of the maps.")
@click.option("--queries", type=options.COUNT, default=300, help="For each row.")
@click.option("--min-distance", type=options.SHARE, default=0.35, help=_MIN_DISTANCE)
@click.option("--methods", type=options.Names(), default="astar,corridor,nnpp")
@click.option("--model", "models", type=options.ModelName(), multiple=True, default=("edge",), help=_MODEL)
@vehicle_options
@click.option("--prices", type=options.Names(), help=_PRICES)
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
    prices: tuple[str, ...] | None,
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

    The workloads body and body-rocksN, rocks on N percent of the ground, are those of a vehicle: a planner that has
    checked none of its poses is made for every query.

    \b
    nnpp-edge evaluate --terrain dem.tif --rescale 20 --workload soft,limit15 --sizes 256,512
    nnpp-edge evaluate --terrain dem.tif --rescale 20 --sizes 256,512,1024,2048 --fresh-map --markdown
    nnpp-edge evaluate --terrain dem.tif --vehicle small-rover --workload body,body-rocks10 --prices eq1,body-fit
    """
    from nnpp_edge.profiling import suites
    from nnpp_edge.profiling.evaluate import EAGER, evaluate
    from nnpp_edge.profiling.rivals import exact_and, narrow_corridor
    from nnpp_edge.progress import bar
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
    body = vehicle.make()
    bodies = _body_workloads(workloads, body is not None, prices is not None)
    if dataset is not None and (bodies or rocks):
        raise click.UsageError("vehicles and rocks need elevations, a data set holds cost maps: give --terrain")
    of_each = _prices(prices)
    options.check_outputs(("--plot", plot))
    needed = models if {Method.NNPP, Method.AUTO} & set(methods) else ()
    networks = {Path(name).stem: NetworkModel(name) for name in needed}
    control = [narrow_corridor()] if fresh_map else []
    of_point, of_body = (exact_and(methods, networks, each) + control for each in ((), of_each))
    dems = suites.TerrainFiles(files, rescale, cell_size, allow_vrt).read()
    suites.check_sizes(dems, sizes)

    def cases(name: str, size: "Size") -> "Iterator[Case]":
        if dataset is not None:
            return suites.dataset_cases(dataset, name)
        if synthetic:
            return suites.synthetic_cases(name, size, seed, min_distance, body, rocks)
        return suites.terrain_cases(dems, name, size, seed, min_distance, body, rocks)

    runs = list(product(workloads, (read_recipe(dataset).size,) if dataset else sizes))
    rows: list[dict[str, str | float | None]] = []
    with bar("evaluate", queries * len(runs)) as advance:
        for at, (name, size) in enumerate(runs):

            def of_run(done: int, before: int = at * queries) -> None:
                advance(before + done)

            rivals = of_body if name in bodies else of_point
            figures = evaluate(
                cases(name, size), rivals, queries, repeats=repeats, fresh_map=fresh_map, progress=of_run
            )
            place = {"workload": name, "size": suites.name_of(size)}
            rows += [{**place, **row} for row in figures.values()]
    standing = [row for row in rows if not str(row["method"]).endswith(EAGER)]
    if plot is not None:
        from nnpp_edge.viz.figures import pareto

        pareto([row | {"method": _label(row)} for row in standing], plot)
    if as_json:
        click.echo(json.dumps(rows, indent=1))
        return
    tables = [([row for row in standing if row["workload"] not in bodies], COLUMNS)]
    if fresh_map:
        tables.append(([row for row in rows if row["workload"] not in bodies], FRESH_COLUMNS))
    tables.append(([row for row in rows if row["workload"] in bodies], BODY_COLUMNS))
    click.echo("\n\n".join(table(each, columns, markdown) for each, columns in tables if each))


def _body_workloads(names: Sequence[str], vehicle: bool, prices: bool) -> list[str]:
    """The workloads of a vehicle; UsageError where there are some without a vehicle, or the other way round."""
    from nnpp_edge.terrain.workloads import body_rocks, workload

    found = [name for name in names if body_rocks(name) is not None]
    for name in names:
        if name not in found:
            workload(name)  # InvalidQueryError where there is none of that name
    if found and not vehicle:
        raise click.UsageError(f"--workload {found[0]} needs a vehicle: give --vehicle")
    if not found and (vehicle or prices):
        raise click.UsageError("--vehicle and --prices are for the workloads body and body-rocksN")
    return found


def _prices(names: tuple[str, ...] | None) -> "list[Price]":
    """The prices of these names; by default that of a point."""
    from nnpp_edge.runtime.map.prices import Price

    if unknown := set(names or ()) - set(Price):
        raise click.UsageError(f"--prices must be of {', '.join(Price)}, got {', '.join(sorted(unknown))}")
    return [Price(name) for name in names or (Price.EQ1,)]


def _label(row: Mapping[str, str | float | None]) -> str:
    """A planner's name in a picture."""
    return str(row["method"] if row["price"] is None else f"{row['method']}, {row['price']}")


def table(rows: Sequence[dict[str, str | float | None]], columns: Mapping[str, str], markdown: bool = False) -> str:
    """The rows for people."""
    from nnpp_edge.progress import markdown_table, render_table

    body = [[_shown(key, row[key]) for key in columns] for row in rows]
    if markdown:
        return markdown_table(list(columns.values()), body)
    return render_table(list(columns.values()), body, sections=[row["method"] == "astar" for row in rows])


def _shown(key: str, value: str | float | None) -> str:
    if value is None:
        return "–"
    if isinstance(value, int | float) and key in _SHARES | _GAPS:
        return f"{100 * value:.1f} %" if key in _SHARES else f"{100 * value:.2f} %"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
