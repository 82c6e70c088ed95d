"""`nnpp-edge profile`: what the planners take on this machine, against budgets, or beside other
libraries.
"""

import json
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.text import tell

if TYPE_CHECKING:
    from nnpp_edge.profiling.rows import Facts

_FILES = ("report.json", "report.md", "report.html")
_PEERS_SIZES = (256, 512, 1024)
_PEERS_QUERIES = 50
_DEFAULT = "mission"
_TERRAIN = "Elevation file, or several, in place of the profile's; else the sample."
_VEHICLE = (
    "Vehicle of the workloads body and body-rocksN, in place of the profile's: a shipped "
    "vehicle or a TOML file."
)
_OUTPUT = (
    "Folder for report.json, report.md and report.html; with --peers for peers.json and peers.md."
)
_SIZES = (
    "Sides of the maps, in place of the profile's; for --peers 256,512,1024. Synthetic terrain "
    "where no file is "
    "large enough."
)


@options.command("compare")
def compare_command(
    before: Path,
    after: Path,
    /,
    tolerance: Annotated[
        float, options.NOT_NEGATIVE, "Share by which a figure may become worse."
    ] = 0.1,
    as_json: options.AsJson = False,
) -> None:
    """Look for regressions between two reports, report.json of -o.

    The figures of the first are budgets for the second, but for the tolerance. Exit codes are those
    of nnpp-edge profile.

    \b
    nnpp-edge profile compare before/report.json after/report.json --tolerance 0.1
    """
    from nnpp_edge.cli.profile_text import comparison_text
    from nnpp_edge.profiling.compare import compare, read_report
    from nnpp_edge.profiling.judge import EXIT_CODES

    comparison = compare(read_report(before), read_report(after), tolerance)
    tell(as_json, comparison, lambda: comparison_text(comparison), indent=1)
    sys.exit(EXIT_CODES[comparison["verdict"]])


@options.command("render")
def render_command(
    report: Path,
    /,
    output: Annotated[Path | None, "-o", options.PATH, "The page's file, or its folder."] = None,
) -> None:
    """Draw the page of a report, without measuring again.

    REPORT is a report.json of -o, of this machine or another. Without -o the page is put beside it,
    as report.html. Prints what was written.

    \b
    nnpp-edge profile render report/report.json
    """
    from nnpp_edge.files import write_whole
    from nnpp_edge.profiling.compare import read_report
    from nnpp_edge.runtime.errors import InvalidQueryError
    from nnpp_edge.runtime.reading import refused_as
    from nnpp_edge.viz.figures import page

    facts = read_report(report)
    output = output or report.with_suffix(".html")
    if output.is_dir():
        output /= "report.html"
    options.check_outputs(("--output", output), make_folders=True)
    wanted = f"{report}: wanted a report of nnpp-edge profile, got a damaged one"
    with refused_as(InvalidQueryError, wanted):
        content = page(facts).encode()
    write_whole(output, content)
    click.echo(output)


@dataclass(frozen=True, kw_only=True)
class ProfileOptions:
    """Options; None and () where not given."""

    profile: Annotated[
        str | None,
        {"metavar": "NAME|FILE"},
        "A shipped profile (mission, edge-2core, single-core, quick, rover) or a TOML file; by "
        "default mission.",
    ] = None
    peers: Annotated[bool, "Instead: compare with other libraries' grid search."] = False
    terrain: Annotated[options.TerrainFiles, _TERRAIN] = ()
    cell_size: options.CellSize = None
    rescale: options.Rescale = None
    vehicle: Annotated[str | None, {"metavar": "NAME|FILE"}, _VEHICLE] = None
    sizes: Annotated[tuple[int, ...] | None, options.COUNTS, _SIZES] = None
    queries: Annotated[
        int | None,
        "For each workload and size, in place of the profile's; for --peers 50.",
    ] = None
    seed: Annotated[
        int | None, options.SEED, "Of every random choice; by default the profile's, else 1."
    ] = None
    as_json: options.AsJson = False
    output: Annotated[Path | None, "-o", options.FOLDER, _OUTPUT] = None
    junit: Annotated[Path | None, "Write the budgets to this file, as tests in JUnit XML."] = None

    def files(self, names: Iterable[str], read: Iterable[str] = ()) -> list[Path]:
        """Those to write, if any, which were checked against what is read."""
        paths = [] if self.output is None else [self.output / name for name in names]
        outputs: list[tuple[str, Path | None]] = [("--output", path) for path in paths]
        options.check_outputs(
            *outputs, ("--junit", self.junit), more_inputs=read, make_folders=True
        )
        return paths


