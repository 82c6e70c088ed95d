"""Every planner on the same queries, in one interleaved run, judged by the exact optimum."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice, product

import numpy as np

from nnpp_edge.profiling.contest import Figures, Harness, Record, Row, answer, mean, quantile, ratio, summarised
from nnpp_edge.profiling.rivals import EXACT, FindsPlans, FreshMap, Queries, RivalPlanner
from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.kernels.poses import AXES
from nnpp_edge.runtime.planners.plan import Method, Plan, Source

Plans = tuple[Plan, ...]
Records = Mapping[str, Record[Queries, Plans]]
"""Measurements on queries that share a planner, by the names of the calls."""
EAGER = "-eager"
"""Ends the name of a planner that computes all costs of a fresh map before it plans."""
_FRESH = "fresh map: "
"""Before the names of planners that are measured on fresh maps beside others of the same name."""
_DRAWN = 5
"""Queries drawn for each that is wanted, on a map that does not connect enough of its own."""
_MAPS_WITHOUT_PATH = 50
"""So many maps in a row without any path, and there will be none."""
_ANSWERS = {
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
    "speedup_total": ratio("exact_ms", "time_ms"),
    "expansions_median": quantile("expansions", 0.5),
    "region_share_mean": mean("region_share"),
    "widened_share": mean("widened"),
    "whole_map_share": mean("whole_map"),
    "mm_mean": mean("mm"),
    "mm_network_mean": mean("mm_network"),
    "cc_mean": mean("cc"),
}
"""The figures of docs/evaluate.md."""
_OF_BODY = {
    "time_ms_p99_first": quantile("first_ms", 0.99),
    "checks_mean": mean("checks"),
    "checks_share_mean": mean("checks_share"),
}
_ON_FRESH_MAP = {
    "fresh_ms_median": quantile("time_ms", 0.5),
    "fresh_ms_p99": quantile("time_ms", 0.99),
    "fresh_ms_p99_first": quantile("first_ms", 0.99),
    "fresh_speedup_median": quantile("speedup", 0.5),
    "fresh_gap_mean": mean("gap"),
    "fresh_gap_p99": quantile("gap", 0.99),
    "costs_computed_mean": mean("costs_computed"),
}


def evaluate(
    cases: Iterable[Case],
    rivals: Sequence[RivalPlanner],
    queries: int,
    *,
    repeats: int = 3,
    fresh_map: bool = False,
    queries_per_map: int = 1,
    harness: Harness | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, Figures]:
    """Have every planner, exact A* among them, answer the same queries: a row of figures for each planner's key, in
    order.

    Queries that exact A* finds no path for are passed over; `queries` others are judged by, fewer if the cases run
    out. Each planner answers each of them `repeats` times, in turn with the others; its median time counts: the whole
    call, encoding, inference, threshold, searches, path, and every widening and fallback. What depends on the map
    alone is made before the clock starts. `progress` is called with the number of queries that are done.

    With `fresh_map` each also answers every query on a map that has just arrived, lazily and eagerly, in the same
    turns: a planner is made of the elevations for each call, all of it on the clock. A row that ends in ``-eager``
    follows.

    On the maps of a vehicle every answer is that of a planner which has not checked any pose before, and which is
    made of the elevations for it: its time is the plan's own, and from the elevations on it is given as of a fresh
    map. All cases are a vehicle's, or none. With `queries_per_map` a planner is made for so many queries on a map,
    which it answers one after the other: a query's time is the mean of theirs, what the first one prepares included.
    `queries` is rounded up to whole groups of them.

    InvalidQueryError for a case without elevations where they are needed, 50 maps in a row without a path (or without
    as many as are to share a planner), or several queries to a planner without a vehicle.
    """
    exercise()
    harness, rows = harness or Harness(), defaultdict[str, list[Row]](list)
    done = in_vain = unsolvable = poses = 0
    for case in cases:
        on_map = _OnMap(case, rivals, fresh_map)
        poses = on_map.poses
        if queries_per_map > 1 and not poses:
            raise InvalidQueryError("queries_per_map is for a vehicle: a point's planner serves all queries of a map")
        groups = on_map.groups(queries_per_map)
        unsolvable += sum(not plan.ok for plan in on_map.exact.values())
        in_vain = 0 if groups else in_vain + 1
        if in_vain == _MAPS_WITHOUT_PATH:
            several = f"fewer than {queries_per_map} queries have paths"
            wanted = "no query has a path" if queries_per_map == 1 else several
            raise InvalidQueryError(f"{wanted} on {in_vain} maps in a row of the workload {case.workload}")
        for call in on_map.calls.values():
            call(case.queries[:1])
        for fresh in on_map.fresh.values():
            fresh.forget()
        missing = groups[: math.ceil((queries - done) / queries_per_map)]
        measured = harness.measure(on_map.calls, missing, repeats=repeats, after=on_map.forget)
        for group, records in zip(missing, measured, strict=True):
            for row in on_map.judged(group, records):
                rows[row.rival].append(row)
            done += queries_per_map
            progress(min(done, queries))
        if done >= queries:
            break
    found: dict[str, Figures] = {}
    for rival, lazy in product(rivals, (True, False)):
        key = _key(rival, lazy)
        answers, on_fresh = rows[rival.name], rows[_FRESH + key]
        if answers and (lazy or on_fresh):
            found[key] = {"method": key, "queries_per_map": queries_per_map if poses else None}
            found[key] |= {**summarised(answers, _ANSWERS), "unsolvable": unsolvable}
            found[key] |= summarised(answers, _OF_BODY) if poses else {}
            found[key] |= {"checks_mean": poses, "checks_share_mean": 1.0} if poses and not lazy else {}
            found[key] |= summarised(on_fresh, _ON_FRESH_MAP) if on_fresh else {}
    return found


class _OnMap:
    """The rivals on the map of one case, as functions of start and goal."""

    def __init__(self, case: Case, rivals: Sequence[RivalPlanner], fresh_map: bool) -> None:
        self.case, self._rivals = case, rivals
        has_body = case.ground is not None and case.ground.vehicle is not None
        self.poses = 2 * AXES * case.cost.size if has_body else 0
        """Of a vehicle's body on the map; 0 of a point."""
        self.fresh: dict[str, FreshMap] = {}
        """On a map that has just arrived."""
        for rival, lazy in product(rivals, (True, False) if fresh_map else (True,) if has_body else ()):
            if case.ground is None:
                raise InvalidQueryError("a fresh map is made from elevations, got a case of costs alone")
            self.fresh[_FRESH + _key(rival, lazy)] = FreshMap(rival.apart(), case.ground, lazy=lazy)
        standing = () if has_body else rivals
        self._standing = {rival.name: rival.planner(case.cost, case.ground) for rival in standing}
        self.calls: dict[str, Callable[[Queries], Plans]] = {
            rival.name: partial(_plans, rival, self._standing[rival.name]) for rival in standing
        }
        self.calls |= self.fresh
        self.exact: dict[Endpoints, Plan] = {}
        """The optimum of each query that has been asked for it."""

    def groups(self, count: int) -> list[Queries]:
        """The map's queries that have a path, so many together.

        Where the map's own queries are too few for one group, others are drawn until there is one.
        """
        planner = self._planner(EXACT)
        solvable: list[Endpoints] = []
        drawn = islice(self.case.more_queries(), _DRAWN * count) if count > 1 else ()
        for at, query in enumerate((*self.case.queries, *drawn)):
            if at >= len(self.case.queries) and len(solvable) >= count:
                break
            self.exact[query] = planner.plan(*query, method=Method.ASTAR)
            solvable += [query] if self.exact[query].ok else []
        whole = range(0, len(solvable) - count + 1, count)
        return [tuple(solvable[at : at + count]) for at in whole]

    def forget(self, name: str, elapsed_s: float, result: Plans) -> None:
        """Give a fresh map's planner back after a call, outside the time that counts."""
        if name in self.fresh:
            self.fresh[name].forget()

    def judged(self, queries: Queries, records: Records) -> Iterator[Row]:
        """Rows of what was measured on queries that share a planner."""
        cells, exact = self.case.cost.size, [self.exact[query] for query in queries]
        exact_ms, eager = self._own_ms(EXACT, records), records.get(_FRESH + EXACT + EAGER)
        eager_ms = None if eager is None else _mean_ms(eager)
        for rival in self._rivals:
            time_ms = self._own_ms(rival.name, records)
            # of a planner that has checked no pose before
            plans = _plans(rival, self._planner(rival.name), queries, keep_regions=True)
            for query, plan, optimum in zip(queries, plans, exact, strict=True):
                found = answer(plan, time_ms, optimum.cost, exact_ms) | _searched(plan, optimum, cells)
                yield Row(rival.name, query, found)
        for name in self.fresh:
            time_ms = _mean_ms(records[name])
            for query, plan, optimum in zip(queries, records[name].results[0], exact, strict=True):
                yield Row(name, query, answer(plan, time_ms, optimum.cost, eager_ms))

    def _own_ms(self, key: str, records: Records) -> float:
        """An answer's time: with a vehicle without the making of the planner, and the mean of those it gave."""
        if self._standing:
            return _mean_ms(records[key])
        record = records[_FRESH + key]
        totals = [sum(plan.timings_ms.get("total", 0.0) for plan in plans) for plans in record.results]
        return float(np.median(totals)) / len(record.case)

    def _planner(self, key: str) -> FindsPlans:
        if self._standing:
            return self._standing[key]
        assert self.case.ground is not None
        return self.fresh[_FRESH + key].rival.planner_of(self.case.ground, lazy=True)


