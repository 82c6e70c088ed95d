"""The tables of README and docs/results.md: measured in one run, kept as docs/results.json, written
into the pages.

python -m nnpp_edge.benchmarks.results LUNAR_TERRAIN.tif
"""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from nnpp_edge.benchmarks.arcs import measured
from nnpp_edge.files import write_all
from nnpp_edge.profiling.machine import environment
from nnpp_edge.progress import markdown_table

Results = dict[str, Any]
"""Rows by suite, and where they were measured; or one row of figures."""
Rows = list[Results]
PAGES = "README.md", "docs/results.md"
STORED = Path("docs/results.json")
READY = "ready"
FRESH = "fresh"
BODY = "body"
SUITES = {
    READY: [
        f"--rescale 20 --workload soft,limit20,limit15 --sizes {sizes} --queries {n} --repeats 2"
        " --methods astar,corridor,nnpp"
        for sizes, n in (("256,512", 200), ("1024", 100), ("2048", 40))
    ],
    FRESH: [
        "--rescale 20 --workload soft --sizes 256,512,1024,2048 --queries 40 --repeats 2 "
        "--fresh-map"
    ],
    BODY: [
        "--rescale 0.25 --vehicle small-rover --set length_m=1.5 --set width_m=1.2 --set "
        "clearance_m=0.3"
        " --workload body,body-rocks10 --sizes 256,512 --queries 60 --methods astar,corridor"
    ],
}
"""Options of `nnpp-edge evaluate`, beside the terrain."""
ARCS: Rows = [
    {"size": 256, "radius_m": 2.0, "count": 100},
    {"size": 256, "radius_m": 2.0, "count": 100, "forwards": True},
    {"size": 256, "radius_m": 4.0, "count": 100},
    {"size": 256, "radius_m": 2.0, "count": 100, "fixed": True},
    {"size": 512, "radius_m": 2.0, "count": 100},
    {"size": 512, "radius_m": 4.0, "count": 100},
    {"size": 1024, "radius_m": 2.0, "count": 40},
]
_MARK = re.compile(r"(<!-- results: (\w+) -->\n).*?(\n<!-- end -->)", re.DOTALL)


def _evaluated(terrain: Path, arguments: str) -> Rows:
    """Rows of `nnpp-edge evaluate`, in a process of its own."""
    program = str(Path(sys.executable).with_name("nnpp-edge"))
    command = [program, "evaluate", "--terrain", str(terrain), "--json", *arguments.split()]
    click.echo("  " + " ".join(command[1:]), err=True)
    found: Rows = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    return found


def _ms(row: Results, name: str) -> str:
    return f"{row[name]:.3g}" if row[name] < 1e3 else f"{row[name]:,.0f}"


def _percent(row: Results, *names: str) -> str:
    """In words, one share, or two of which the second stands in brackets."""
    first, *others = (f"{100.0 * row[name]:.2f}" for name in names)
    return f"{first} %" + "".join(f" ({other})" for other in others)


def _by_method(rows: Rows) -> Iterator[dict[str, Results]]:
    """The rows of each workload and size, by method."""
    for key in dict.fromkeys((row["workload"], row["size"]) for row in rows):
        yield {row["method"]: row for row in rows if (row["workload"], row["size"]) == key}


def _ready(found: Results) -> Iterator[Sequence[str]]:
    for each in _by_method(found[READY]):
        row = each["corridor"]
        exact = each["astar"]
        cells = [row["workload"], f"{row['size']}²", str(row["n"]), _ms(exact, "time_ms_median")]
        for name in "corridor", "nnpp":
            row = each[name]
            faster = f"{row['speedup_median']:.1f}, {row['speedup_total']:.1f}"
            cells += [_ms(row, "time_ms_median"), faster, _percent(row, "gap_mean", "gap_p95")]
        yield [*cells, f"{100.0 * each['nnpp']['success_raw']:.1f} %"]


def _fresh(found: Results) -> Iterator[Sequence[str]]:
    for each in _by_method(found[FRESH]):
        cells = [f"{each['astar']['size']}²", str(each["astar"]["n"])]
        for name in "astar", "corridor", "nnpp", "corridor-narrow":
            lazy = each[name]
            eager = each[name + "-eager"]
            cells.append(f"{_ms(lazy, 'fresh_ms_median')} / {_ms(eager, 'fresh_ms_median')}")
            if name != "astar":
                cells.append(_percent(lazy, "fresh_gap_mean"))
        yield cells


def _body(found: Results) -> Iterator[Sequence[str]]:
    for each in _by_method(found[BODY]):
        exact = each["astar"]
        row = each["corridor"]
        times = [
            f"{_ms(one, 'time_ms_median')} ({_ms(one, 'time_ms_p95')})" for one in (exact, row)
        ]
        checks = f"{exact['checks_mean']:,.0f} / {row['checks_mean']:,.0f}"
        name = f"{row['workload']} {row['size']}²"
        yield (
            name,
            str(row["n"]),
            *times,
            _percent(row, "gap_mean", "gap_p95"),
            checks,
            str(row["unsolvable"]),
        )


