"""Reports of `nnpp-edge profile` beside others: what has become worse, and a row for a table of
boards.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, cast

from nnpp_edge.profiling.report import SCHEMA
from nnpp_edge.profiling.rows import PLACE, Facts
from nnpp_edge.progress import MISSING, markdown_table, shown
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.reading import parse, read_text, refused_as

SAME = "same"
BETTER = "better"
WORSE = "worse"
NOISY = "noisy"


class _Compared(NamedTuple):
    """How a figure is compared."""

    name: str
    path: str
    """Its keys in a row of results, joined by dots; planners it was not measured of, and older
    reports, may lack it.
    """
    more_is_better: bool = False
    clocked: bool = True
    """Whether a disturbed run may have changed it."""
    least: float = 0.0
    """A change of no more than this counts as none, whatever its share."""
    of_rest: bool = False
    """Shares near 1 are compared by what is missing to 1."""


_FIGURES = (
    _Compared("time_ms median", "time_ms.median", least=0.005),
    _Compared("time_ms mean", "time_ms.mean", least=0.005),
    _Compared("inference_ms median", "inference_ms_median", least=0.005),
    _Compared("map_ms median", "map_ms.median", least=0.005),
    _Compared("patch_ms median", "patch_ms.median", least=0.005),
    _Compared("speedup total", "speedup_total", True),
    _Compared("gap mean", "gap_mean", clocked=False, least=0.0005),
    _Compared("success first", "success_first", True, False, least=0.01, of_rest=True),
    _Compared("success", "success", True, False, of_rest=True),
)
"""Medians, means and shares. Tails such as p99 differ from run to run by more than any tolerance of
use.
"""


def read_report(path: Path) -> Facts:
    """Read a report from its JSON file; InvalidQueryError if it is none of this schema."""
    with refused_as(InvalidQueryError, f"{path}: wanted a report of nnpp-edge profile"):
        report = parse(read_text(path))
    schema = report.get("schema") if isinstance(report, dict) else None
    if schema != SCHEMA or not isinstance(report.get("results"), list):
        raise InvalidQueryError(
            f"{path}: wanted a report of nnpp-edge profile of schema {SCHEMA}, got {schema!r}"
        )
    return cast(Facts, report)


def compare(before: Facts, after: Facts, tolerance: float) -> Facts:
    """Compare every figure that both reports have: ``verdict``, ``tolerance``, ``notes`` and
    ``lines``.

    `tolerance` is the share by which a figure may become worse, and must become better to count as
    better: of a time the new over the old one, less 1, for worse, and the old over the new one,
    less 1, for better. A success share counts by what is missing to 1. A line's change is that,
    above 0 where the figure became worse, below 0 where it became better. InvalidQueryError if the
    reports have no workload, size and planner in common."""
    lines = []
    with refused_as(
        InvalidQueryError,
        "wanted two reports of nnpp-edge profile, got a damaged one",
    ):
        notes = list(_differences(before, after))
        doubtful = bool(_doubt(before) or _doubt(after))
        old = {PLACE(row): row for row in before["results"]}
        for row in after["results"]:
            for figure in _FIGURES:
                was = _inside(old.get(PLACE(row)), figure.path)
                now = _inside(row, figure.path)
                if was is not None and now is not None:
                    lines.append(_line(row, figure, was, now, tolerance, doubtful))
    if not lines:
        raise InvalidQueryError(
            "wanted reports with a workload, size and planner in common, got two without"
        )
    states = {line["verdict"] for line in lines}
    verdict = next((state for state in (WORSE, NOISY) if state in states), SAME)
    return {"verdict": verdict, "tolerance": tolerance, "notes": notes, "lines": lines}


def _line(
    row: Facts,
    figure: _Compared,
    was: float,
    now: float,
    tolerance: float,
    doubtful: bool,
) -> Facts:
    worse_by = was - now if figure.more_is_better else now - was
    # over the smaller of both: twice as slow and twice as fast are the same change
    both = (1.0 - was, 1.0 - now) if figure.of_rest else (was, now)
    base = min(map(abs, both))
    change = worse_by / base if base else None
    state = SAME
    if abs(worse_by) > figure.least and (change is None or abs(change) > tolerance):
        state = BETTER
        if worse_by > 0.0:
            state = NOISY if doubtful and figure.clocked else WORSE
    return {
        **{key: row[key] for key in ("workload", "size", "planner")},
        "figure": figure.name,
        "before": was,
        "after": now,
        "change": change if worse_by else 0.0,
        "verdict": state,
    }


_ALIKE = {
    "the CPU differs": "environment.cpu",
    "the cores differ": "cores",
    "the governor differs": "environment.governor",
    "the queries differ": "profile.load",
    "the networks differ": "profile.networks",
    "onnxruntime differs": "environment.packages.onnxruntime",
}
"""Facts that must be equal in two reports: what is said where they are not, and their keys."""


def _differences(before: Facts, after: Facts) -> Iterator[str]:
    """Reasons why the reports are hard to compare."""
    for words, path in _ALIKE.items():
        values = [json.dumps(_inside(each, path), ensure_ascii=False) for each in (before, after)]
        if values[0] != values[1]:
            yield f"{words}: {', then '.join(values)}"
    for words, report in (("first", before), ("second", after)):
        doubt = _doubt(report)
        if doubt:
            yield f"the {words} run was {doubt}"


def _doubt(report: Facts) -> str:
    """Reasons to doubt a report's times; empty where nothing does. Older reports tell nothing of
    sensors.
    """
    words = report["disturbance"]["words"]
    slowed = _inside(report, "sensors.throttled")
    if words:
        return f"disturbed: {words}"
    return f"throttled: {slowed}" if slowed else ""


def _inside(facts: Facts | None, path: str) -> float | None:
    """The value at the end of these keys, joined by dots; None where one is missing."""
    *keys, last = path.split(".")
    for key in keys:
        facts = facts and facts.get(key)
    return facts.get(last) if facts else None


def board_table(report: Facts) -> str:
    """The report's row for the table in docs/boards.md, below that table's header."""
    cells = board(report)
    return markdown_table([*cells], [[*cells.values()]])


def board(report: Facts) -> dict[str, str]:
    """The report's words for each column of the table in docs/boards.md."""
    results = report["results"]
    workload = results[0]["workload"]

    def medians(planner: str, key: str = "time_ms") -> str:
        """Milliseconds by size, at the profile's first workload."""
        found = []
        for row in results:
            if row["workload"] == workload and row["planner"] == planner and row[key]:
                found.append(f"{row['size']}² {row[key]['median']:.3g}")
        return " · ".join(found) or MISSING

    machine = machine_words(report)
    profile = report["profile"]
    return {
        "date": report["made"][:10],
        **{name: machine[name] for name in _MACHINE},
        "profile": f"{profile['name']}: {workload}",
        "A*, ms": medians("astar"),
        "corridor, ms": medians("corridor"),
        "nnpp int8, ms": medians("nnpp"),
        "nnpp fp32, ms": medians("nnpp-fp32"),
        "auto, ms": medians("auto"),
        "first path of a map, ms": medians(profile["planner"], "map_ms"),
        "verdict": report["verdict"],
        "others took": machine["others took"],
        "throttled": machine["throttled"],
    }


