"""The tables of README and docs/results.md: measured in one run, stored as docs/results.json, and
written into the pages.

python -m nnpp_edge.benchmarks.results LUNAR_TERRAIN.tif
python -m nnpp_edge.benchmarks.results LUNAR_TERRAIN.tif --only mission

The mission needs the extra `train`: the paper's network, which is shipped in int8 only, is exported
to be timed in fp32 beside it.
"""

import json
import re
import string
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import click

from nnpp_edge.files import write_all
from nnpp_edge.profiling.inference import fp32_and_int8_ms
from nnpp_edge.profiling.machine import environment
from nnpp_edge.progress import MISSING, markdown_table

Results = dict[str, Any]
"""Rows by suite, and where they were measured; or one row of figures."""
PAGES = "README.md", "docs/results.md"
STORED = Path("docs/results.json")
PAPERS_WEIGHTS = "training-state/paper.pt"
READY = "ready"
FRESH = "fresh"
BODY = "body"
ARCS = "arcs"
MISSION = "mission"
PEERS = "peers"
SUITES = {
    READY: [
        f"--rescale 20 --workload soft,limit20,limit15 --sizes {sizes} --queries {n} --repeats 2 "
        "--methods astar,corridor,nnpp"
        for sizes, n in (("256,512", 200), ("1024", 100), ("2048", 40))
    ],
    FRESH: [
        "--rescale 20 --workload soft --sizes 256,512,1024,2048 --queries 40 --repeats 2 "
        "--fresh-map"
    ],
    BODY: [
        "--rescale 0.25 --vehicle small-rover --set length_m=1.5 --set width_m=1.2 "
        "--set clearance_m=0.3 --workload body,body-rocks10 --sizes 256,512 --queries 60 "
        "--methods astar,corridor"
    ],
    ARCS: [
        "--size 256 --radius 2 --queries 100",
        "--size 256 --radius 2 --queries 100 --forwards",
        "--size 256 --radius 4 --queries 100",
        "--size 256 --radius 2 --queries 100 --fixed",
        "--size 512 --radius 2 --queries 100",
        "--size 512 --radius 4 --queries 100",
        "--size 1024 --radius 2 --queries 40",
    ],
    MISSION: ["--rescale 20"],
    PEERS: ["--rescale 20 --peers --sizes 256,512,1024"],
}
"""Options of `nnpp-edge evaluate`, for arcs of `python -m nnpp_edge.benchmarks.arcs` and for the
mission and other libraries of `nnpp-edge profile`, beside the terrain.
"""
_OURS = str(Path(sys.executable).with_name("nnpp-edge"))
_MARK = re.compile(r"(<!-- results: (\w+) -->\n).*?(\n<!-- end -->)", re.DOTALL)


class Lines(NamedTuple):
    """Lines of a table: one for each group of a suite's rows."""

    suite: str
    cells: str
    """Joined by " | "; {METHOD[FIGURE]:FORM} is a figure of that method's row, in milliseconds
    (ms), in per cent (pc), or in a form of Python's. METHOD-faster is the lazy or the eager row.
    """
    wanted: Callable[[Results], bool] = bool
    """Whether a group has a line."""


