"""The tables of README and docs/results.md: measured in one run, stored as docs/results.json, and
written into the pages.

python -m nnpp_edge.benchmarks.results LUNAR_TERRAIN.tif
python -m nnpp_edge.benchmarks.results LUNAR_TERRAIN.tif --only mission

The mission needs the extra `train`: the paper's network, which is shipped in int8 only, is exported
to be timed in fp32 beside it.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import jinja2

from nnpp_edge.files import write_all
from nnpp_edge.profiling.inference import fp32_and_int8_ms
from nnpp_edge.profiling.machine import environment
from nnpp_edge.progress import shown

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


def filled(page: str, found: Results) -> str:
    """A page with the tables of these results, each between its marks."""
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined)
    environment.filters |= {"f": shown, "ms": _milliseconds}
    template = environment.from_string(Path(__file__).with_name("results.md.j2").read_text())
    rows = {f"{row['planner']}-{row['size']}": row for row in found[MISSION]}
    groups = {suite: _by_method(found[suite]) for suite in (READY, FRESH, BODY)}
    tables = template.make_module({"found": found, "rows": rows, "groups": groups})

    def table(mark: re.Match[str]) -> str:
        begin, name, end = mark.groups()
        text: str = getattr(tables, name)()
        return begin + text.strip() + end

    return _MARK.sub(table, page)


def _by_method(rows: Iterable[Results]) -> list[Results]:
    """The rows of each workload and size by method."""
    groups: dict[object, Results] = {}
    for row in rows:
        groups.setdefault((row["workload"], row["size"]), {})[row["method"]] = row
    return list(groups.values())


def _milliseconds(value: float | None) -> str:
    """Three digits, or a whole number; a dash where it was not measured."""
    return shown(value, ",.0f" if value and value >= 1e3 else ".3g")


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
