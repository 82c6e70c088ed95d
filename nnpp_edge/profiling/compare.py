"""Reports of `nnpp-edge profile` beside others: what has become worse, and a row for a table of
boards.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, cast

from nnpp_edge.profiling.contest import Facts
from nnpp_edge.profiling.figures import find
from nnpp_edge.profiling.report import SCHEMA
from nnpp_edge.progress import MISSING, markdown_table
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.reading import parse, read_text, reason

SAME = "same"
BETTER = "better"
WORSE = "worse"
NOISY = "noisy"


class _Compared(NamedTuple):
    """How a figure is compared."""

    name: str
    path: tuple[str, ...]
    """Its keys in a row of results; planners it was not measured of, and older reports, may lack
    it.
    """
    more_is_better: bool = False
    clocked: bool = True
    """Whether a disturbed run may have changed it."""
    least: float = 0.0
    """A change of no more than this counts as none, whatever its share."""
    of_rest: bool = False
    """Shares near 1 are compared by what is missing to 1."""


_FIGURES = (
    _Compared("time_ms median", ("time_ms", "median"), least=0.005),
    _Compared("time_ms mean", ("time_ms", "mean"), least=0.005),
    _Compared("inference_ms median", ("inference_ms_median",), least=0.005),
    _Compared("map_ms median", ("map_ms", "median"), least=0.005),
    _Compared("patch_ms median", ("patch_ms", "median"), least=0.005),
    _Compared("speedup total", ("speedup_total",), more_is_better=True),
    _Compared("gap mean", ("gap_mean",), clocked=False, least=0.0005),
    _Compared(
        "success first",
        ("success_first",),
        more_is_better=True,
        clocked=False,
        least=0.01,
        of_rest=True,
    ),
    _Compared("success", ("success",), more_is_better=True, clocked=False, of_rest=True),
)
"""Medians, means and shares. Tails such as p99 differ from run to run by more than any tolerance of
use.
"""


def read_report(path: Path) -> Facts:
    """A report from its JSON file; InvalidQueryError if it is none of this schema."""
    try:
        report = parse(read_text(path))
    except (OSError, ValueError) as error:
        raise InvalidQueryError(
            f"{path}: wanted a report of nnpp-edge profile ({reason(error)})"
        ) from error
    schema = report.get("schema") if isinstance(report, dict) else None
    if schema != SCHEMA or not isinstance(report.get("results"), list):
        raise InvalidQueryError(
            f"{path}: wanted a report of nnpp-edge profile of schema {SCHEMA}, got {schema!r}"
        )
    return cast(Facts, report)


def compare(before: Facts, after: Facts, tolerance: float) -> Facts:
    """Every figure that both reports have: ``verdict``, ``tolerance``, ``notes`` and ``lines``.

    `tolerance` is the share by which a figure may become worse. A success share may lose so much of
    what is missing to 1. A line's change is above 0 where the figure became worse.
    InvalidQueryError if the reports have no workload, size and planner in common.
    """
    try:
        notes = list(_differences(before, after))
        doubtful = any(_doubt(report) for report in (before, after))
        lines = [
            _line(row, figure, was, now, tolerance, doubtful)
            for row in after["results"]
            if (old := find(before["results"], row["workload"], row["size"], row["planner"]))
            is not None
            for figure in _FIGURES
            if (now := _inside(row, figure.path)) is not None
            and (was := _inside(old, figure.path)) is not None
        ]
    except (KeyError, TypeError, AttributeError, ArithmeticError) as error:
        raise InvalidQueryError(
            f"wanted two reports of nnpp-edge profile, got a damaged one: {error}"
        ) from error
    if not lines:
        raise InvalidQueryError(
            "wanted reports with a workload, size and planner in common, got two without"
        )
    states = {line["verdict"] for line in lines}
    verdict = WORSE if WORSE in states else NOISY if NOISY in states else SAME
    return {"verdict": verdict, "tolerance": tolerance, "notes": notes, "lines": lines}


def _line(
    row: Facts, figure: _Compared, was: float, now: float, tolerance: float, doubtful: bool
) -> Facts:
    worse_by = was - now if figure.more_is_better else now - was
    # of a speed-up the new one, so that twice as slow is the same change for it and for a time
    base = 1.0 - was if figure.of_rest else abs(now if figure.more_is_better else was)
    change = worse_by / base if base else (0.0 if worse_by == 0.0 else float("inf") * worse_by)
    state = SAME
    if abs(worse_by) > figure.least and abs(change) > tolerance:
        state = (NOISY if doubtful and figure.clocked else WORSE) if worse_by > 0.0 else BETTER
    return {
        **{name: row[name] for name in ("workload", "size", "planner")},
        "figure": figure.name,
        "before": was,
        "after": now,
        "change": None if abs(change) == float("inf") else change,
        "verdict": state,
    }


_PLACES = (
    ("the CPU", ("environment", "cpu")),
    ("the cores", ("cores",)),
    ("the governor", ("environment", "governor")),
    ("the queries", ("profile", "load")),
    ("the networks", ("profile", "networks")),
    ("onnxruntime", ("environment", "packages", "onnxruntime")),
)
"""Facts that must be equal in two reports, in words and as keys."""


def _differences(before: Facts, after: Facts) -> Iterator[str]:
    """Reasons why the reports are hard to compare."""
    for words, path in _PLACES:
        was, now = (_inside(report, path) for report in (before, after))
        if was != now:
            told = ", then ".join(json.dumps(each, ensure_ascii=False) for each in (was, now))
            yield f"{words} differ" + ("s" if words[-1] != "s" else "") + f": {told}"
    for words, report in (("first", before), ("second", after)):
        if doubt := _doubt(report):
            yield f"the {words} run was {doubt}"


def _doubt(report: Facts) -> str:
    """Reasons to doubt a report's times; empty where nothing does. Older reports tell nothing of
    sensors.
    """
    if report["disturbance"]["words"]:
        return f"disturbed: {report['disturbance']['words']}"
    slowed = _inside(report, ("sensors", "throttled"))
    return f"throttled: {slowed}" if slowed else ""


def _inside(facts: Facts | None, path: tuple[str, ...]) -> float | None:
    """The value at the end of these keys; None where one is missing."""
    for key in path[:-1]:
        facts = facts and facts.get(key)
    return facts.get(path[-1]) if facts else None


def board_table(report: Facts) -> str:
    """The report's row for the table in docs/boards.md, below that table's header."""
    cells = {name: cell.replace("|", "\\|") for name, cell in board(report).items()}
    return markdown_table([*cells], [[*cells.values()]])


def board(report: Facts) -> dict[str, str]:
    """The report's words for each column of the table in docs/boards.md."""
    facts = report["environment"]
    sensors = report["sensors"]
    results = report["results"]
    workload = results[0]["workload"]
    clocks = sensors["clock_mhz"].values()

    def medians(planner: str, key: str = "time_ms") -> str:
        """Milliseconds by size, at the profile's first workload."""
        rows = [
            row
            for row in results
            if (row["workload"], row["planner"]) == (workload, planner) and row[key]
        ]
        return " · ".join(f"{row['size']}² {row[key]['median']:.3g}" for row in rows) or MISSING

    greatest = MISSING if facts["clock_mhz"] is None else f"{facts['clock_mhz']:.0f} MHz"
    ran = "not told while it ran"
    if clocks:
        ran = (
            f"ran at {min(each['min'] for each in clocks):.0f} to "
            f"{max(each['max'] for each in clocks):.0f}"
        )
    versions = (
        f"{name} {facts['packages'][name]}"
        for name in ("nnpp-edge", "numpy", "numba", "onnxruntime")
    )
    others = max(
        max(half["waited_share"], half["others_share"] or 0.0)
        for half in report["disturbance"]["halves"]
    )
    return {
        "date": report["made"][:10],
        "processor": facts["cpu"],
        "cores": f"{len(report['cores'])} of {facts['cores_online'] or '?'}",
        "flags": ", ".join(facts["flags"]) or MISSING,
        "clock": f"{greatest}, {ran}",
        "memory": f"{facts['memory_mb'] / 1024:.1f} GiB",
        "system": f"{facts['system'] or 'Linux'}, kernel {facts['kernel']}, "
        f"{facts['architecture']}",
        "versions": f"python {facts['python']}, {', '.join(versions)}",
        "profile": f"{report['profile']['name']}: {workload}",
        "A*, ms": medians("astar"),
        "corridor, ms": medians("corridor"),
        "nnpp int8, ms": medians("nnpp"),
        "nnpp fp32, ms": medians("nnpp-fp32"),
        "auto, ms": medians("auto"),
        "first path of a map, ms": medians(report["profile"]["planner"], "map_ms"),
        "verdict": report["verdict"],
        "others took": f"{100 * others:.1f} %",
        "throttled": sensors["throttled"]
        or ("no" if clocks or sensors["temperature_c"] else "not told"),
    }