TABLES: dict[str, tuple[str, tuple[Lines, ...]]] = {
    MISSION: (
        " | wanted | `edge`, 256² | `edge`, 512² | paper's network, 256²",
        (
            Lines(
                MISSION,
                "inferences a second, each right after a plan | 17 | "
                "{nnpp-256[inference_fps]:,.0f} | {nnpp-512[inference_fps]:,.0f} | "
                "{paper-256[inference_fps]:,.0f}",
            ),
            Lines(
                MISSION,
                "whole plans a second, each on a map that has just arrived | 17 | "
                "{nnpp-256[map_fps]:,.0f} | {nnpp-512[map_fps]:,.0f} | {paper-256[map_fps]:,.0f}",
            ),
            Lines(
                MISSION,
                "times as fast as exact A\\*, ours, compiled | 3 | "
                "{nnpp-256[speedup_total]:.1f} | {nnpp-512[speedup_total]:.1f} | "
                "{paper-256[speedup_total]:.2f}",
            ),
            Lines(
                MISSION,
                "times as fast as an A\\* like the paper's, plain Python | 3 | "
                "{nnpp-256[speedup_plain]:,.0f} | – | {paper-256[speedup_plain]:,.0f}",
            ),
            Lines(
                MISSION,
                "inference in int8, times as fast as in fp32 | above 1 | "
                "{nnpp-256[int8_speedup]:.2f} | {nnpp-512[int8_speedup]:.2f} | "
                "{paper-256[int8_speedup]:.2f}",
            ),
        ),
    ),
    "readme": (
        " | n | exact A\\* | corridor | narrow corridor | network's region (`nnpp`)",
        (
            Lines(
                READY,
                "ready cost map, {astar[size]}² | {astar[n]} | {astar[time_ms_median]:ms} | "
                "{corridor[time_ms_median]:ms}, {corridor[gap_mean]:pc} % | "
                "{corridor-narrow[time_ms_median]:ms}, {corridor-narrow[gap_mean]:pc} % | "
                "{nnpp[time_ms_median]:ms}, {nnpp[gap_mean]:pc} %",
                lambda each: each["astar"]["workload"] == "soft" and each["astar"]["size"] != 512,
            ),
            Lines(
                FRESH,
                "elevations just arrived, {astar[size]}² | {astar[n]} | "
                "{astar-faster[fresh_ms_median]:ms} | "
                "{corridor-faster[fresh_ms_median]:ms}, {corridor[gap_mean]:pc} % | "
                "{corridor-narrow-faster[fresh_ms_median]:ms}, {corridor-narrow[gap_mean]:pc} % | "
                "{nnpp-faster[fresh_ms_median]:ms}, {nnpp[gap_mean]:pc} %",
                lambda each: each["astar"]["size"] >= 1024,
            ),
            Lines(
                BODY,
                "a body of 1.5 × 1.2 m among rocks, {astar[size]}² | {astar[n]} | "
                "{astar[time_ms_median]:ms} | {corridor[time_ms_median]:ms}, "
                "{corridor[gap_mean]:pc} % | – | no network is used",
                lambda each: each["astar"]["workload"] == "body-rocks10",
            ),
            Lines(
                ARCS,
                "the same, arcs of 2 m and more, {arcs[size]}² | {arcs[n]} | "
                "{arcs[exact_ms_median]:ms} | {arcs[first_ms_median]:ms}, {arcs[gap_mean]:pc} % | "
                "– | no network is used",
                lambda each: each["arcs"]["size"] == 512 and each["arcs"]["radius_m"] == 2.0,
            ),
        ),
    ),
    READY: (
        "workload | size | n | exact A\\*, ms | `corridor`: ms, gap | `corridor-narrow` | "
        "`nnpp-untrained` | `nnpp` | times as fast | first region",
        (
            Lines(
                READY,
                "{astar[workload]} | {astar[size]}² | {astar[n]} | {astar[time_ms_median]:ms} | "
                "{corridor[time_ms_median]:ms}, {corridor[gap_mean]:pc} % | "
                "{corridor-narrow[time_ms_median]:ms}, {corridor-narrow[gap_mean]:pc} % | "
                "{nnpp-untrained[time_ms_median]:ms}, {nnpp-untrained[gap_mean]:pc} % | "
                "{nnpp[time_ms_median]:ms}, {nnpp[gap_mean]:pc} % | "
                "{corridor[speedup_total]:.1f}, {corridor-narrow[speedup_total]:.1f}, "
                "{nnpp-untrained[speedup_total]:.1f}, {nnpp[speedup_total]:.1f} | "
                "{nnpp[success_raw]:.1%}",
            ),
        ),
    ),
    FRESH: (
        " | n | exact A\\*: lazy / eager | corridor: lazy / eager | gap | "
        "`nnpp`: lazy / eager | gap | control `corridor-narrow`: lazy / eager | gap",
        (
            Lines(
                FRESH,
                "{astar[size]}² | {astar[n]} | "
                "{astar[fresh_ms_median]:ms} / {astar-eager[fresh_ms_median]:ms} | "
                "{corridor[fresh_ms_median]:ms} / {corridor-eager[fresh_ms_median]:ms} | "
                "{corridor[fresh_gap_mean]:pc} % | "
                "{nnpp[fresh_ms_median]:ms} / {nnpp-eager[fresh_ms_median]:ms} | "
                "{nnpp[fresh_gap_mean]:pc} % | {corridor-narrow[fresh_ms_median]:ms} / "
                "{corridor-narrow-eager[fresh_ms_median]:ms} | "
                "{corridor-narrow[fresh_gap_mean]:pc} %",
            ),
        ),
    ),
    BODY: (
        " | n | exact A\\*, ms | corridor, ms | gap | poses checked | drawn without a path",
        (
            Lines(
                BODY,
                "{astar[workload]} {astar[size]}² | {corridor[n]} | "
                "{astar[time_ms_median]:ms} ({astar[time_ms_p95]:ms}) | "
                "{corridor[time_ms_median]:ms} ({corridor[time_ms_p95]:ms}) | "
                "{corridor[gap_mean]:pc} % ({corridor[gap_p95]:pc}) | "
                "{astar[checks_mean]:,.0f} / {corridor[checks_mean]:,.0f} | {corridor[unsolvable]}",
            ),
        ),
    ),
    ARCS: (
        " | solved | exact, ms | first plan, ms (p95, p99) | gap | driven | tick, ms (p99, max)",
        (
            Lines(
                ARCS,
                "{arcs[size]}², R = {arcs[radius_m]:g} m{arcs[kind]} | {arcs[solved]} of {arcs[n]} "
                "| {arcs[exact_ms_median]:ms} | {arcs[first_ms_median]:ms} "
                "({arcs[first_ms_p95]:ms}, {arcs[first_ms_p99]:ms}) | "
                "{arcs[gap_mean]:pc} % ({arcs[gap_p95]:pc}) | "
                "{arcs[driven_mean]:pc} % ({arcs[driven_p95]:pc}) | "
                "{arcs[tick_ms_median]:ms} ({arcs[tick_ms_p99]:ms}, {arcs[tick_ms_max]:ms})",
            ),
        ),
    ),
    PEERS: (
        " | size | n | ms | times exact A\\*'s time | gap | minimises",
        (
            Lines(
                PEERS,
                "{peers[planner]} {peers[version]} | {peers[size]}² | {peers[n]} | "
                "{peers[time_ms_median]:ms} | {peers[times_astar_median]:.2g} | "
                "{peers[gap_mean]:pc} % | {peers[objective]}",
            ),
        ),
    ),
}
"""By the names that stand in the pages: heads of columns, joined, and lines."""