def _key(rival: RivalPlanner, lazy: bool) -> str:
    return rival.name + EAGER * (not lazy)


def _plans(rival: RivalPlanner, planner: FindsPlans, queries: Queries, *, keep_regions: bool = False) -> Plans:
    return tuple([rival.plan(planner, query, keep_regions=keep_regions) for query in queries])


def _mean_ms(record: Record[Queries, Plans]) -> float:
    """Milliseconds of a call for each of its queries."""
    return 1e3 * record.median_s / len(record.case)


def _searched(plan: Plan, optimum: Plan, cells: int) -> dict[str, float]:
    """Cells and poses that a plan's search went over, on a map of so many cells, its regions kept.

    MM is the number of cells of the optimal path over those of a region: of the one that was searched, where one was,
    and of the network's at the threshold itself.
    """
    area = plan.region.area() if plan.region is not None else None
    found = {"checks": plan.checks, "checks_share": plan.checks / (2 * AXES * cells)}
    found |= {"widened": plan.source is Source.WIDENED, "whole_map": plan.source is Source.FALLBACK}
    found |= {"region_share": 1.0} if area is None else {"region_share": area / cells, "mm": len(optimum.path) / area}
    if plan.network_region is not None:
        found["mm_network"] = len(optimum.path) / plan.network_region.area()
    return found
