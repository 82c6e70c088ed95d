"""What planners did on the queries of one workload and size, and the figures of it."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.rivals import FIRST_SOURCES
from nnpp_edge.runtime.planners.plan import Plan, Source
from nnpp_edge.runtime.terrain.vehicle import HEADINGS

Figures = dict[str, str | float | None]
"""A row of docs/evaluate.md: figures by key; None where there was nothing to count."""


@dataclass
class Answers:
    """What one planner did on the queries of one workload and size: a value for each query."""

    time_ms: list[float] = field(default_factory=list)
    exact_ms: list[float] = field(default_factory=list)
    """Exact A*'s time."""
    expansions: list[int] = field(default_factory=list)
    sources: list[Source | None] = field(default_factory=list)
    region_shares: list[float] = field(default_factory=list)
    """Of the map's cells, those of the region that was searched; 1 for the whole map."""
    mms: list[float] = field(default_factory=list)
    """Cells of the optimal path over those of the region; of the queries that searched a region."""
    network_mms: list[float] = field(default_factory=list)
    """The same of the network's region at the threshold itself."""
    gaps: list[float] = field(default_factory=list)
    """Of the queries with a path."""
    traverse_costs: list[float] = field(default_factory=list)
    """Of the queries with a path."""
    checks: list[int] = field(default_factory=list)
    """Poses of a vehicle that were checked."""
    look_ms: list[float] = field(default_factory=list)
    """Time that it took to price the links of a map; of rivals that do."""
    poses: int = 0
    """Of a map."""

    def add(self, plan: Plan, seconds: float, exact: Plan, exact_seconds: float, cells: int) -> None:
        """Count one query on a map of so many cells; the plan's regions are read."""
        self.time_ms.append(1e3 * seconds)
        self.exact_ms.append(1e3 * exact_seconds)
        self.expansions.append(plan.expansions)
        self.sources.append(plan.source)
        self.checks.append(plan.checks)
        self.poses = len(HEADINGS) * cells
        searched = plan.region.area() if plan.region is not None else None
        self.region_shares.append(1.0 if searched is None else searched / cells)
        if searched is not None:
            self.mms.append(len(exact.path) / searched)
        if plan.network_region is not None:
            self.network_mms.append(len(exact.path) / plan.network_region.area())
        if plan.ok:
            self.gaps.append(gap(plan.cost, exact.cost))
            self.traverse_costs.append(plan.traverse_cost)

    def figures(self) -> Figures:
        n = len(self.time_ms)
        times, exact = np.array(self.time_ms), np.array(self.exact_ms)
        gaps = np.array(self.gaps) if self.gaps else np.array([np.nan])

        def share(*sources: Source) -> float:
            return sum(source in sources for source in self.sources) / n

        def mean(values: list[float]) -> float | None:
            return float(np.mean(values)) if values else None

        return {
            "n": n,
            "success_raw": share(*FIRST_SOURCES),
            "success": len(self.gaps) / n,
            "gap_mean": float(gaps.mean()),
            "gap_p95": float(np.quantile(gaps, 0.95)),
            "gap_p99": float(np.quantile(gaps, 0.99)),
            "gap_max": float(gaps.max()),
            "time_ms_median": float(np.median(times)),
            "time_ms_p95": float(np.quantile(times, 0.95)),
            "time_ms_p99": float(np.quantile(times, 0.99)),
            "look_ms_median": float(np.median(self.look_ms)) if self.look_ms else None,
            "speedup_median": float(np.median(exact / times)),
            "speedup_total": float(exact.sum() / times.sum()),
            "expansions_median": float(np.median(self.expansions)),
            "region_share_mean": float(np.mean(self.region_shares)),
            "widened_share": share(Source.WIDENED),
            "whole_map_share": share(Source.FALLBACK),
            "mm_mean": mean(self.mms),
            "mm_network_mean": mean(self.network_mms),
            "cc_mean": mean(self.traverse_costs),
        }

    def body_figures(self, *, eager: bool) -> Figures:
        """What a vehicle's rows have too; `eager` where all poses are checked beforehand."""
        first = np.array([source in FIRST_SOURCES for source in self.sources])
        checks = float(self.poses if eager else np.mean(self.checks))
        return {
            "time_ms_p99_first": _p99(self.time_ms, first),
            "checks_mean": checks,
            "checks_share_mean": checks / self.poses,
        }


@dataclass
class FreshAnswers:
    """What one planner did on fresh maps: a value for each query."""

    time_ms: list[float] = field(default_factory=list)
    exact_ms: list[float] = field(default_factory=list)
    """Eager exact A*'s time, where it was measured."""
    first: list[bool] = field(default_factory=list)
    """Whether the path was found in the first region."""
    costs_computed: list[float] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)
    """Of the queries with a path."""

    def add(self, plan: Plan, seconds: float, exact_ms: float | None, optimum: float) -> None:
        """Count one query."""
        self.time_ms.append(1e3 * seconds)
        self.exact_ms += [] if exact_ms is None else [exact_ms]
        self.first.append(plan.source in FIRST_SOURCES)
        self.costs_computed.append(plan.costs_computed)
        if plan.ok:
            self.gaps.append(gap(plan.cost, optimum))

    def figures(self) -> Figures:
        times, gaps = np.array(self.time_ms), np.array(self.gaps) if self.gaps else np.array([np.nan])
        return {
            "fresh_ms_median": float(np.median(times)),
            "fresh_ms_p99": float(np.quantile(times, 0.99)),
            "fresh_ms_p99_first": _p99(self.time_ms, np.array(self.first)),
            "fresh_speedup_median": float(np.median(np.array(self.exact_ms) / times)) if self.exact_ms else None,
            "fresh_gap_mean": float(gaps.mean()),
            "fresh_gap_p99": float(np.quantile(gaps, 0.99)),
            "costs_computed_mean": float(np.mean(self.costs_computed)),
        }


def gap(cost: float, optimum: float) -> float:
    """By how much a cost is above the optimum, as a share of it; of its size where energy is got back."""
    return (cost / optimum - 1.0) * math.copysign(1.0, optimum) if optimum else 0.0


def _p99(time_ms: list[float], chosen: NDArray[np.bool_]) -> float | None:
    """The 99th percentile of some of the times."""
    return float(np.quantile(np.array(time_ms)[chosen], 0.99)) if chosen.any() else None