def filled(page: str, found: Results) -> str:
    """A page with the tables of these results, each between its marks."""

    def table(mark: re.Match[str]) -> str:
        begin, name, end = mark.groups()
        what, _, suite = name.partition("_")
        if what == "stamp":
            return begin + _stamp(found["runs"][suite] if suite else found) + end
        heads, parts = TABLES[name]
        lines = [
            _FORMATTER.vformat(part.cells, (), each).split(" | ")
            for part in parts
            for each in _groups(found, part.suite)
            if part.wanted(each)
        ]
        return begin + markdown_table(heads.split(" | "), lines) + end

    return _MARK.sub(table, page)


def _stamp(found: Results) -> str:
    machine = found["machine"]
    flags = "AVX-512 and VNNI" if "avx512_vnni" in machine["flags"] else ", ".join(machine["flags"])
    return (
        f"One run of `make results`, commit {found['commit']}, {found['cores']} cores of "
        f"{machine['cpu']} ({flags}), Python {machine['python']}."
    )


class _Formatter(string.Formatter):
    """Python's formatting, and the forms ``ms`` and ``pc``; a dash for what was not measured."""

    def get_field(self, name: str, *given: Any) -> Any:
        try:
            return super().get_field(name, *given)
        except KeyError:
            return None, name

    def format_field(self, value: float | None, form: str) -> str:
        if value is None:
            return MISSING
        if form == "ms":
            form = ".3g" if value < 1e3 else ",.0f"
        elif form == "pc":
            form = ".2f"
            value = 100.0 * value
        return f"{value:{form}}".replace("%", " %")


