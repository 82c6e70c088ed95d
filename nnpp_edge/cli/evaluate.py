"""`nnpp-edge evaluate`: the planners beside each other."""

import json
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options

if TYPE_CHECKING:
    from nnpp_edge.profiling.suites import Case, Size

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
_SHARES = {"success_raw", "success", "region_share_mean"}
_GAPS = {"gap_mean", "gap_p99"}
_WORKLOADS = "soft, limit20, limit15 or any limitN."
_MODEL = "Shipped model or file for nnpp; several are set beside each other."
_REPEATS = "Times each planner answers each query; its median time counts."
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
@click.option("--repeats", type=options.COUNT, default=3, help=_REPEATS)
@click.option("--plot", type=options.NEW_FILE, help="PNG to draw: cost gap against time, every planner.")
@options.seed
@options.as_json
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
    repeats: int,
    plot: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Compare planners on many queries, in one interleaved run.

    Every planner gets the same maps and queries, in turns. Speed-ups and gaps are against exact A* on the
    same query. Times count the whole job, widening and fallback included.

    \b
    nnpp-edge evaluate --terrain dem.tif --rescale 20 --workload soft,limit15 --sizes 256,512
    """
    from nnpp_edge.profiling import suites
    from nnpp_edge.profiling.evaluate import evaluate
    from nnpp_edge.profiling.rivals import exact_and
    from nnpp_edge.progress import bar
    from nnpp_edge.runtime.network.inference import NetworkModel
    from nnpp_edge.runtime.planners.plan import Method
    from nnpp_edge.terrain.dataset import read_recipe

    files = (*terrain, *more_terrain)
    if bool(files) + (dataset is not None) + synthetic != 1:
        raise click.UsageError("give one of --terrain FILE, --dataset DIR and --synthetic")
    if unknown := set(methods) - set(Method):
        raise click.UsageError(f"--methods must be of {', '.join(Method)}, got {', '.join(sorted(unknown))}")
    options.check_outputs(("--plot", plot))
    needed = models if {Method.NNPP, Method.AUTO} & set(methods) else ()
    rivals = exact_and(methods, {Path(name).stem: NetworkModel(name) for name in needed})
    dems = suites.TerrainFiles(files, rescale, cell_size, allow_vrt).read()
    suites.check_sizes(dems, sizes)

    def cases(name: str, size: "Size") -> "Iterator[Case]":
        if dataset is not None:
            return suites.dataset_cases(dataset, name)
        if synthetic:
            return suites.synthetic_cases(name, size, seed, min_distance)
        return suites.terrain_cases(dems, name, size, seed, min_distance)

    runs = list(product(workloads, (read_recipe(dataset).size,) if dataset else sizes))
    rows: list[dict[str, str | float | None]] = []
    with bar("evaluate", queries * len(runs)) as advance:
        for at, (name, size) in enumerate(runs):

            def of_run(done: int, before: int = at * queries) -> None:
                advance(before + done)

            figures = evaluate(cases(name, size), rivals, queries, repeats=repeats, progress=of_run)
            place = {"workload": name, "size": suites.name_of(size)}
            rows += [{**place, "method": method, **row} for method, row in figures.items()]
    if plot is not None:
        from nnpp_edge.viz.figures import pareto

        pareto(rows, plot)
    click.echo(json.dumps(rows, indent=1) if as_json else table(rows))


def table(rows: Sequence[dict[str, str | float | None]]) -> str:
    """The rows for people."""
    from nnpp_edge.progress import render_table

    body = [[_shown(key, row[key]) for key in COLUMNS] for row in rows]
    return render_table(list(COLUMNS.values()), body, sections=[row["method"] == "astar" for row in rows])


def _shown(key: str, value: str | float | None) -> str:
    if value is None:
        return "–"
    if isinstance(value, int | float) and key in _SHARES | _GAPS:
        return f"{100 * value:.1f} %" if key in _SHARES else f"{100 * value:.2f} %"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
