"""Reports of `nnpp-edge profile` beside others: what has become worse, and a row for a table of boards."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, cast

from nnpp_edge.profiling.contest import Facts
from nnpp_edge.profiling.figures import find
from nnpp_edge.profiling.report import SCHEMA
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.reading import parse, read_text, reason

SAME, BETTER, WORSE, NOISY = "same", "better", "worse", "noisy"


class _Compared(NamedTuple):
    """How a figure is compared."""

    name: str
    path: tuple[str, ...]
    """Its keys in a row of results; planners it was not measured of, and older reports, may lack it."""
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
    _Compared("success first", ("success_first",), more_is_better=True, clocked=False, least=0.01, of_rest=True),
    _Compared("success", ("success",), more_is_better=True, clocked=False, of_rest=True),
)
"""Medians, means and shares. Tails such as p99 differ from run to run by more than any tolerance of use."""


def read_report(path: Path) -> Facts:
    """A report from its JSON file; InvalidQueryError if it is none of this schema."""
    try:
        report = parse(read_text(path))
    except (OSError, ValueError) as error:
        raise InvalidQueryError(f"{path}: wanted a report of nnpp-edge profile ({reason(error)})") from error
    schema = report.get("schema") if isinstance(report, dict) else None
    if schema != SCHEMA or not isinstance(report.get("results"), list):
        raise InvalidQueryError(f"{path}: wanted a report of nnpp-edge profile of schema {SCHEMA}, got {schema!r}")
    return cast(Facts, report)


def compare(before: Facts, after: Facts, tolerance: float) -> Facts:
    """Every figure that both reports have: ``verdict``, ``tolerance``, ``notes`` and ``lines``.

    `tolerance` is the share by which a figure may become worse. A success share may lose so much of what is missing
    to 1. A line's change is above 0 where the figure became worse. InvalidQueryError if the reports have no workload,
    size and planner in common.
    """
    try:
        notes = list(_differences(before, after))
        doubtful = any(_doubt(report) for report in (before, after))
        lines = [
            _line(row, figure, was, now, tolerance, doubtful)
            for row in after["results"]
            if (old := find(before["results"], row["workload"], row["size"], row["planner"])) is not None
            for figure in _FIGURES
            if (now := _inside(row, figure.path)) is not None and (was := _inside(old, figure.path)) is not None
        ]
    except (KeyError, TypeError, AttributeError, ArithmeticError) as error:
        raise InvalidQueryError(f"wanted two reports of nnpp-edge profile, got a damaged one: {error}") from error
    if not lines:
        raise InvalidQueryError("wanted reports with a workload, size and planner in common, got two without")
    states = {line["verdict"] for line in lines}
    verdict = WORSE if WORSE in states else NOISY if NOISY in states else SAME
    return {"verdict": verdict, "tolerance": tolerance, "notes": notes, "lines": lines}


def _line(row: Facts, figure: _Compared, was: float, now: float, tolerance: float, doubtful: bool) -> Facts:
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
            yield f"{words} differ" + ("s" if words[-1] != "s" else "") + f": {_short(was)}, then {_short(now)}"
    for words, report in (("first", before), ("second", after)):
        if doubt := _doubt(report):
            yield f"the {words} run was {doubt}"


def _doubt(report: Facts) -> str:
    """Reasons to doubt a report's times; empty where nothing does. Older reports tell nothing of sensors."""
    if report["disturbance"]["words"]:
        return f"disturbed: {report['disturbance']['words']}"
    slowed = _inside(report, ("sensors", "throttled"))
    return f"throttled: {slowed}" if slowed else ""


def _inside(facts: Facts | None, path: tuple[str, ...]) -> float | None:
    """The value at the end of these keys; None where one is missing."""
    for key in path[:-1]:
        facts = facts and facts.get(key)
    return facts.get(path[-1]) if facts else None


def _short(value: object) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, dict | list) else str(value)


def board_header() -> str:
    """The first two lines, in Markdown, of the table in docs/boards.md."""
    return f"{_board_line(list(BOARD_COLUMNS))}\n{_board_line(['---'] * len(BOARD_COLUMNS))}"


def board_row(report: Facts) -> str:
    """The report's line of the table."""
    return _board_line([cell(report) for cell in BOARD_COLUMNS.values()])


def _board_line(cells: list[str]) -> str:
    return "| " + " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells) + " |"


def _clock(report: Facts) -> str:
    """The greatest clock, and the lowest and greatest that were read while planners ran."""
    seen, known = report["sensors"]["clock_mhz"].values(), report["environment"]["clock_mhz"]
    lows, highs = ([each[name] for each in seen] for name in ("min", "max"))
    read = f"ran at {min(lows):.0f} to {max(highs):.0f}" if lows else "not told while it ran"
    return ("–" if known is None else f"{known:.0f} MHz") + f", {read}"


def _medians(planner: str | None, key: str = "time_ms") -> Callable[[Facts], str]:
    """Medians in milliseconds by size, at the profile's first workload; None for the profile's planner."""

    def cell(report: Facts) -> str:
        place = report["results"][0]["workload"], planner or report["profile"]["planner"]
        rows = [row for row in report["results"] if (row["workload"], row["planner"]) == place]
        return " · ".join(f"{row['size']}² {row[key]['median']:.3g}" for row in rows if row[key]) or "–"

    return cell


def _system(facts: Facts) -> str:
    return f"{facts['system'] or 'Linux'}, kernel {facts['kernel']}, {facts['architecture']}"


def _versions(facts: Facts) -> str:
    names = ("nnpp-edge", "numpy", "numba", "onnxruntime")
    return ", ".join([f"python {facts['python']}", *(f"{name} {facts['packages'][name]}" for name in names)])


def _others(report: Facts) -> str:
    halves = report["disturbance"]["halves"]
    return f"{100 * max(max(half['waited_share'], half['others_share'] or 0.0) for half in halves):.1f} %"


def _throttled(sensors: Facts) -> str:
    told = sensors["clock_mhz"] or sensors["temperature_c"]
    return sensors["throttled"] or ("no" if told else "not told")


BOARD_COLUMNS: dict[str, Callable[[Facts], str]] = {
    "date": lambda report: report["made"][:10],
    "processor": lambda report: report["environment"]["cpu"],
    "cores": lambda report: f"{len(report['cores'])} of {report['environment']['cores_online'] or '?'}",
    "flags": lambda report: ", ".join(report["environment"]["flags"]) or "–",
    "clock": _clock,
    "memory": lambda report: f"{report['environment']['memory_mb'] / 1024:.1f} GiB",
    "system": lambda report: _system(report["environment"]),
    "versions": lambda report: _versions(report["environment"]),
    "profile": lambda report: f"{report['profile']['name']}: {report['results'][0]['workload']}",
    "A*, ms": _medians("astar"),
    "corridor, ms": _medians("corridor"),
    "nnpp int8, ms": _medians("nnpp"),
    "nnpp fp32, ms": _medians("nnpp-fp32"),
    "auto, ms": _medians("auto"),
    "first path of a map, ms": _medians(None, "map_ms"),
    "verdict": lambda report: report["verdict"],
    "others took": _others,
    "throttled": lambda report: _throttled(report["sensors"]),
}
"""Heading of each column, and what a report has to say in it."""
