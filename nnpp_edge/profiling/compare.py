"""Two reports of `nnpp-edge profile` beside each other: what has become worse."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nnpp_edge.profiling.figures import find
from nnpp_edge.profiling.report import SCHEMA
from nnpp_edge.runtime.errors import InvalidQueryError

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


FIGURES = (
    Compared("time_ms median", ("time_ms", "median"), least=0.005),
    Compared("time_ms mean", ("time_ms", "mean"), least=0.005),
    Compared("inference_ms median", ("inference_ms_median",), least=0.005),
    Compared("speedup total", ("speedup_total",), more_is_better=True),
    Compared("gap mean", ("gap_mean",), clocked=False, least=0.0005),
    Compared("success first", ("success_first",), more_is_better=True, clocked=False, least=0.01, of_rest=True),
    Compared("success", ("success",), more_is_better=True, clocked=False, of_rest=True),
)
"""Medians, means and shares. Tails such as p99 differ from run to run by more than any tolerance of use."""


def read_report(path: Path) -> dict[str, Any]:
    """A report from its JSON file; InvalidQueryError if it is none of this schema."""
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or f"no JSON: {error}"
        raise InvalidQueryError(f"{path}: wanted a report of nnpp-edge profile --json ({reason})") from error
    schema = told.get("schema") if isinstance(told, dict) else None
    if schema != SCHEMA or not isinstance(told.get("results"), list):
        raise InvalidQueryError(f"{path}: wanted a report of nnpp-edge profile of schema {SCHEMA}, got {schema!r}")
    return told


def compare(before: Mapping[str, Any], after: Mapping[str, Any], tolerance: float) -> dict[str, Any]:
    """Every figure that both reports have.

    Parameters
    ----------
    before, after : mapping
        Reports.
    tolerance : float
        Share by which a figure may become worse. A success share may lose so much of what is missing to 1.

    Returns
    -------
    dict
        ``verdict`` (worse, noisy or same), ``notes`` and ``lines``: workload, size, planner, figure, before,
        after, change (share, above 0 where it became worse), verdict.

    Raises
    ------
    InvalidQueryError
        They have no workload, size and planner in common.
    """
    notes = list(_differences(before, after))
    doubtful = any(report["disturbance"]["words"] for report in (before, after))
    try:
        lines = [
            _line(row, old, figure, tolerance, doubtful)
            for row in after["results"]
            if (old := find(before["results"], row["workload"], row["size"], row["planner"])) is not None
            for figure in FIGURES
            if _figure(row, figure) is not None and _figure(old, figure) is not None
        ]
    except (KeyError, TypeError, AttributeError) as error:
        raise InvalidQueryError(f"wanted two reports of nnpp-edge profile, got a damaged one: {error}") from error
    if not lines:
        raise InvalidQueryError("wanted reports with a workload, size and planner in common, got two without")
    states = {line["verdict"] for line in lines}
    return {
        "verdict": WORSE if WORSE in states else NOISY if NOISY in states else SAME,
        "tolerance": tolerance, "notes": notes, "lines": lines,
    }  # fmt: skip


def _line(
    row: Mapping[str, Any], old: Mapping[str, Any], figure: Compared, tolerance: float, doubtful: bool
) -> dict[str, Any]:  # fmt: skip
    was, now = _figure(old, figure), _figure(row, figure)
    worse_by = was - now if figure.more_is_better else now - was
    base = 1.0 - was if figure.of_rest else abs(was)
    if figure.more_is_better and not figure.of_rest:
        base = abs(now)  # so that twice as slow is the same change for a time and for a speed-up
    change = worse_by / base if base else (0.0 if worse_by == 0.0 else float("inf") * worse_by)
    state = SAME
    if abs(worse_by) > figure.least and abs(change) > tolerance:
        state = (NOISY if doubtful and figure.clocked else WORSE) if worse_by > 0.0 else BETTER
    return {
        "workload": row["workload"], "size": row["size"], "planner": row["planner"], "figure": figure.name,
        "before": was, "after": now, "change": change if abs(change) != float("inf") else None, "verdict": state,
    }  # fmt: skip


def _figure(row: Mapping[str, Any], figure: Compared) -> Any:
    value: Any = row
    for key in figure.path:
        value = value[key]
    return value


def _differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    """What makes the reports hard to compare."""
    places = (
        ("the CPU", ("environment", "cpu")), ("the cores", ("cores",)), ("the governor", ("environment", "governor")),
        ("the queries", ("profile", "load")), ("the networks", ("profile", "networks")),
        ("onnxruntime", ("environment", "packages", "onnxruntime")),
    )  # fmt: skip
    for words, path in places:
        was, now = before, after
        for key in path:
            was, now = was.get(key) or {}, now.get(key) or {}
        if was != now:
            yield f"{words} differ" + ("s" if words[-1] != "s" else "") + f": {_short(was)}, then {_short(now)}"
    for words, report in (("first", before), ("second", after)):
        if report["disturbance"]["words"]:
            yield f"the {words} run was disturbed: {report['disturbance']['words']}"


def _short(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, dict | list) else str(value)
