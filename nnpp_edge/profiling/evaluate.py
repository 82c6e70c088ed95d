"""Every planner on the same queries, in one interleaved run, judged by the exact optimum."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from nnpp_edge.profiling.harness import Harness, Record
from nnpp_edge.profiling.rivals import EXACT, FIRST_SOURCES, Forgetting, FreshMap, RivalPlanner, call_on
from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.plan import Method, Plan, Source
from nnpp_edge.runtime.warmup import exercise

Figures = dict[str, float | None]
"""A row of docs/evaluate.md: figures by key; None where there was nothing to count."""
EAGER = "-eager"
"""Ends the name of a planner that computes all costs of a fresh map before it plans."""
_FRESH = "fresh map: "
"""Before the names of planners that are measured on fresh maps beside others of the same name."""


@dataclass
class _Answers:
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

    def add(self, plan: Plan, seconds: float, exact: Plan, exact_seconds: float, cells: int) -> None:
        """Count one query on a map of so many cells; the plan's regions are read."""
        self.time_ms.append(1e3 * seconds)
        self.exact_ms.append(1e3 * exact_seconds)
        self.expansions.append(plan.expansions)
        self.sources.append(plan.source)
        searched = plan.region.area() if plan.region is not None else None
        self.region_shares.append(1.0 if searched is None else searched / cells)
        if searched is not None:
            self.mms.append(len(exact.path) / searched)
        if plan.network_region is not None:
            self.network_mms.append(len(exact.path) / plan.network_region.area())
        if plan.ok:
            self.gaps.append(plan.cost / exact.cost - 1.0 if exact.cost else 0.0)
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
            "time_ms_p99": float(np.quantile(times, 0.99)),
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


@dataclass
class _FreshAnswers:
    """What one planner did on fresh maps: a value for each query."""

    time_ms: list[float] = field(default_factory=list)
    exact_ms: list[float] = field(default_factory=list)
    """Eager exact A*'s time."""
    costs_computed: list[float] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)
    """Of the queries with a path."""

    def add(self, record: Record[Endpoints, Plan], exact_ms: float, optimum: float) -> None:
        """Count one query."""
        plan = record.results[0]
        self.time_ms.append(1e3 * record.median_s)
        self.exact_ms.append(exact_ms)
        self.costs_computed.append(plan.costs_computed)
        if plan.ok:
            self.gaps.append(plan.cost / optimum - 1.0 if optimum else 0.0)

    def figures(self) -> Figures:
        times, gaps = np.array(self.time_ms), np.array(self.gaps) if self.gaps else np.array([np.nan])
        return {
            "fresh_ms_median": float(np.median(times)),
            "fresh_ms_p99": float(np.quantile(times, 0.99)),
            "fresh_speedup_median": float(np.median(np.array(self.exact_ms) / times)),
            "fresh_gap_mean": float(gaps.mean()),
            "fresh_gap_p99": float(np.quantile(gaps, 0.99)),
            "costs_computed_mean": float(np.mean(self.costs_computed)),
        }


def evaluate(
    cases: Iterable[Case],
    rivals: Sequence[RivalPlanner],
    queries: int,
    *,
    repeats: int = 3,
    fresh_map: bool = False,
    harness: Harness | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, Figures]:
    """Have every planner, exact A* among them, answer the same queries.

    Queries that exact A* finds no path for are passed over; `queries` others are judged by, fewer if the cases run
    out. Each planner answers each of them `repeats` times, in turn with the others; its median time counts.
    `progress` is called with the number of queries that are done.

    With `fresh_map` each also answers every query on a map that has just arrived, lazily and eagerly, in the same
    turns: a planner is made of the elevations for each call, all of it on the clock. InvalidQueryError for a case
    without elevations.

    Returns
    -------
    dict
        A row of figures for each planner's name, in order. With `fresh_map` a row that ends in ``-eager`` follows
        each: the figures of a standing map are the same in both, as there all costs have been computed.

    Notes
    -----
    A query's time is the whole call: encoding, inference, threshold, searches, path, and every widening and
    fallback. What depends on the map alone (weights, pyramid, the network's view of the map) is made when
    the map is set, before the clock starts, for all planners alike.
    """
    exercise()
    harness = harness or Harness()
    answers = {rival.name: _Answers() for rival in rivals}
    arrivals = [(rival, lazy) for rival in rivals for lazy in (True, False) if fresh_map]
    on_fresh = {_fresh_name(rival, lazy): _FreshAnswers() for rival, lazy in arrivals}
    done = 0
    for case in cases:
        planners = {rival.name: rival.planner(case.cost) for rival in rivals}
        exact = {query: planners[EXACT].plan(*query, method=Method.ASTAR) for query in case.queries}
        solvable = [query for query in case.queries if exact[query].ok][: queries - done]
        calls: dict[str, Callable[[Endpoints], Plan]] = {
            rival.name: call_on(planners[rival.name], rival.method) for rival in rivals
        }
        fresh = {_FRESH + _fresh_name(rival, lazy): _arriving(rival, case, lazy) for rival, lazy in arrivals}
        calls |= fresh
        for call in calls.values():
            call(case.queries[0])
        for records in harness.measure(calls, solvable, repeats=repeats, observer=Forgetting(fresh)):
            query = records[EXACT].case
            for rival in rivals:
                record = records[rival.name]
                plan = planners[rival.name].plan(*query, method=rival.method, keep_regions=True)
                answers[rival.name].add(plan, record.median_s, exact[query], records[EXACT].median_s, case.cost.size)
            for name, arrived in on_fresh.items():
                exact_ms = 1e3 * records[_FRESH + EXACT + EAGER].median_s
                arrived.add(records[_FRESH + name], exact_ms, exact[query].cost)
            progress(done := done + 1)
        if done == queries:
            break
    return _rows(answers, on_fresh)


def _fresh_name(rival: RivalPlanner, lazy: bool) -> str:
    return rival.name if lazy else rival.name + EAGER


def _arriving(rival: RivalPlanner, case: Case, lazy: bool) -> FreshMap:
    """The rival on the case's map, with a network of its own: what that has been shown is not kept."""
    if case.ground is None:
        raise InvalidQueryError("a fresh map is made from elevations, got a case of costs alone")
    return FreshMap(replace(rival, model=rival.model and rival.model.share()), case.ground, lazy=lazy)


def _rows(answers: dict[str, _Answers], on_fresh: dict[str, _FreshAnswers]) -> dict[str, Figures]:
    rows = {}
    for name, counted in answers.items():
        if not counted.time_ms:
            continue
        rows[name] = counted.figures()
        for each in (name, name + EAGER):
            if each in on_fresh:
                rows[each] = rows[name] | on_fresh[each].figures()
    return rows