_MACHINE = ("processor", "cores", "flags", "clock", "memory", "system", "versions")
"""Columns of the table of boards."""
_WHOLE_RUN = (
    ("peak_memory_mb", "peak memory", "MB"),
    ("model_mb", "model", "MB"),
    ("prior_ms", "prices of 64² unseen blocks", "ms"),
    *(
        (f"{key}_{state}_{end}", f"{name} {state}{of}", unit)
        for key, name in (("start_up", "first plan"), ("first_tick", "first tick"))
        for state in ("cold", "warm")
        for end, of, unit in (("s", "", "s"), ("mb", ", peak", "MB"))
    ),
)
"""Key, name and unit of what there is one figure of for each planner."""


def machine_words(report: Facts) -> dict[str, str]:
    """The machine of a run, and how it ran, in words."""
    facts = report["environment"]
    sensors = report["sensors"]
    clocks = sensors["clock_mhz"].values()
    greatest = MISSING if facts["clock_mhz"] is None else f"{facts['clock_mhz']:.0f} MHz"
    ran = "not told while it ran"
    if clocks:
        least = min(each["min"] for each in clocks)
        most = max(each["max"] for each in clocks)
        ran = f"ran at {least:.0f} to {most:.0f}"
    versions = {"python": facts["python"]} | facts["packages"]
    named = ("python", "nnpp-edge", "numpy", "numba", "onnxruntime")
    halves = report["disturbance"]["halves"]
    shares = [half[key] or 0.0 for half in halves for key in ("waited_share", "others_share")]
    throttled = "no" if clocks or sensors["temperature_c"] else "not told"
    words = {
        "processor": facts["cpu"],
        "cores": f"{len(report['cores'])} of {facts['cores_online'] or '?'}",
        "flags": ", ".join(facts["flags"]) or MISSING,
        "clock": f"{greatest}, {ran}",
        "memory": f"{facts['memory_mb'] / 1024:.1f} GiB",
        "system": f"{facts['system'] or 'Linux'}, kernel {facts['kernel']}, "
        f"{facts['architecture']}",
        "versions": ", ".join(f"{name} {versions.get(name)}" for name in named),
        "others took": f"{100 * max(shares):.1f} %",
        "throttled": sensors["throttled"] or throttled,
        "governor": ", ".join(facts["governor"] or ()),
        "load": " ".join(map(str, facts["load_average"])),
    }
    for key, name, unit in _WHOLE_RUN:
        by_planner = report["besides"].get(key) or {}
        figures = [f"{who} {shown(value)} {unit}" for who, value in by_planner.items()]
        words[name] = ", ".join(figures)
    zones = sensors["temperature_c"].items()
    ranges = (f"{zone} {shown(each['min'])} to {shown(each['max'])} °C" for zone, each in zones)
    words["temperature"] = ", ".join(ranges)
    return {name: value for name, value in words.items() if value}
