"""`nnpp-edge profile`: how fast the planners are, beside other libraries."""

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import click

from nnpp_edge.cli import options

COLUMNS = {
    "size": "size", "terrain": "terrain", "planner": "planner", "n": "n", "time_ms_median": "ms\nmedian",
    "time_ms_p95": "ms\np95", "times_astar_median": "× astar\nmedian", "map_ms_median": "map\nms",
    "gap_mean": "gap\nmean", "gap_max": "gap\nmax", "same_optimum": "same\noptimum",
}  # fmt: skip
_SAMPLE, _SAMPLE_RESCALE = "moon_highlands.npz", 20.0


@click.command(name="profile")
@click.option("--peers", is_flag=True, help="Beside other libraries' grid search.")
@click.option("--terrain", multiple=True, type=options.PATH,
              help="Elevation file, or several; by default the bundled sample at cells of 20 m.")  # fmt: skip
@click.option("--cell-size", type=float, help="Side of a cell in metres, where the files do not say.")
@click.option("--rescale", type=float, help="Rescale the terrain to cells of so many metres, slopes kept.")
@click.option("--sizes", type=options.Numbers(), default="256,512,1024", show_default=True,
              help="Sides of the maps; where no file is large enough, on synthetic terrain.")  # fmt: skip
@click.option("--queries", type=click.IntRange(1), default=50, show_default=True, help="For each size.")
@click.option("--limit", "limit_s", type=click.FloatRange(0.0, min_open=True), default=5.0, show_default=True,
              help="Seconds; a planner that needs longer for a query is left out at that size.")  # fmt: skip
@click.option("-o", "--output", type=options.FOLDER, help="Folder for peers.json and a picture, peers.png.")
@options.seed
@options.as_json
def command(
    peers: bool, terrain: tuple[Path, ...], cell_size: float | None, rescale: float | None, sizes: tuple[int, ...],
    queries: int, limit_s: float, output: Path | None, seed: int, as_json: bool,
) -> None:  # fmt: skip
    """Measure the planners beside other libraries, in one interleaved run.

    All get the same maps and queries, in turns, on one thread. A step costs its length times the mean weight
    of its two cells, the weight being 1 + 5.61 T; gaps are path costs by that rule over exact A*'s, less 1.

    \b
    nnpp-edge profile --peers --sizes 256,512,1024 -o bench
    """
    if not peers:
        raise click.UsageError("only --peers can be profiled so far: nnpp-edge profile --peers")
    if min(sizes) < 16 or len(set(sizes)) < len(sizes):
        raise click.UsageError(f"--sizes must be different numbers of at least 16, got {sizes}")
    from nnpp_edge.cli.progress import bar
    from nnpp_edge.files import make_folder, write_whole
    from nnpp_edge.profiling.peers import run

    if output is not None:
        make_folder(output)
    if not terrain:
        terrain = (Path(str(files("nnpp_edge.terrain") / "samples" / _SAMPLE)),)
        rescale = rescale or _SAMPLE_RESCALE
    with bar("profile", queries * len(sizes)) as advance:
        rows, missing = run(
            sizes,
            queries,
            terrain,
            rescale=rescale,
            cell_size=cell_size,
            seed=seed,
            limit_s=limit_s,
            progress=advance,
        )
    told = json.dumps(
        {"queries": queries, "seed": seed, "limit_s": limit_s, "left_out": missing, "rows": rows}, indent=1
    )
    if output is not None:
        from nnpp_edge.viz.peers import times_by_size

        write_whole(output / "peers.json", told.encode())
        times_by_size(rows, output / "peers.png")
    click.echo(told if as_json else text(rows, missing))


def text(rows: list[dict[str, Any]], missing: list[str]) -> str:
    """The rows for people: the table, what each planner minimises, and who was left out."""
    from nnpp_edge.cli.progress import render_table

    def shown(key: str, value: Any) -> str:
        if value is None:
            return "–"
        if isinstance(value, bool):
            return "yes" if value else "no"
        if key.startswith("gap"):
            return f"{round(100 * value, 2) + 0.0:.2f} %"  # no -0.00
        if isinstance(value, float):
            return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
        return str(value)

    body = [[shown(key, row[key]) for key in COLUMNS] for row in rows]
    first = rows[0]["planner"]
    lines = [render_table(list(COLUMNS.values()), body, sections=[row["planner"] == first for row in rows])]
    objectives = {f"{row['planner']} {row['version']}": row["objective"] for row in rows}
    width = max(map(len, objectives))
    lines += ["minimised:", *(f"  {name:{width}}  {objective}" for name, objective in objectives.items())]
    lines += [f"{row['planner']} at {row['size']}: {row['note']}" for row in rows if row["note"]]
    lines += [
        f"{row['planner']} at {row['size']}: no path for {row['failed']} queries" for row in rows if row["failed"]
    ]
    if missing:
        lines.append(f"left out, not installed: {', '.join(missing)} (pip install 'nnpp-edge[bench]')")
    return "\n".join(lines)
