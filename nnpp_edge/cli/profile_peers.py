"""`nnpp-edge profile --peers`: the planners beside other libraries' grid search."""

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.profile_run import ProfileOptions

if TYPE_CHECKING:
    from nnpp_edge.profiling.contest import Figures

_COLUMNS = {
    "size": "size",
    "terrain": "terrain",
    "planner": "planner",
    "n": "n",
    "time_ms_median": "ms\nmedian",
    "time_ms_p95": "ms\np95",
    "times_astar_median": "× astar\nmedian",
    "map_ms_median": "map\nms",
    "once_ms_median": "one-off\nms",
    "elevation_ms_median": "elevation →\npath, ms",
    "gap_mean": "gap\nmean",
    "gap_max": "gap\nmax",
    "same_optimum": "same\noptimum",
}
_SIZES, _QUERIES, _LIMIT_S = (256, 512, 1024), 50, 5.0


def run_peers(given: ProfileOptions) -> None:
    """Measure, write what was asked for, print the table or JSON."""
    from nnpp_edge.benchmarks.peers import run
    from nnpp_edge.files import write_all
    from nnpp_edge.profiling.suites import TerrainFiles
    from nnpp_edge.progress import bar

    sizes, queries, limit_s = given.sizes or _SIZES, given.queries or _QUERIES, given.limit_s or _LIMIT_S
    seed = 1 if given.seed is None else given.seed
    if not 16 <= min(sizes) <= max(sizes) <= options.LARGEST_SIDE or len(set(sizes)) < len(sizes):
        words = ",".join(map(str, sizes))
        raise click.UsageError(f"--sizes must be different numbers from 16 to {options.LARGEST_SIDE}, got {words}")
    written = [] if given.output is None else [given.output / f"peers.{end}" for end in ("json", "md", "png")]
    options.check_outputs(*(("--output", path) for path in written), make_folders=True)
    terrain = TerrainFiles.or_sample(given.terrain, given.rescale, given.cell_size, given.allow_vrt)
    with bar("profile", queries * len(sizes)) as advance:
        rows, missing = run(sizes, queries, terrain, seed=seed, limit_s=limit_s, progress=advance)
    facts = {"queries": queries, "seed": seed, "limit_s": limit_s, "left_out": missing, "rows": rows}
    content = json.dumps(facts, indent=1)
    if written:
        from nnpp_edge.viz.figures import times_by_size

        table = f"{peers_text(rows, missing, markdown=True)}\n"
        write_all(dict(zip(written, (content.encode(), table.encode(), times_by_size(rows)), strict=True)))
    click.echo(content if given.as_json else peers_text(rows, missing, markdown=given.markdown))


def peers_text(rows: Sequence["Figures"], missing: Sequence[str], *, markdown: bool = False) -> str:
    """The rows for people: the table, what each planner minimises, and who was left out."""
    from nnpp_edge.progress import markdown_table, render_table

    body, header = [[_shown(key, dict(row)[key]) for key in _COLUMNS] for row in rows], list(_COLUMNS.values())
    first = rows[0]["planner"]
    if markdown:
        lines = [markdown_table(header, body), ""]
    else:
        lines = [render_table(header, body, sections=[row["planner"] == first for row in rows])]
    lines += ["one-off: from weights to a path, nothing kept; elevation → path: ours by Planner.of_elevation in the"]
    lines += ["paper's step costs, the others by our traversability_cost and their own search"]
    objectives = {f"{row['planner']} {row['version']}": row["objective"] for row in rows}
    width = max(map(len, objectives))
    lines += ["minimised:", *(f"  {name:{width}}  {objective}" for name, objective in objectives.items())]
    lines += [f"{row['planner']} at {row['size']}: {row['note']}" for row in rows if row["note"]]
    failed = [row for row in rows if row["failed"]]
    lines += [f"{row['planner']} at {row['size']}: no path for {row['failed']} queries" for row in failed]
    if missing:
        lines.append(f"left out, not installed: {', '.join(missing)} (pip install 'nnpp-edge[bench]')")
    return "\n".join(lines)


def _shown(key: str, value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if key.startswith("gap"):
            return f"{round(100 * value, 2) + 0.0:.2f} %"  # no -0.00
        return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
    return str(value)
