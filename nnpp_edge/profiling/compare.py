"""Reports of `nnpp-edge profile` beside others: what has become worse, and a row for a table of
boards.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import cast

from nnpp_edge.profiling.judge import value_of
from nnpp_edge.profiling.report import SCHEMA
from nnpp_edge.profiling.rows import PLACE, Facts
from nnpp_edge.progress import MISSING, markdown_table, shown
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.reading import parse, read_text, refused_as

SAME = "same"
BETTER = "better"
WORSE = "worse"
NOISY = "noisy"


_FIGURES = """
time_ms median      | time_ms_median      | 0.005  | time
time_ms mean        | time_ms_mean        | 0.005  | time
inference_ms median | inference_ms_median | 0.005  | time
map_ms median       | map_ms              | 0.005  | time
patch_ms median     | patch_ms            | 0.005  | time
speedup total       | speedup_total       | 0      | time, more
gap mean            | gap_mean            | 0.0005 |
success first       | success_first       | 0.01   | more, rest
success             | success             | 0      | more, rest
"""
"""What is compared: its name, the figure of a row, the change up to which it counts as the same,
whatever its share; whether a disturbed run may have changed it (time), whether more of it is
better, and whether it is near 1 and compared by what is missing (rest). Tails such as p99 differ
from run to run by more than any tolerance of use.
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
            for line in _FIGURES.strip().splitlines():
                name, figure, least, kind = (cell.strip() for cell in line.split("|"))
                was = value_of(old.get(PLACE(row), {}), figure)
                now = value_of(row, figure)
                if was is not None and now is not None:
                    change, state = _changed(was, now, float(least), kind, tolerance)
                    if doubtful and state == WORSE and "time" in kind:
                        state = NOISY
                    place = {key: row[key] for key in ("workload", "size", "planner")}
                    told = {"figure": name, "before": was, "after": now}
                    lines.append({**place, **told, "change": change, "verdict": state})
    if not lines:
        raise InvalidQueryError(
            "wanted reports with a workload, size and planner in common, got two without"
        )
    states = {line["verdict"] for line in lines}
    verdict = next((state for state in (WORSE, NOISY) if state in states), SAME)
    return {"verdict": verdict, "tolerance": tolerance, "notes": notes, "lines": lines}


def _changed(
    was: float, now: float, least: float, kind: str, tolerance: float
) -> tuple[float | None, str]:
    """By which share a figure became worse, None where that was 0, and its verdict."""
    worse_by = was - now if "more" in kind else now - was
    # over the smaller of both: twice as slow and twice as fast are the same change
    both = (1.0 - was, 1.0 - now) if "rest" in kind else (was, now)
    base = min(map(abs, both))
    change = worse_by / base if base else None
    if abs(worse_by) <= least or (change is not None and abs(change) <= tolerance):
        return change if worse_by else 0.0, SAME
    return change, WORSE if worse_by > 0.0 else BETTER


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
