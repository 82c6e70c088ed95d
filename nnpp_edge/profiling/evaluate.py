"""Every planner on the same queries, in one interleaved run, judged by the exact optimum."""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Method, Plan, Source
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.warmup import exercise

EXACT = "astar"


@dataclass
class Tally:
    """What one planner did on the queries of one workload and size."""

    time_ms: list[float] = field(default_factory=list)
    exact_ms: list[float] = field(default_factory=list)
    """Exact A* on the same queries."""
    gaps: list[float] = field(default_factory=list)
    traverse_costs: list[float] = field(default_factory=list)
    expansions: list[int] = field(default_factory=list)
    region_shares: list[float] = field(default_factory=list)
    mms: list[float] = field(default_factory=list)
    network_mms: list[float] = field(default_factory=list)
    sources: list[Source | None] = field(default_factory=list)
    solved: int = 0

    def add(self, plan: Plan, seconds: float, exact: Plan, exact_seconds: float, cells: int, region: Any) -> None:
        """Book one query; `region` is (area searched, area at the threshold itself), None for the whole map."""
        self.time_ms.append(1e3 * seconds)
        self.exact_ms.append(1e3 * exact_seconds)
        self.expansions.append(plan.expansions)
        self.sources.append(plan.source)
        searched, at_threshold = region
        self.region_shares.append(1.0 if searched is None else searched / cells)
        if searched is not None:
            self.mms.append(len(exact.path) / searched)
        if at_threshold is not None:
            self.network_mms.append(len(exact.path) / at_threshold)
        if plan.ok:
            self.solved += 1
            self.gaps.append(plan.cost / exact.cost - 1.0 if exact.cost else 0.0)
            self.traverse_costs.append(plan.traverse_cost)

    def row(self) -> dict[str, Any]:
        """The figures of docs/evaluate.md."""
        n = len(self.time_ms)
        times, exact = np.array(self.time_ms), np.array(self.exact_ms)
        gaps = np.array(self.gaps) if self.gaps else np.array([np.nan])

        def share(*sources: Source) -> float:
            return sum(source in sources for source in self.sources) / n

        def mean(values: list[float]) -> float | None:
            return float(np.mean(values)) if values else None

        return {
            "n": n,
            "success_raw": share(Source.MAP, Source.REGION),
            "success": self.solved / n,
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


@dataclass(frozen=True)
class Contender:
    """A planner under its name in the table."""

    name: str
    method: Method
    model: NetworkModel | None = None


def contenders(methods: Iterable[str], models: Mapping[str, NetworkModel]) -> list[Contender]:
    """The planners asked for; exact A* always, and ``nnpp`` once for each model.

    The first model's is called ``nnpp``, any other's ``nnpp:NAME``.
    """
    out = [Contender(EXACT, Method.ASTAR)]
    for method in dict.fromkeys(methods):
        if method == Method.NNPP:
            for at, (name, model) in enumerate(models.items()):
                out.append(Contender(f"nnpp:{name}" if at else "nnpp", Method.NNPP, model))
        elif method != EXACT:
            out.append(Contender(method, Method(method), next(iter(models.values()), None)))
    return out


def evaluate(
    cases: Iterable[Case],
    planners: list[Contender],
    queries: int,
    *,
    repeats: int = 3,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, dict[str, Any]]:
    """Put the same queries to every planner.

    Parameters
    ----------
    cases : iterable of Case
        Maps and queries. Queries that exact A* finds no path for are passed over.
    planners : list of Contender
        Exact A* must be among them.
    queries : int
        How many to judge by; fewer if the cases run out.
    repeats : int
        Each planner answers each query so often, in turn with the others; its median time counts.
    progress : callable
        Told how many queries are done.

    Returns
    -------
    dict
        A row of figures for each planner's name, in order.

    Notes
    -----
    A query's time is the whole call: encoding, inference, threshold, searches, path, and every widening and
    fallback. What depends on the map alone (weights, pyramid, the network's view of the map) is made when
    the map is set, before the clock starts, for all planners alike.
    """
    exercise()
    tallies = {planner.name: Tally() for planner in planners}
    done = 0
    for case in cases:
        on_map = {p.name: Planner(case.cost, model=p.model or "edge") for p in planners}
        for at, (start, goal) in enumerate(case.queries):
            if done == queries:
                return {name: tally.row() for name, tally in tallies.items()}
            if at == 0:
                for p in planners:
                    on_map[p.name].plan(start, goal, method=p.method)  # the map's own work, and warm caches
            exact = on_map[EXACT].plan(start, goal, method=Method.ASTAR)
            if exact.status is not Status.OK:
                continue
            times: dict[str, list[float]] = {p.name: [] for p in planners}
            plans: dict[str, tuple[Plan, Any]] = {}
            for turn in range(repeats):
                shift = (done + turn) % len(planners)
                for p in planners[shift:] + planners[:shift]:
                    began = time.perf_counter()
                    plan = on_map[p.name].plan(start, goal, method=p.method)
                    times[p.name].append(time.perf_counter() - began)
                    if turn == repeats - 1:
                        plans[p.name] = (plan, _areas(plan))
            medians = {name: float(np.median(values)) for name, values in times.items()}
            for name, (plan, region) in plans.items():
                tallies[name].add(plan, medians[name], exact, medians[EXACT], case.cost.size, region)
            done += 1
            progress(done)
    return {name: tally.row() for name, tally in tallies.items() if tally.time_ms}


def _areas(plan: Plan) -> tuple[int | None, int | None]:
    """Cells of the region that was searched and of the network's at the threshold; before the next query."""
    searched = None if plan.region is None else plan.region.area()
    return searched, None if plan.network_region is None else plan.network_region.area()
