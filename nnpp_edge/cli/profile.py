"""`nnpp-edge profile`: what the planners take on this machine, against budgets, or beside other libraries."""

import json
import sys
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
_STDOUT = "-"
_PEERS_SIZES, _PEERS_QUERIES, _PEERS_LIMIT_S = (256, 512, 1024), 50, 5.0


@click.group(name="profile", invoke_without_command=True)
@click.option("--profile", "profile_name", metavar="NAME|FILE",
              help="A shipped profile (paper, edge-2core, single-core, quick) or a TOML file.")  # fmt: skip
@click.option("--peers", is_flag=True, help="Instead: beside other libraries' grid search.")
@click.option("--terrain", multiple=True, type=options.PATH,
              help="Elevation file, or several, in place of the profile's; else the sample.")  # fmt: skip
@click.option("--cell-size", type=float, help="Side of a cell in metres, where the files do not say.")
@click.option("--rescale", type=float, help="Rescale the terrain to cells of so many metres, slopes kept.")
@click.option("--sizes", type=options.Numbers(),
              help="Sides of the maps, in place of the profile's; for --peers 256,512,1024. Synthetic terrain where "
                   "no file is large enough.")  # fmt: skip
@click.option("--queries", type=click.IntRange(1),
              help="For each workload and size, in place of the profile's; for --peers 50.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0), help="Of every random choice; by default the profile's, else 1.")
@click.option("--json", "json_file", is_flag=False, flag_value=_STDOUT, metavar="[FILE]",
              help="The report as JSON: to a file, or printed.")  # fmt: skip
@click.option("--html", type=options.NEW_FILE, help="The report as one self-contained page.")
@click.option("--start-up", is_flag=True, help="Also measure import to first plan in new processes; takes a minute.")
@click.option("--save-choice", is_flag=False, flag_value=_STDOUT, metavar="[FILE]",
              help="Let the method `auto` go by the figures of this run from now on.")  # fmt: skip
@click.option("--limit", "limit_s", type=click.FloatRange(0.0, min_open=True),
              help="With --peers: seconds; a planner that needs longer for a query is left out at that size "
                   "(by default 5).")  # fmt: skip
@click.option("-o", "--output", type=options.FOLDER, help="With --peers: folder for peers.json and peers.png.")
@click.pass_context
def command(ctx: click.Context, **given: Any) -> None:
    """Measure the planners on this machine against the budgets of a profile.

    Pins to the profile's cores and lets exact A*, corridor, learned region (int8 and fp32) and auto answer the
    same queries in turns. Prints times by stage, speed-up, path costs, where each planner starts to pay, and the
    budgets. Exit code 0 when all are met, 1 when one is missed, 3 when the run was too noisy to tell.

    \b
    nnpp-edge profile --profile quick
    nnpp-edge profile --profile edge-2core --terrain dem.tif --json report.json --html report.html
    nnpp-edge profile --profile edge-2core --save-choice
    nnpp-edge profile compare before.json after.json
    nnpp-edge profile --peers --sizes 256,512,1024 -o bench

    With --peers a step costs its length times the mean weight of its two cells, the weight being 1 + 5.61 T; gaps
    are path costs by that rule over exact A*'s, less 1. All planners then run on one thread.
    """
    given["terrain"] = given["terrain"] or None
    if ctx.invoked_subcommand is not None:
        if any(value for value in given.values()):
            raise click.UsageError(f"the options of profile do not go with {ctx.invoked_subcommand}")
        return
    if bool(given["profile_name"]) == given["peers"]:
        raise click.UsageError("give either --profile (paper, edge-2core, single-core, quick or a file) or --peers")
    foreign = ("html", "start_up", "save_choice") if given["peers"] else ("limit_s", "output")
    for name in foreign:
        if given[name]:
            option = next(p.opts[-1] for p in ctx.command.params if p.name == name)
            raise click.UsageError(f"{option} does not go with --{'peers' if given['peers'] else 'profile'}")
    if given["peers"]:
        _peers(given)
    else:
        sys.exit(_profile(given))


@command.command(name="compare")
@click.argument("before", type=options.PATH)
@click.argument("after", type=options.PATH)
@click.option("--tolerance", type=click.FloatRange(0.0), default=0.1, show_default=True,
              help="Share by which a figure may become worse.")  # fmt: skip
@options.as_json
def compare_command(before: Path, after: Path, tolerance: float, as_json: bool) -> None:
    """Look for regressions between two reports written with --json.

    Exit code 1 when a figure is worse by more than the tolerance, 3 when only figures of a disturbed run are.

    \b
    nnpp-edge profile compare before.json after.json --tolerance 0.1
    """
    from nnpp_edge.cli.profile_text import compared
    from nnpp_edge.profiling.compare import NOISY, WORSE, compare, read_report

    told = compare(read_report(before), read_report(after), tolerance)
    click.echo(json.dumps(told, indent=1) if as_json else compared(told))
    sys.exit({WORSE: 1, NOISY: 3}.get(told["verdict"], 0))


def _profile(given: dict[str, Any]) -> int:
    from nnpp_edge.cli.profile_text import text
    from nnpp_edge.files import make_folder, write_whole
    from nnpp_edge.profiling.judge import EXIT_CODES
    from nnpp_edge.profiling.measure import queries_in
    from nnpp_edge.profiling.profile_file import overridden, read_profile
    from nnpp_edge.profiling.report import Watchers, choice_of, profile_machine
    from nnpp_edge.progress import bar

    choice = _choice_file(given["save_choice"])
    json_file = Path(given["json_file"]) if given["json_file"] not in (None, _STDOUT) else None
    for file in (json_file, given["html"], choice):
        if file is not None:
            make_folder(file.parent)
    if given["html"] is not None:
        from nnpp_edge.viz.profile_page import page  # before the run: what it needs may not be installed
    profile, dropped = overridden(
        read_profile(given["profile_name"]), terrain=given["terrain"] and tuple(map(str, given["terrain"])),
        **{key: given[key] for key in ("cell_size", "rescale", "sizes", "queries", "seed")},
    )  # fmt: skip
    notes = [f"left out, as their sizes are not measured: {', '.join(dropped)}"] if dropped else []
    with bar("profile", queries_in(profile.load), quiet=True) as advance:
        watchers = Watchers(advance, lambda line: click.echo(line, err=True))
        report = profile_machine(profile, start_up=given["start_up"], notes=notes, watchers=watchers)
    told = json.dumps(report, indent=1)
    if json_file is not None:
        write_whole(json_file, told.encode())
    if given["html"] is not None:
        write_whole(given["html"], page(report, profile).encode())
    if choice is not None:
        write_whole(choice, choice_of(report).to_json().encode())
        click.echo(f"auto goes by this run from now on: {choice}", err=True)
    click.echo(told if given["json_file"] == _STDOUT else text(report))
    return EXIT_CODES[report["verdict"]]


def _choice_file(named: str | None) -> Path | None:
    """Where to save what auto goes by; None if that was not asked for."""
    if named is None:
        return None
    if named != _STDOUT:
        return Path(named)
    from nnpp_edge.runtime.planners.choice import choice_path

    if (path := choice_path()) is None:
        raise click.UsageError("there is no home folder for the figures: give --save-choice FILE")
    return path


def _peers(given: dict[str, Any]) -> None:
    from nnpp_edge.benchmarks.peers import run
    from nnpp_edge.files import make_folder, write_whole
    from nnpp_edge.progress import bar

    sizes, queries = given["sizes"] or _PEERS_SIZES, given["queries"] or _PEERS_QUERIES
    limit_s, seed = given["limit_s"] or _PEERS_LIMIT_S, 1 if given["seed"] is None else given["seed"]
    output, json_file = given["output"], given["json_file"]
    if min(sizes) < 16 or len(set(sizes)) < len(sizes):
        raise click.UsageError(f"--sizes must be different numbers of at least 16, got {sizes}")
    for folder in (output, Path(json_file).parent if json_file not in (None, _STDOUT) else None):
        if folder is not None:
            make_folder(folder)
    terrain, rescale = given["terrain"], given["rescale"]
    if not terrain:
        terrain = (Path(str(files("nnpp_edge.terrain") / "samples" / _SAMPLE)),)
        rescale = rescale or _SAMPLE_RESCALE
    with bar("profile", queries * len(sizes)) as advance:
        rows, missing = run(
            sizes,
            queries,
            terrain,
            rescale=rescale,
            cell_size=given["cell_size"],
            seed=seed,
            limit_s=limit_s,
            progress=advance,
        )
    told = json.dumps(
        {"queries": queries, "seed": seed, "limit_s": limit_s, "left_out": missing, "rows": rows}, indent=1
    )
    if json_file not in (None, _STDOUT):
        write_whole(Path(json_file), told.encode())
    if output is not None:
        from nnpp_edge.viz.peers import times_by_size

        write_whole(output / "peers.json", told.encode())
        times_by_size(rows, output / "peers.png")
    click.echo(told if json_file == _STDOUT else peers_text(rows, missing))


def peers_text(rows: list[dict[str, Any]], missing: list[str]) -> str:
    """The rows for people: the table, what each planner minimises, and who was left out."""
    from nnpp_edge.progress import render_table

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
