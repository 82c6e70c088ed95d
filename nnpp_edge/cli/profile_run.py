"""`nnpp-edge profile --profile`: the planners against a profile's budgets."""

import json
from dataclasses import dataclass
from pathlib import Path

import click

from nnpp_edge.cli import options

STDOUT = "-"
"""Given for a file: print it."""


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
    json_file: str | None
    html: Path | None
    markdown_file: str | None
    board_row: bool
    trace: Path | None
    start_up: bool
    limit_s: float | None
    output: Path | None

    @property
    def json_path(self) -> Path | None:
        """The file for the report; None where it is printed or not wanted."""
        return _file(self.json_file)

    @property
    def markdown_path(self) -> Path | None:
        """The same for Markdown."""
        return _file(self.markdown_file)


def _file(named: str | None) -> Path | None:
    return None if named is None or named == STDOUT else Path(named)


def run_profile(name: str, given: ProfileOptions) -> int:
    """Measure, write what was asked for, print the report; the exit code."""
    from nnpp_edge.cli.profile_text import report_markdown, report_text
    from nnpp_edge.files import write_all
    from nnpp_edge.profiling.board import board_row
    from nnpp_edge.profiling.judge import EXIT_CODES
    from nnpp_edge.profiling.measure import queries_in
    from nnpp_edge.profiling.profile_file import overridden, read_profile
    from nnpp_edge.profiling.report import Watchers, profile_machine
    from nnpp_edge.profiling.trace import Trace
    from nnpp_edge.progress import bar
    from nnpp_edge.terrain.vehicle_files import load_vehicle

    profile = read_profile(name)
    others = (profile.networks.fp32, profile.load.vehicle)
    options.check_outputs(
        *(("--json", given.json_path), ("--html", given.html), ("--markdown", given.markdown_path)),
        ("--trace", given.trace),
        more_inputs=(*profile.load.terrain, profile.networks.int8, *filter(None, others)),
        make_folders=True,
    )
    if given.html is not None:
        from nnpp_edge.viz.profile_page import page  # before the run: what it needs may not be installed
    names = ("cell_size", "rescale", "sizes", "queries", "seed", "vehicle")
    changes = {key: getattr(given, key) for key in names}
    changes |= {"allow_vrt": given.allow_vrt or None}
    terrain = tuple(map(str, given.terrain)) or None
    profile, dropped = overridden(profile, terrain=terrain, **changes)
    if profile.load.vehicle is not None:
        load_vehicle(profile.load.vehicle)  # before the run: it may be none
    notes = [f"left out, as their sizes are not measured: {', '.join(dropped)}"] if dropped else []
    runs, trace = 1 + profile.contention.wanted, None if given.trace is None else Trace("nnpp-edge profile")
    with bar("profile", runs * queries_in(profile.load), quiet=True) as advance:
        watchers = Watchers(advance, lambda line: click.echo(line, err=True), trace)
        report = profile_machine(profile, start_up=given.start_up, notes=notes, watchers=watchers)
    content = json.dumps(report, indent=1)
    contents: dict[Path, bytes] = {}
    if given.json_path is not None:
        contents[given.json_path] = content.encode()
    if given.html is not None:
        contents[given.html] = page(report, profile).encode()
    markdown = report_markdown(report)
    if given.markdown_path is not None:
        contents[given.markdown_path] = markdown.encode()
    if given.trace is not None and trace is not None:
        contents[given.trace] = trace.to_json()
    write_all(contents)
    if given.board_row:
        printed = board_row(report)
    elif given.json_file == STDOUT:
        printed = content
    else:
        printed = markdown if given.markdown_file == STDOUT else report_text(report)
    click.echo(printed.rstrip("\n"))
    return EXIT_CODES[report["verdict"]]
