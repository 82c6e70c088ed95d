"""Rows of `nnpp-edge evaluate`: a planner's answer beside the optimum, and the figures of docs/evaluate.md."""

from nnpp_edge.profiling.contest import gap, mean, quantile
from nnpp_edge.profiling.rivals import FIRST_SOURCES
from nnpp_edge.runtime.planners.plan import Plan, Source
from nnpp_edge.runtime.terrain.vehicle import HEADINGS

ANSWERS = {
    "n": lambda columns: len(columns["time_ms"]),
    "success_raw": mean("first"),
    "success": mean("solved"),
    "gap_mean": mean("gap"),
    "gap_p95": quantile("gap", 0.95),
    "gap_p99": quantile("gap", 0.99),
    "gap_max": quantile("gap", 1.0),
    "time_ms_median": quantile("time_ms", 0.5),
    "time_ms_p95": quantile("time_ms", 0.95),
    "time_ms_p99": quantile("time_ms", 0.99),
    "speedup_median": quantile("speedup", 0.5),
    "speedup_total": lambda columns: sum(columns["exact_ms"]) / sum(columns["time_ms"]),
    "expansions_median": quantile("expansions", 0.5),
    "region_share_mean": mean("region_share"),
    "widened_share": mean("widened"),
    "whole_map_share": mean("whole_map"),
    "mm_mean": mean("mm"),
    "mm_network_mean": mean("mm_network"),
    "cc_mean": mean("cc"),
}
OF_BODY = {
    "time_ms_p99_first": quantile("first_ms", 0.99),
    "checks_mean": mean("checks"),
    "checks_share_mean": mean("checks_share"),
}
"""Besides, of a vehicle with a body."""
ON_FRESH_MAP = {
    "fresh_ms_median": quantile("time_ms", 0.5),
    "fresh_ms_p99": quantile("time_ms", 0.99),
    "fresh_ms_p99_first": quantile("first_ms", 0.99),
    "fresh_speedup_median": quantile("speedup", 0.5),
    "fresh_gap_mean": mean("gap"),
    "fresh_gap_p99": quantile("gap", 0.99),
    "costs_computed_mean": mean("costs_computed"),
}


def answer(plan: Plan, time_ms: float, optimum: float, exact_ms: float | None) -> dict[str, float]:
    """A plan's figures beside the optimum's cost; `exact_ms` is exact A*'s time, where it was measured."""
    first = plan.source in FIRST_SOURCES
    found = {"time_ms": time_ms, "first": first, "solved": plan.ok, "costs_computed": plan.costs_computed}
    if exact_ms is not None:
        found |= {"exact_ms": exact_ms, "speedup": exact_ms / time_ms}
    found |= {"first_ms": time_ms} if first else {}
    return found | ({"gap": gap(plan.cost, optimum), "cc": plan.traverse_cost} if plan.ok else {})


def search(plan: Plan, optimum: Plan, cells: int) -> dict[str, float]:
    """Cells that a plan's search went over, on a map of so many cells, its regions kept.

    MM is the number of cells of the optimal path over those of a region: of the one that was searched, where one was,
    and of the network's at the threshold itself.
    """
    searched, poses = plan.region.area() if plan.region is not None else None, len(HEADINGS) * cells
    found = {"expansions": plan.expansions, "checks": plan.checks, "checks_share": plan.checks / poses}
    found |= {"widened": plan.source is Source.WIDENED, "whole_map": plan.source is Source.FALLBACK}
    found |= {"region_share": 1.0} if searched is None else {"region_share": searched / cells}
    found |= {} if searched is None else {"mm": len(optimum.path) / searched}
    if plan.network_region is not None:
        found["mm_network"] = len(optimum.path) / plan.network_region.area()
    return found
