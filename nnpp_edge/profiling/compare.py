"""Two reports of `nnpp-edge profile` beside each other: what has become worse."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from nnpp_edge.profiling.report import SCHEMA
from nnpp_edge.profiling.report_format import ComparedLine, Comparison, Report, ResultRow, find
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.reading import parse, read_text, reason

SAME, BETTER, WORSE, NOISY = "same", "better", "worse", "noisy"


@dataclass(frozen=True)
class Compared:
    """How a figure is compared."""

    name: str
    path: tuple[str, ...]
    """Its keys in a row of results."""
    more_is_better: bool = False
    clocked: bool = True
    """Whether a disturbed run may have changed it."""
    least: float = 0.0
    """A change of no more than this counts as none, whatever its share."""
    of_rest: bool = False
    """Shares near 1 are compared by what is missing to 1."""
    optional: bool = False
    """Whether there are rows without it: of planners that it was not measured of, and of older reports."""


FIGURES = (
    Compared("time_ms median", ("time_ms", "median"), least=0.005),
    Compared("time_ms mean", ("time_ms", "mean"), least=0.005),
    Compared("inference_ms median", ("inference_ms_median",), least=0.005),
    Compared("map_ms median", ("map_ms", "median"), least=0.005, optional=True),
    Compared("patch_ms median", ("patch_ms", "median"), least=0.005, optional=True),
    Compared("speedup total", ("speedup_total",), more_is_better=True),
    Compared("gap mean", ("gap_mean",), clocked=False, least=0.0005),
    Compared("success first", ("success_first",), more_is_better=True, clocked=False, least=0.01, of_rest=True),
    Compared("success", ("success",), more_is_better=True, clocked=False, of_rest=True),
)
"""Medians, means and shares. Tails such as p99 differ from run to run by more than any tolerance of use."""


def read_report(path: Path) -> Report:
    """A report from its JSON file; InvalidQueryError if it is none of this schema."""
    try:
        report = parse(read_text(path))
    except (OSError, ValueError) as error:
        raise InvalidQueryError(f"{path}: wanted a report of nnpp-edge profile ({reason(error)})") from error
    schema = report.get("schema") if isinstance(report, dict) else None
    if schema != SCHEMA or not isinstance(report.get("results"), list):
        raise InvalidQueryError(f"{path}: wanted a report of nnpp-edge profile of schema {SCHEMA}, got {schema!r}")
    return cast(Report, report)


def compare(before: Report, after: Report, tolerance: float) -> Comparison:
    """Every figure that both reports have, as ``comparison`` in docs/profile.md.

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
            for figure in FIGURES
            if (now := _value(row, figure)) is not None and (was := _value(old, figure)) is not None
        ]
    except (KeyError, TypeError, AttributeError, ArithmeticError) as error:
        raise InvalidQueryError(f"wanted two reports of nnpp-edge profile, got a damaged one: {error}") from error
    if not lines:
        raise InvalidQueryError("wanted reports with a workload, size and planner in common, got two without")
    states = {line["verdict"] for line in lines}
    verdict = WORSE if WORSE in states else NOISY if NOISY in states else SAME
    return Comparison(verdict=verdict, tolerance=tolerance, notes=notes, lines=lines)


def _line(row: ResultRow, figure: Compared, was: float, now: float, tolerance: float, doubtful: bool) -> ComparedLine:
    worse_by = was - now if figure.more_is_better else now - was
    base = 1.0 - was if figure.of_rest else abs(was)
    if figure.more_is_better and not figure.of_rest:
        base = abs(now)  # so that twice as slow is the same change for a time and for a speed-up
    change = worse_by / base if base else (0.0 if worse_by == 0.0 else float("inf") * worse_by)
    state = SAME
    if abs(worse_by) > figure.least and abs(change) > tolerance:
        state = (NOISY if doubtful and figure.clocked else WORSE) if worse_by > 0.0 else BETTER
    return ComparedLine(
        workload=row["workload"],
        size=row["size"],
        planner=row["planner"],
        figure=figure.name,
        before=was,
        after=now,
        change=change if abs(change) != float("inf") else None,
        verdict=state,
    )


def _value(row: ResultRow, figure: Compared) -> float | None:
    value: object = row
    if figure.optional and row.get(figure.path[0]) is None:
        return None
    for key in figure.path:
        value = cast(Mapping[str, object], value)[key]
    return cast(float | None, value)


_PLACES = (
    ("the CPU", ("environment", "cpu")),
    ("the cores", ("cores",)),
    ("the governor", ("environment", "governor")),
    ("the queries", ("profile", "load")),
    ("the networks", ("profile", "networks")),
    ("onnxruntime", ("environment", "packages", "onnxruntime")),
)
"""Facts that must be equal in two reports, in words and as keys."""


def _differences(before: Report, after: Report) -> Iterator[str]:
    """Reasons why the reports are hard to compare."""
    for words, path in _PLACES:
        was, now = (_inside(report, path) for report in (before, after))
        if was != now:
            yield f"{words} differ" + ("s" if words[-1] != "s" else "") + f": {_short(was)}, then {_short(now)}"
    for words, report in (("first", before), ("second", after)):
        if doubt := _doubt(report):
            yield f"the {words} run was {doubt}"


def _doubt(report: Report) -> str:
    """Reasons to doubt a report's times; empty where nothing does. Older reports tell nothing of sensors."""
    if report["disturbance"]["words"]:
        return f"disturbed: {report['disturbance']['words']}"
    slowed = _inside(report, ("sensors", "throttled"))
    return f"throttled: {slowed}" if slowed else ""


def _inside(report: Report, path: tuple[str, ...]) -> object:
    value: object = report
    for key in path:
        value = cast(Mapping[str, object], value).get(key) or {}
    return value


def _short(value: object) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, dict | list) else str(value)
