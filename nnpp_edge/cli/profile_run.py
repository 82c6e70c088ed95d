"""`nnpp-edge profile --profile`: the planners against a profile's budgets."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options

if TYPE_CHECKING:
    from nnpp_edge.profiling.profile_file import Profile
    from nnpp_edge.profiling.report_format import Report

FILES = ("report.json", "report.md", "board-row.md", "trace.json", "report.html")
"""That `-o` writes."""


@dataclass(frozen=True)
class ProfileOptions:
    """The options of `nnpp-edge profile`, as on the command line; None and () where not given."""

    terrain: tuple[Path, ...]
    cell_size: float | None
    rescale: float | None
    allow_vrt: bool
    vehicle: str | None
    sizes: tuple[int, ...] | None
    queries: int | None
    seed: int | None
    as_json: bool
    markdown: bool
    start_up: bool
    limit_s: float | None
    output: Path | None


def run_profile(name: str, given: ProfileOptions) -> int:
    """Measure, write what was asked for, print the report; the exit code."""
    from nnpp_edge.cli.profile_text import report_markdown, report_text
    from nnpp_edge.files import write_all
    from nnpp_edge.profiling.board import board_header, board_row
    from nnpp_edge.profiling.judge import EXIT_CODES
    from nnpp_edge.profiling.measure import queries_in
    from nnpp_edge.profiling.profile_file import overridden, read_profile
    from nnpp_edge.profiling.report import Watchers, profile_machine
    from nnpp_edge.profiling.trace import Trace
    from nnpp_edge.progress import bar
    from nnpp_edge.terrain.vehicle_files import load_vehicle

    profile = read_profile(name)
    others = (profile.networks.fp32, profile.load.vehicle)
    written = [] if given.output is None else [given.output / name for name in FILES]
    options.check_outputs(
        *(("--output", path) for path in written),
        more_inputs=(*profile.load.terrain, profile.networks.int8, *filter(None, others)),
        make_folders=True,
    )
    names = ("cell_size", "rescale", "sizes", "queries", "seed", "vehicle")
    changes = {key: getattr(given, key) for key in names}
    changes |= {"allow_vrt": given.allow_vrt or None}
    terrain = tuple(map(str, given.terrain)) or None
    profile, dropped = overridden(profile, terrain=terrain, **changes)
    if profile.load.vehicle is not None:
        load_vehicle(profile.load.vehicle)  # before the run: it may be none
    notes = [f"left out, as their sizes are not measured: {', '.join(dropped)}"] if dropped else []
    runs, trace = 1 + profile.contention.wanted, None if given.output is None else Trace("nnpp-edge profile")
    with bar("profile", runs * queries_in(profile.load), quiet=True) as advance:
        watchers = Watchers(advance, lambda line: click.echo(line, err=True), trace)
        report = profile_machine(profile, start_up=given.start_up, notes=notes, watchers=watchers)
    content, markdown = json.dumps(report, indent=1), report_markdown(report)
    if trace is not None:
        rows = f"{board_header()}\n{board_row(report)}\n"
        contents = (content.encode(), markdown.encode(), rows.encode(), trace.to_json(), _page(report, profile))
        write_all({path: each for path, each in zip(written, contents, strict=True) if each})
    printed = content if given.as_json else markdown if given.markdown else report_text(report)
    click.echo(printed.rstrip("\n"))
    return EXIT_CODES[report["verdict"]]


def _page(report: "Report", profile: "Profile") -> bytes:
    """The report as a page of HTML; empty, which is said, where the extra `viz` is not installed."""
    try:
        from nnpp_edge.viz.profile_page import page
    except ImportError as error:
        click.echo(f"note: {FILES[-1]} is left out: {error} (pip install 'nnpp-edge[viz]')", err=True)
        return b""
    return page(report, profile).encode()