_FORMATTER = _Formatter()


def _groups(found: Results, suite: str) -> Iterable[Results]:
    """The rows of each workload and size by method; each row of arcs by itself."""
    groups: dict[object, Results] = {}
    if suite == MISSION:
        return [{f"{row['planner']}-{row['size']}": row for row in found[suite]}]
    if suite == PEERS:
        return [{suite: row} for row in found[suite]]
    for row in found[suite]:
        if suite == ARCS:
            kind = ", forwards alone" * row["forwards"] + ", heading at the goal" * row["fixed"]
            groups[len(groups)] = {"arcs": row | {"kind": kind}}
            continue
        group = groups.setdefault((row["workload"], row["size"]), {})
        method = row["method"]
        group[method] = row
        lazy = group.get(method.removesuffix("-eager"), row)
        if row.get("fresh_ms_median", 0.0) <= lazy.get("fresh_ms_median", 0.0):
            group[method.removesuffix("-eager") + "-faster"] = row
    return groups.values()


@click.command()
@click.argument("terrain", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--only", type=click.Choice(list(SUITES)), help="Measure this suite anew alone.")
def main(terrain: Path, only: str | None) -> None:
    """Measure all tables on this terrain and write them into the pages: a quarter of an hour, on a
    quiet machine.
    """
    commit = subprocess.check_output(["git", "rev-parse", "--short", "HEAD"], text=True).strip()
    run: Results = {
        "commit": commit,
        "terrain": terrain.name,
        "cores": 2,
        "machine": environment((0, 1)),
    }
    found = json.loads(STORED.read_text()) if only else dict(run)
    found.setdefault("runs", {})
    for suite, runs in SUITES.items():
        if only not in (None, suite):
            continue
        found["runs"][suite] = run
        found[suite] = []
        for options in runs:
            click.echo(f"  {suite} {options}", err=True)
            found[suite] += _measured(suite, terrain, options)
    contents = {Path(page): filled(Path(page).read_text(), found).encode() for page in PAGES}
    contents[STORED] = (json.dumps(found, indent=1) + "\n").encode()
    write_all(contents)


def _measured(suite: str, terrain: Path, options: str) -> list[Results]:
    """Rows of a suite, measured in a process of its own."""
    command = [_OURS, "profile" if suite in (MISSION, PEERS) else "evaluate", "--json", "--terrain"]
    if suite == ARCS:
        command = [sys.executable, "-m", "nnpp_edge.benchmarks.arcs"]
    # a missed budget is an exit code, and a row of the table all the same
    ended = subprocess.run([*command, str(terrain), *options.split()], stdout=-1, check=False)
    found = json.loads(ended.stdout)
    of_profile = {MISSION: "results", PEERS: "rows"}
    rows: list[Results] = found[of_profile[suite]] if suite in of_profile else found
    if suite == ARCS:
        return [found]
    if suite == MISSION:
        of_papers = {"int8_speedup": _papers_int8_speedup()}
        return [row | of_papers if row["planner"] == "paper" else row for row in rows]
    return rows


def _papers_int8_speedup() -> float:
    """How many times as fast as fp32 the paper's network is in int8."""
    with TemporaryDirectory() as folder:
        fp32 = f"{folder}/paper-fp32.onnx"
        subprocess.check_output([_OURS, "export", PAPERS_WEIGHTS, "-o", fp32])
        fp32_ms, int8_ms = fp32_and_int8_ms(fp32, "paper")
    return fp32_ms / int8_ms


if __name__ == "__main__":
    main()
