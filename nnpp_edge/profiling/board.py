"""A report as one row of the table in docs/boards.md, for others to compare their machine with."""

from collections.abc import Callable

from nnpp_edge.profiling.report_format import Report, find


def board_header() -> str:
    """The table's first two lines in Markdown."""
    return f"{_line(list(COLUMNS))}\n{_line(['---'] * len(COLUMNS))}"


def board_row(report: Report) -> str:
    """The report's line of the table."""
    return _line([cell(report) for cell in COLUMNS.values()])


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells) + " |"


def _cores(report: Report) -> str:
    return f"{len(report['cores'])} of {report['environment']['cores_online'] or '?'}"


def _clock(report: Report) -> str:
    """The greatest clock, and the lowest and greatest that were read while planners ran."""
    seen, known = report["sensors"]["clock_mhz"].values(), report["environment"]["clock_mhz"]
    lows, highs = ([each[name] or 0.0 for each in seen] for name in ("min", "max"))
    read = f", ran at {min(lows):.0f} to {max(highs):.0f}" if lows else ", not told while it ran"
    return ("–" if known is None else f"{known:.0f} MHz") + read


def _memory(report: Report) -> str:
    memory = report["environment"]["memory_mb"]
    return "–" if memory is None else f"{memory / 1024:.1f} GiB"


def _system(report: Report) -> str:
    facts = report["environment"]
    return f"{facts['system'] or 'Linux'}, kernel {facts['kernel']}, {facts['architecture']}"


def _versions(report: Report) -> str:
    packages = report["environment"]["packages"]
    names = ("nnpp-edge", "numpy", "numba", "onnxruntime")
    return ", ".join([f"python {report['environment']['python']}", *(f"{name} {packages[name]}" for name in names)])


def _median(planner: str) -> Callable[[Report], str]:
    """Median milliseconds by size, at the profile's first workload."""

    def cell(report: Report) -> str:
        rows = report["results"]
        workload = rows[0]["workload"]
        sizes = dict.fromkeys(row["size"] for row in rows if row["workload"] == workload)
        found = {size: find(rows, workload, size, planner) for size in sizes}
        return " · ".join(f"{size}² {row['time_ms']['median']:.3g}" for size, row in found.items() if row) or "–"

    return cell


def _first_path(report: Report) -> str:
    """Of a map that has just arrived, by the profile's planner, at its first workload."""
    rows, planner = report["results"], report["profile"]["planner"]
    kept = [row for row in rows if (row["workload"], row["planner"]) == (rows[0]["workload"], planner)]
    return " · ".join(f"{row['size']}² {row['map_ms']['median']:.3g}" for row in kept if row["map_ms"]) or "–"


def _profile(report: Report) -> str:
    return f"{report['profile']['name']}: {report['results'][0]['workload']}"


def _others(report: Report) -> str:
    halves = report["disturbance"]["halves"]
    return f"{100 * max(max(half['waited_share'], half['others_share'] or 0.0) for half in halves):.1f} %"


def _throttled(report: Report) -> str:
    sensors = report["sensors"]
    told = sensors["clock_mhz"] or sensors["temperature_c"]
    return sensors["throttled"] or ("no" if told else "not told")


COLUMNS: dict[str, Callable[[Report], str]] = {
    "date": lambda report: report["made"][:10],
    "processor": lambda report: report["environment"]["cpu"],
    "cores": _cores,
    "flags": lambda report: ", ".join(report["environment"]["flags"]) or "–",
    "clock": _clock,
    "memory": _memory,
    "system": _system,
    "versions": _versions,
    "profile": _profile,
    "A*, ms": _median("astar"),
    "corridor, ms": _median("corridor"),
    "nnpp int8, ms": _median("nnpp"),
    "nnpp fp32, ms": _median("nnpp-fp32"),
    "auto, ms": _median("auto"),
    "first path of a map, ms": _first_path,
    "verdict": lambda report: report["verdict"],
    "others took": _others,
    "throttled": _throttled,
}
"""Heading of each column, and what a report has to say in it."""