@options.command(
    "profile",
    click.Group,
    invoke_without_command=True,
    commands={"compare": compare_command, "render": render_command},
)
def command(asked: ProfileOptions) -> None:
    """Measure the planners on this machine against the budgets of a profile.

    Pins to the profile's cores and lets exact A*, corridor, learned region (int8 and fp32) and auto
    answer the same queries in turns. Then the profile's planner gets each map as if it had just
    arrived, and where a budget asks for it the onboard loop is run with a patch of elevations at
    each tick. Prints times by stage, speed-up, path costs and the budgets. Exit code 0 when all are
    met, 1 when one is missed, 3 when the run was too noisy to tell, or a budget was missed because
    the processor was slowed.

    \b
    nnpp-edge profile
    nnpp-edge profile --profile quick
    nnpp-edge profile --profile edge-2core --terrain dem.tif -o report
    nnpp-edge profile --profile quick --junit budgets.xml
    nnpp-edge profile render report/report.json
    nnpp-edge profile compare before/report.json after/report.json
    nnpp-edge profile --peers --sizes 256,512,1024 -o bench

    With --peers a step costs its length times the mean weight of its two cells, the weight being 1
    + 5.61 T; gaps are path costs by that rule over exact A*'s, less 1. All planners then run on one
    thread. What a planner prepares for a map is timed apart.
    """
    if (inner := click.get_current_context().invoked_subcommand) is not None:
        if any(vars(asked).values()):
            raise click.UsageError(f"the options of profile do not go with {inner}")
        return
    if asked.profile and asked.peers:
        raise click.UsageError("give one of --profile and --peers")
    if not asked.peers:
        sys.exit(_profile(asked.profile or _DEFAULT, asked))
    for name in ("vehicle", "junit"):
        if getattr(asked, name):
            raise click.UsageError(f"--{name} does not go with --peers")
    _peers(asked)


def _profile(name: str, asked: ProfileOptions) -> int:
    """Measure, write what was asked for, print the report; the exit code."""
    from nnpp_edge.cli.profile_text import report_text
    from nnpp_edge.files import write_all
    from nnpp_edge.profiling.judge import EXIT_CODES
    from nnpp_edge.profiling.junit import junit
    from nnpp_edge.profiling.measure import queries_in
    from nnpp_edge.profiling.profile_file import overridden, read_profile
    from nnpp_edge.profiling.report import profile_machine
    from nnpp_edge.progress import bar

    profile = read_profile(name)
    networks = profile.networks
    read = (*profile.load.terrain, networks.int8, networks.fp32, networks.paper)
    written = asked.files(_FILES, filter(None, (*read, profile.load.vehicle)))
    names = ("cell_size", "rescale", "sizes", "queries", "seed", "vehicle")
    changes = {key: getattr(asked, key) for key in names}
    terrain = tuple(map(str, asked.terrain)) or None
    profile, notes = overridden(profile, terrain=terrain, **changes)
    with bar("profile", queries_in(profile.load), quiet=True) as advance:
        report = profile_machine(
            profile,
            notes=notes,
            progress=advance,
            say=lambda line: click.echo(line, err=True),
        )
    content = json.dumps(report, indent=1)
    contents = {} if asked.junit is None else {asked.junit: junit(report)}
    if written:
        markdown = report_text(report, markdown=True)
        texts = (content, markdown, _page(report))
        files = zip(written, texts, strict=True)
        contents |= {path: text.encode() for path, text in files if text}
    write_all(contents)
    click.echo(content if asked.as_json else report_text(report))
    return EXIT_CODES[report["verdict"]]


def _page(report: "Facts") -> str:
    """The report as a page of HTML; empty, which is said, where the extra `viz` is not
    installed.
    """
    from nnpp_edge.runtime.errors import MissingExtraError
    from nnpp_edge.viz.figures import page

    try:
        return page(report)
    except MissingExtraError as error:
        click.echo(f"note: {_FILES[-1]} is left out: {error}", err=True)
        return ""


def _peers(asked: ProfileOptions) -> None:
    """Measure beside other libraries, write what was asked for, print the table."""
    from nnpp_edge.benchmarks.peers import run
    from nnpp_edge.cli.profile_text import peers_text
    from nnpp_edge.files import write_all
    from nnpp_edge.profiling.suites import dems_of
    from nnpp_edge.progress import bar

    sizes = asked.sizes or _PEERS_SIZES
    queries = asked.queries or _PEERS_QUERIES
    seed = 1 if asked.seed is None else asked.seed
    if not 16 <= min(sizes) <= max(sizes) <= options.LARGEST_SIDE or len(set(sizes)) < len(sizes):
        words = ",".join(map(str, sizes))
        raise click.UsageError(
            f"--sizes must be different numbers from 16 to {options.LARGEST_SIDE}, got {words}"
        )
    written = asked.files(("peers.json", "peers.md"))
    dems = dems_of(asked.terrain, asked.rescale, asked.cell_size)
    with bar("profile", queries * len(sizes)) as advance:
        rows, missing = run(sizes, queries, dems, seed=seed, progress=advance)
    facts = {"queries": queries, "seed": seed, "left_out": missing, "rows": rows}
    if written:
        texts = (json.dumps(facts, indent=1), f"{peers_text(rows, missing, markdown=True)}\n")
        write_all({path: text.encode() for path, text in zip(written, texts, strict=True)})
    tell(asked.as_json, facts, lambda: peers_text(rows, missing), indent=1)