def _arcs(found: Results) -> Iterator[Sequence[str]]:
    for row in found["arcs"]:
        kind = ", forwards alone" * row["forwards"] + ", heading at the goal" * row["fixed"]
        first = (
            f"{_ms(row, 'first_ms_median')} ({_ms(row, 'first_ms_p95')}, "
            f"{_ms(row, 'first_ms_p99')})"
        )
        cells = [
            f"{row['size']}², R = {row['radius_m']:g} m{kind}",
            f"{row['solved']} of {row['n']}",
        ]
        cells += [_ms(row, "exact_ms_median"), first, _percent(row, "gap_mean", "gap_p95")]
        if not row["ticks"]:
            yield [*cells, "", ""]
            continue
        ticks = (
            f"{_ms(row, 'tick_ms_median')} ({_ms(row, 'tick_ms_p99')}, {_ms(row, 'tick_ms_max')})"
        )
        yield [*cells, _percent(row, "driven_mean", "driven_p95"), ticks]


def _readme(found: Results) -> Iterator[Sequence[str]]:
    def planners(name: str, each: dict[str, Results], kind: str, last: str) -> Sequence[str]:
        def best(method: str) -> Results:
            both = [each[key] for key in (method, method + "-eager") if key in each]
            return min(both, key=lambda row: float(row[kind + "ms_median"]))

        def told(method: str) -> str:
            return f"{_ms(best(method), kind + 'ms_median')}, {_percent(each[method], 'gap_mean')}"

        exact = best("astar")
        return (
            name,
            str(exact["n"]),
            _ms(exact, kind + "ms_median"),
            told("corridor"),
            last or told("nnpp"),
        )

    for each in _by_method(found[READY]):
        if each["astar"]["workload"] == "soft" and each["astar"]["size"] in (256, 1024, 2048):
            yield planners(f"ready cost map, {each['astar']['size']}²", each, "time_", "")
    for each in _by_method(found[FRESH]):
        if each["astar"]["size"] in (1024, 2048):
            narrow = [row for name, row in each.items() if name.startswith("corridor-narrow")]
            least_ms = min(row["fresh_ms_median"] for row in narrow)
            gap = _percent(each["corridor-narrow"], "gap_mean")
            row = planners(f"elevations just arrived, {each['astar']['size']}²", each, "fresh_", "")
            yield *row[:4], f"{row[4]}; the corridor with bands as narrow {least_ms:.3g}, {gap}"
    for each in _by_method(found[BODY]):
        if each["astar"]["workload"] == "body-rocks10":
            name = f"a body of 1.5 × 1.2 m among rocks, {each['astar']['size']}²"
            yield planners(name, each, "time_", "no network is used")
    for row in found["arcs"]:
        if row["size"] == 512 and row["radius_m"] == 2.0:
            times = (
                _ms(row, "exact_ms_median"),
                f"{_ms(row, 'first_ms_median')}, {_percent(row, 'gap_mean')}",
            )
            yield (
                "the same, arcs of 2 m and more, 512²",
                str(row["n"]),
                *times,
                "no network is used",
            )


_LAZY = "lazy / eager"
TABLES: dict[str, tuple[str, Callable[[Results], Iterator[Sequence[str]]]]] = {
    "readme": (" | n | exact A\\* | corridor, no learning | network's region (`nnpp`)", _readme),
    READY: (
        "workload | size | n | exact A\\*, ms | corridor: ms | times as fast | gap | "
        "`nnpp`: ms | times as fast | gap | first region",
        _ready,
    ),
    FRESH: (
        f" | n | exact A\\*: {_LAZY} | corridor: {_LAZY} | gap | `nnpp`: {_LAZY} | gap | "
        f"control `corridor-narrow`: {_LAZY} | gap",
        _fresh,
    ),
    BODY: (
        " | n | exact A\\*, ms | corridor, ms | gap | poses checked | drawn without a path",
        _body,
    ),
    "arcs": (
        " | solved | exact, ms | first plan, ms (p95, p99) | gap | driven | tick, ms (p99, max)",
        _arcs,
    ),
}
"""By the names that stand in the pages: heads of columns, joined, and lines."""


def _stamp(found: Results) -> str:
    machine = found["machine"]
    flags = "AVX-512 and VNNI" if "avx512_vnni" in machine["flags"] else ", ".join(machine["flags"])
    return (
        f"One run of `make results`, commit {found['commit']}, {found['cores']} cores of "
        f"{machine['cpu']} ({flags}),"
        f" Python {machine['python']}."
    )


def filled(page: str, found: Results) -> str:
    """A page with the tables of these results, each between its marks."""

    def table(mark: re.Match[str]) -> str:
        if mark[2] == "stamp":
            return mark[1] + _stamp(found) + mark[3]
        heads, lines = TABLES[mark[2]]
        return mark[1] + markdown_table(heads.split(" | "), list(lines(found))) + mark[3]

    return _MARK.sub(table, page)


@click.command()
@click.argument("terrain", type=click.Path(exists=True, dir_okay=False, path_type=Path))
def main(terrain: Path) -> None:
    """Measure all tables on this terrain and write them into the pages: a quarter of an hour, on a
    quiet machine.
    """
    commit = subprocess.check_output(["git", "rev-parse", "--short", "HEAD"], text=True).strip()
    found: Results = {
        "commit": commit,
        "terrain": terrain.name,
        "cores": 2,
        "machine": environment((0, 1)),
    }
    for name, runs in SUITES.items():
        found[name] = [row for arguments in runs for row in _evaluated(terrain, arguments)]
    for how in ARCS:
        click.echo(f"  arcs {how}", err=True)
        found.setdefault("arcs", []).append(measured((terrain,), **how))
    pages = {Path(page): filled(Path(page).read_text(), found).encode() for page in PAGES}
    write_all({STORED: (json.dumps(found, indent=1) + "\n").encode(), **pages})


if __name__ == "__main__":
    main()
