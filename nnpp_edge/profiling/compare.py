"""Reports of `nnpp-edge profile` beside others: what has become worse, and a row for a table of
boards.
"""

from pathlib import Path
from typing import cast

from nnpp_edge.profiling.judge import Noise, judged, noise_of, summary, value_of, verdict
from nnpp_edge.profiling.profile_file import Budget, Profile
from nnpp_edge.profiling.quantities import QUANTITIES
from nnpp_edge.profiling.report import SCHEMA
from nnpp_edge.profiling.rows import PLACE, Facts, Rows
from nnpp_edge.profiling.sensors import Throttling
from nnpp_edge.progress import MISSING, markdown_table, shown
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


def board_table(report: Facts) -> str:
    """The report's row for the table in docs/boards.md, below that table's header."""
    cells = board(report)
    return markdown_table([*cells], [[*cells.values()]])


def board(report: Facts) -> dict[str, str]:
    """The report's words for each column of the table in docs/boards.md."""
    results = Rows(report["results"])
    first = results.of(workload=results[0]["workload"])

    def medians(planner: str, key: str = "time_ms") -> str:
        """Milliseconds by size, at the profile's first workload."""
        found = []
        for row in first.of(planner):
            if row[key]:
                found.append(f"{row['size']}² {row[key]['median']:.3g}")
        return " · ".join(found) or MISSING

    machine = machine_words(report)
    profile = report["profile"]
    return {
        "date": report["made"][:10],
        **{name: machine[name] for name in _MACHINE},
        "profile": f"{profile['name']}: {first[0]['workload']}",
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
_WHOLE_RUN = {
    "peak_memory_mb": "peak memory",
    "model_mb": "model",
    "start_up_cold_s": "first plan cold",
    "start_up_cold_mb": "first plan cold, peak",
    "start_up_warm_s": "first plan warm",
    "start_up_warm_mb": "first plan warm, peak",
    "first_tick_cold_s": "first tick cold",
    "first_tick_cold_mb": "first tick cold, peak",
    "first_tick_warm_s": "first tick warm",
    "first_tick_warm_mb": "first tick warm, peak",
}
"""Names of the quantities that there is one figure of for each planner."""


def machine_words(report: Facts) -> dict[str, str]:
    """The machine of a run, and how it ran, in words."""
    facts = report["environment"]
    sensors = report["sensors"]
    clocks = sensors["clock_mhz"].values()
    clock = MISSING if facts["clock_mhz"] is None else f"{facts['clock_mhz']:.0f} MHz"
    ran = "not told while it ran"
    if clocks:
        slowest = min(each["min"] for each in clocks)
        ran = f"ran at {slowest:.0f} to {max(each['max'] for each in clocks):.0f}"
    versions = {"python": facts["python"]} | facts["packages"]
    named = ("python", "nnpp-edge", "numpy", "numba", "onnxruntime")
    halves = report["disturbance"]["halves"]
    taken = max(half[key] or 0.0 for half in halves for key in ("waited_share", "others_share"))
    temperatures = sensors["temperature_c"]
    unthrottled = "no" if clocks or temperatures else "not told"
    words = {
        "processor": facts["cpu"],
        "cores": f"{len(report['cores'])} of {facts['cores_online'] or '?'}",
        "flags": ", ".join(facts["flags"]) or MISSING,
        "clock": f"{clock}, {ran}",
        "memory": f"{facts['memory_mb'] / 1024:.1f} GiB",
        "system": "{system}, kernel {kernel}, {architecture}".format(
            **facts | {"system": facts["system"] or "Linux"}
        ),
        "versions": ", ".join(f"{name} {versions.get(name)}" for name in named),
        "others took": f"{100 * taken:.1f} %",
        "throttled": sensors["throttled"] or unthrottled,
        "governor": ", ".join(facts["governor"] or ()),
        "load": " ".join(map(str, facts["load_average"])),
    }
    for quantity, name in _WHOLE_RUN.items():
        unit = QUANTITIES[quantity].unit
        by_planner = report["besides"].get(quantity, {})
        figures = [f"{who} {shown(value)} {unit}" for who, value in by_planner.items()]
        words[name] = ", ".join(figures)
    words["temperature"] = ", ".join(
        f"{zone} {shown(each['min'])} to {shown(each['max'])} °C"
        for zone, each in temperatures.items()
    )
    return {name: value for name, value in words.items() if value}
