"""Tables of `nnpp-edge evaluate` for people."""

from collections.abc import Mapping, Sequence

COLUMNS = {
    "workload": "workload",
    "size": "size",
    "method": "method",
    "n": "n",
    "success_raw": "success",
    "success": "after\nfallback",
    "gap_mean": "gap\nmean",
    "gap_p99": "gap\np99",
    "time_ms_median": "ms\nmedian",
    "time_ms_p99": "ms\np99",
    "speedup_median": "speed-up\nmedian",
    "speedup_total": "speed-up\ntotal",
    "expansions_median": "expan-\nsions",
    "region_share_mean": "region",
    "mm_mean": "MM",
    "cc_mean": "CC",
}
FRESH_COLUMNS = {
    "workload": "workload",
    "size": "size",
    "method": "method",
    "n": "n",
    "fresh_ms_median": "elevation →\npath, ms",
    "fresh_ms_p99": "p99",
    "fresh_speedup_median": "times as fast as\nastar-eager",
    "costs_computed_mean": "costs\ncomputed",
    "fresh_gap_mean": "gap\nmean",
    "fresh_gap_p99": "gap\np99",
    "time_ms_median": "standing\nmap, ms",
}
BODY_COLUMNS = {
    "workload": "workload",
    "size": "size",
    "method": "method",
    "queries_per_map": "queries\na map",
    "n": "n",
    "unsolvable": "without\na path",
    "success_raw": "success",
    "success": "after\nfallback",
    "gap_mean": "gap\nmean",
    "gap_p99": "gap\np99",
    "checks_mean": "poses\nchecked",
    "checks_share_mean": "of all",
    "expansions_median": "expan-\nsions",
    "time_ms_median": "ms\nmedian",
    "time_ms_p95": "ms\np95",
    "time_ms_p99": "ms\np99",
    "fresh_ms_median": "elevation →\npath, ms",
    "fresh_ms_p99": "p99",
    "fresh_ms_p99_first": "p99 without\nfallback",
}
_SHARES = {"success_raw", "success", "region_share_mean", "costs_computed_mean", "checks_share_mean"}
_GAPS = {"gap_mean", "gap_p99", "fresh_gap_mean", "fresh_gap_p99"}


def label(row: Mapping[str, str | float | None]) -> str:
    """A planner's name in a picture."""
    return str(row["method"])


def table(rows: Sequence[dict[str, str | float | None]], columns: Mapping[str, str], markdown: bool = False) -> str:
    """The rows for people."""
    from nnpp_edge.progress import markdown_table, render_table

    body = [[_shown(key, row[key]) for key in columns] for row in rows]
    if markdown:
        return markdown_table(list(columns.values()), body)
    return render_table(list(columns.values()), body, sections=[row["method"] == "astar" for row in rows])


def _shown(key: str, value: str | float | None) -> str:
    if value is None:
        return "–"
    if isinstance(value, int | float) and key in _SHARES | _GAPS:
        return f"{100 * value:.1f} %" if key in _SHARES else f"{100 * value:.2f} %"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
