"""A report of `nnpp-edge profile` as a row for the table of boards."""

from nnpp_edge.profiling.contest import Facts
from nnpp_edge.progress import MISSING, markdown_table


def board_table(report: Facts) -> str:
    """The report's row for the table in docs/boards.md, below that table's header."""
    cells = {name: cell.replace("|", "\\|") for name, cell in board(report).items()}
    return markdown_table([*cells], [[*cells.values()]])


def board(report: Facts) -> dict[str, str]:
    """The report's words for each column of the table in docs/boards.md."""
    facts, sensors, results = report["environment"], report["sensors"], report["results"]
    workload, clocks = results[0]["workload"], sensors["clock_mhz"].values()

    def medians(planner: str, key: str = "time_ms") -> str:
        """Milliseconds by size, at the profile's first workload."""
        rows = [row for row in results if (row["workload"], row["planner"]) == (workload, planner) and row[key]]
        return " · ".join(f"{row['size']}² {row[key]['median']:.3g}" for row in rows) or MISSING

    greatest = MISSING if facts["clock_mhz"] is None else f"{facts['clock_mhz']:.0f} MHz"
    ran = "not told while it ran"
    if clocks:
        ran = f"ran at {min(each['min'] for each in clocks):.0f} to {max(each['max'] for each in clocks):.0f}"
    versions = (f"{name} {facts['packages'][name]}" for name in ("nnpp-edge", "numpy", "numba", "onnxruntime"))
    others = max(max(half["waited_share"], half["others_share"] or 0.0) for half in report["disturbance"]["halves"])
    return {
        "date": report["made"][:10],
        "processor": facts["cpu"],
        "cores": f"{len(report['cores'])} of {facts['cores_online'] or '?'}",
        "flags": ", ".join(facts["flags"]) or MISSING,
        "clock": f"{greatest}, {ran}",
        "memory": f"{facts['memory_mb'] / 1024:.1f} GiB",
        "system": f"{facts['system'] or 'Linux'}, kernel {facts['kernel']}, {facts['architecture']}",
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
        "throttled": sensors["throttled"] or ("no" if clocks or sensors["temperature_c"] else "not told"),
    }
