"""Reports of `nnpp-edge profile` beside each other: what has become worse, and the machine of each
in words.
"""

from pathlib import Path
from typing import cast

from nnpp_edge.profiling.judge import Noise, judged, noise_of, summary, value_of, verdict
from nnpp_edge.profiling.profile_file import Budget, Profile
from nnpp_edge.profiling.quantities import QUANTITIES
from nnpp_edge.profiling.report import SCHEMA
from nnpp_edge.profiling.rows import PLACE, Facts
from nnpp_edge.profiling.sensors import Throttling
from nnpp_edge.progress import shown, with_unit
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.reading import parse, read_text, refused_as

COMPARED = {
    "time_ms_median": 0.005,
    "inference_ms_median": 0.005,
    "map_ms": 0.005,
    "patch_ms": 0.005,
    "speedup_total": 0.0,
    "gap_mean": 0.0005,
    "success_first": 0.01,
    "success": 0.0,
}
"""What is compared, and the change up to which a figure counts as the same, whatever its share.
Tails such as p99 differ from run to run by more than any tolerance of use.
"""
_ALIKE = {
    "CPU": ("environment", "cpu"),
    "queries": ("profile", "load"),
    "networks": ("profile", "networks"),
}
"""Facts that must be equal in two reports, by their names."""


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
    """Judge the second report by budgets that are the figures of the first: ``verdict``,
    ``summary``, ``tolerance``, ``notes`` and ``budgets``.

    `tolerance` is the share by which a figure may become worse; of a success share what is missing
    to 1 counts. InvalidQueryError if the reports have no workload, size and planner in common.
    """
    with refused_as(
        InvalidQueryError,
        "wanted two reports of nnpp-edge profile, got a damaged one",
    ):
        old = {PLACE(row): row for row in before["results"]}
        budgets = []
        for row in after["results"]:
            for quantity in COMPARED:
                was = value_of(old.get(PLACE(row), {}), quantity)
                if was is not None and value_of(row, quantity) is not None:
                    budgets.append(_budget(row, quantity, was, tolerance))
        noise = _noise(before, after)
        lines = judged(Profile("", "", budgets=tuple(budgets)), after["results"], {}, noise)
        notes = [
            f"other {name} in the second report: hard to compare"
            for name, (table, key) in _ALIKE.items()
            if before[table][key] != after[table][key]
        ]
    if not lines:
        raise InvalidQueryError(
            "wanted reports with a workload, size and planner in common, got two without"
        )
    ending = verdict(lines, noise)
    told = {"verdict": ending, "summary": summary(ending, lines, noise.words)}
    return {**told, "tolerance": tolerance, "notes": notes, "budgets": lines}


def _budget(row: Facts, quantity: str, was: float, tolerance: float) -> Budget:
    """That a figure of this row may be no worse than it `was`, but for the tolerance."""
    least = COMPARED[quantity]
    direction = "at least"
    if quantity.startswith("success"):
        limit = was - max(tolerance * (1.0 - was), least)
    elif quantity.startswith("speedup"):
        limit = was / (1.0 + tolerance)
    else:
        direction = "at most"
        limit = was + max(tolerance * was, least)
    kind = QUANTITIES[quantity]
    workload, size, planner = PLACE(row)
    limit *= kind.scale
    return Budget(quantity, quantity, limit, direction, kind.unit, planner, workload, size)


def _noise(*reports: Facts) -> Noise:
    """That of all runs."""
    halves = [half for report in reports for half in report["disturbance"]["halves"]]
    slowed = [report["sensors"]["throttled"] for report in reports]
    return noise_of(halves, Throttling("; ".join(filter(None, slowed)), 1.0))


def machine_words(report: Facts) -> dict[str, str]:
    """The machine of a run, and how it ran, in words."""
    facts = report["environment"]
    sensors = report["sensors"]
    halves = report["disturbance"]["halves"]
    taken = max(half[key] or 0.0 for half in halves for key in ("waited_share", "others_share"))
    versions = {"python": facts["python"]} | facts["packages"]
    system = facts["system"] or "Linux"
    words = {
        "processor": facts["cpu"],
        "cores": f"{len(report['cores'])} of {facts['cores_online'] or '?'}",
        "flags": ", ".join(facts["flags"]),
        "clock": with_unit(facts["clock_mhz"], "MHz"),
        "clock meanwhile": _ranges(sensors["clock_mhz"], "MHz"),
        "temperature": _ranges(sensors["temperature_c"], "°C"),
        "memory": f"{facts['memory_mb'] / 1024:.1f} GiB",
        "system": f"{system}, kernel {facts['kernel']}, {facts['architecture']}",
        "versions": ", ".join(f"{name} {number}" for name, number in versions.items()),
        "others took": f"{100 * taken:.1f} %",
        "throttled": sensors["throttled"],
        "governor": ", ".join(facts["governor"] or ()),
        "load": " ".join(map(str, facts["load_average"])),
    }
    for quantity, by_planner in report["besides"].items():
        name = quantity.rpartition("_")[0].replace("_", " ")
        unit = QUANTITIES[quantity].unit
        figures = [f"{who} {with_unit(value, unit)}" for who, value in by_planner.items()]
        words[name] = ", ".join(figures)
    return {name: value for name, value in words.items() if value}


def _ranges(sensors: Facts, unit: str) -> str:
    """Least and greatest readings of each sensor of a kind."""
    return ", ".join(
        f"{name}: {shown(each['min'])} to {shown(each['max'])} {unit}"
        for name, each in sensors.items()
    )
