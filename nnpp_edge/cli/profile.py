"""`nnpp-edge profile`: what the planners take on this machine, against budgets, or beside other libraries."""

import json
import sys
from pathlib import Path

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.profile_run import ProfileOptions

_ONLY_WITH_PROFILE = ("vehicle", "start_up")
_ONLY_WITH_PEERS = ("limit_s",)
_PROFILE = "A shipped profile (paper, edge-2core, single-core, quick, rover) or a TOML file."
_VEHICLE = (
    "Whose the workloads body and body-rocksN are, in place of the profile's: a shipped vehicle or a TOML file."
)
_OUTPUT = (
    "Folder for report.json, report.md, report.html, board-row.md (a row for docs/boards.md) and trace.json "
    "(what ran when, for ui.perfetto.dev); with --peers for peers.json, peers.md and peers.png."
)
_SIZES = (
    "Sides of the maps, in place of the profile's; for --peers 256,512,1024. Synthetic terrain where no file is "
    "large enough."
)
_QUERIES = "For each workload and size, in place of the profile's; for --peers 50."
_SEED = "Of every random choice; by default the profile's, else 1."
_START_UP = "Also measure import to first plan in new processes; takes a minute."
_TOLERANCE = "Share by which a figure may become worse."
_LIMIT = "With --peers: seconds; a planner that needs longer for a query is left out at that size (by default 5)."


@click.group(name="profile", invoke_without_command=True)
@click.option("--profile", "profile_name", metavar="NAME|FILE", help=_PROFILE)
@click.option("--peers", is_flag=True, help="Instead: beside other libraries' grid search.")
@options.terrain_files(", in place of the profile's; else the sample")
@click.option("--vehicle", metavar="NAME|FILE", help=_VEHICLE)
@click.option("--sizes", type=options.Numbers(), help=_SIZES)
@click.option("--queries", type=options.COUNT, help=_QUERIES)
@click.option("--seed", type=options.SEED, help=_SEED)
@options.as_json
@click.option("--markdown", is_flag=True, help="Print the report, with --peers its table, as Markdown.")
@click.option("--start-up", is_flag=True, help=_START_UP)
@click.option("--limit", "limit_s", type=options.POSITIVE, help=_LIMIT)
@click.option("-o", "--output", type=options.FOLDER, help=_OUTPUT)
@click.pass_context
def command(ctx: click.Context, /, profile_name: str | None, peers: bool, **given: object) -> None:
    """Measure the planners on this machine against the budgets of a profile.

    Pins to the profile's cores and lets exact A*, corridor, learned region (int8 and fp32) and auto answer the
    same queries in turns. Then the profile's planner gets each map as if it had just arrived, and where a budget
    asks for it the onboard loop is run with a patch of elevations at each tick. Where the profile says so all is
    measured once more with something running beside it. Prints times by stage, speed-up,
    path costs, where each planner starts to pay, and the budgets. Exit code 0 when all are met, 1 when one is
    missed, 3 when the run was too noisy to tell, or the processor was slowed and a budget missed for it.

    \b
    nnpp-edge profile --profile quick
    nnpp-edge profile --profile edge-2core --terrain dem.tif -o report
    nnpp-edge profile compare before/report.json after/report.json
    nnpp-edge profile --peers --sizes 256,512,1024 -o bench

    With --peers a step costs its length times the mean weight of its two cells, the weight being 1 + 5.61 T; gaps
    are path costs by that rule over exact A*'s, less 1. All planners then run on one thread; only cost maps, which
    others get from us, are computed on all cores. Beside a plan on a standing map stand one-off use (from weights to
    a path, nothing kept) and elevations to a path.
    """
    if ctx.invoked_subcommand is not None:
        if profile_name or peers or any(given.values()):
            raise click.UsageError(f"the options of profile do not go with {ctx.invoked_subcommand}")
        return
    if bool(profile_name) == peers:
        raise click.UsageError(
            "give either --profile (paper, edge-2core, single-core, quick, rover or a file) or --peers"
        )
    if given["as_json"] and given["markdown"]:
        raise click.UsageError("give one of --json and --markdown")
    for name in _ONLY_WITH_PROFILE if peers else _ONLY_WITH_PEERS:
        if given[name]:
            option = next(p.opts[-1] for p in ctx.command.params if p.name == name)
            raise click.UsageError(f"{option} does not go with --{'peers' if peers else 'profile'}")
    chosen = ProfileOptions(**given)  # type: ignore[arg-type]
    if profile_name is None:
        from nnpp_edge.cli.profile_peers import run_peers

        run_peers(chosen)
    else:
        from nnpp_edge.cli.profile_run import run_profile

        sys.exit(run_profile(profile_name, chosen))


@command.command(name="compare")
@click.argument("before", type=options.PATH)
@click.argument("after", type=options.PATH)
@click.option("--tolerance", type=options.NOT_NEGATIVE, default=0.1, help=_TOLERANCE)
@options.as_json
def compare_command(before: Path, after: Path, tolerance: float, as_json: bool) -> None:
    """Look for regressions between two reports, report.json of -o.

    Exit code 1 when a figure is worse by more than the tolerance, 3 when only figures of a disturbed run are.

    \b
    nnpp-edge profile compare before/report.json after/report.json --tolerance 0.1
    """
    from nnpp_edge.cli.profile_text import comparison_text
    from nnpp_edge.profiling.compare import NOISY, WORSE, compare, read_report

    comparison = compare(read_report(before), read_report(after), tolerance)
    click.echo(json.dumps(comparison, indent=1) if as_json else comparison_text(comparison))
    sys.exit({WORSE: 1, NOISY: 3}.get(comparison["verdict"], 0))
