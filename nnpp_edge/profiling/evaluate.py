"""Every planner on the same queries, in one interleaved run, judged by the exact optimum."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import islice, product

import numpy as np

from nnpp_edge.profiling.answers import ANSWERS, OF_BODY, ON_FRESH_MAP, answer, search
from nnpp_edge.profiling.contest import Figures, Row, summarised
from nnpp_edge.profiling.harness import Harness, Record
from nnpp_edge.profiling.rivals import EXACT, FindsPlans, Forgetting, FreshMap, Queries, RivalPlanner
from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.terrain.vehicle import HEADINGS

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
    harness, counts = harness or Harness(), _Counts(rivals)
    done = in_vain = 0
    for case in cases:
        on_map = _OnMap(case, rivals, fresh_map)
        if queries_per_map > 1 and not on_map.has_body:
            raise InvalidQueryError("queries_per_map is for a vehicle: a point's planner serves all queries of a map")
        groups, unsolvable = on_map.groups(queries_per_map)
        counts.unsolvable += unsolvable
        in_vain = 0 if groups else in_vain + 1
        if in_vain == _MAPS_WITHOUT_PATH:
            wanted = (
                "no query has a path" if queries_per_map == 1 else f"fewer than {queries_per_map} queries have paths"
            )
            raise InvalidQueryError(f"{wanted} on {in_vain} maps in a row of the workload {case.workload}")
        for call in on_map.calls.values():
            call(case.queries[:1])
        missing = groups[: math.ceil((queries - done) / queries_per_map)]
        measured = harness.measure(on_map.calls, missing, repeats=repeats, observer=Forgetting(on_map.fresh))
        for group, records in zip(missing, measured, strict=True):
            counts.add(on_map, group, records)
            done += len(group)
            progress(min(done, queries))
        if done >= queries:
            break
    return counts.rows()


class _OnMap:
    """The rivals on the map of one case, as functions of start and goal."""

    def __init__(self, case: Case, rivals: Sequence[RivalPlanner], fresh_map: bool) -> None:
        self.case, self.has_body = case, case.ground is not None and case.ground.vehicle is not None
        laziness = (True, False) if fresh_map else (True,) if self.has_body else ()
        self.fresh = {
            _FRESH + _key(rival, lazy): _arriving(rival, case, lazy) for rival in rivals for lazy in laziness
        }
        """On a map that has just arrived."""
        self._standing = (
            {} if self.has_body else {rival.name: rival.planner(case.cost, case.ground) for rival in rivals}
        )
        self.calls: dict[str, Callable[[Queries], Plans]] = {
            rival.name: _answering(rival, self._standing[rival.name]) for rival in rivals if self._standing
        }
        self.calls |= self.fresh
        self.exact: dict[Endpoints, Plan] = {}
        """The optimum of each query that has been asked for it."""

    def groups(self, count: int) -> tuple[list[Queries], int]:
        """The map's queries that have a path, so many together, and how many were passed over as they have none.

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
        unsolvable = sum(not plan.ok for plan in self.exact.values())
        whole = range(0, len(solvable) - count + 1, count)
        return [tuple(solvable[at : at + count]) for at in whole], unsolvable

    def plans(self, rival: RivalPlanner, queries: Queries) -> Plans:
        """The rival's plans with their regions, of a planner that has checked no pose before."""
        planner = self._planner(rival.name)
        return tuple([rival.plan(planner, query, keep_regions=True) for query in queries])

    def own_s(self, key: str, records: Records) -> float:
        """Seconds of an answer: with a vehicle without the making of the planner, and the mean of those it gave."""
        if not self.has_body:
            return records[key].median_s
        return 1e-3 * _median_ms(records[_FRESH + key], "total") / len(records[_FRESH + key].case)

    def _planner(self, key: str) -> FindsPlans:
        if self._standing:
            return self._standing[key]
        assert self.case.ground is not None
        return self.fresh[_FRESH + key].rival.planner_of(self.case.ground, lazy=True)


class _Counts:
    """Rows of what the rivals did so far, on all maps."""

    def __init__(self, rivals: Sequence[RivalPlanner]) -> None:
        self._rivals = rivals
        self._standing: dict[str, list[Row]] = {rival.name: [] for rival in rivals}
        self._fresh: dict[str, list[Row]] = {}
        self._has_body, self._per_map, self._poses = False, 1, 0
        self.unsolvable = 0

    def add(self, on_map: _OnMap, queries: Queries, records: Records) -> None:
        """Count what was measured on queries that share a planner."""
        self._has_body, self._per_map = on_map.has_body, len(queries)
        cells, exact_ms = on_map.case.cost.size, 1e3 * on_map.own_s(EXACT, records)
        self._poses = len(HEADINGS) * cells
        exact = [on_map.exact[query] for query in queries]
        for rival in self._rivals:
            key = rival.name
            time_ms = 1e3 * on_map.own_s(key, records)
            for at, (plan, optimum) in enumerate(zip(on_map.plans(rival, queries), exact, strict=True)):
                found = answer(plan, time_ms, optimum.cost, exact_ms) | search(plan, optimum, cells)
                self._standing[key].append(Row(key, queries[at], found))
        eager = records.get(_FRESH + EXACT + EAGER)
        eager_ms = None if eager is None else 1e3 * eager.median_s / len(queries)
        for name in on_map.fresh:
            key, time_ms = name.removeprefix(_FRESH), 1e3 * records[name].median_s / len(queries)
            for query, plan, optimum in zip(queries, records[name].results[0], exact, strict=True):
                row = Row(key, query, answer(plan, time_ms, optimum.cost, eager_ms))
                self._fresh.setdefault(key, []).append(row)

    def rows(self) -> dict[str, Figures]:
        """By the rivals' keys; none where nothing was counted."""
        found: dict[str, Figures] = {}
        for rival, lazy in product(self._rivals, (True, False)):
            key, answers = _key(rival, lazy), self._standing[rival.name]
            if not answers or not (lazy or key in self._fresh):
                continue
            row: Figures = {"method": rival.name + EAGER * (not lazy)}
            row |= {"queries_per_map": self._per_map if self._has_body else None}
            row |= {**summarised(answers, ANSWERS), "unsolvable": self.unsolvable}
            if self._has_body:
                row |= summarised(answers, OF_BODY)
                row |= {} if lazy else {"checks_mean": self._poses, "checks_share_mean": 1.0}
            found[key] = row | (summarised(self._fresh[key], ON_FRESH_MAP) if key in self._fresh else {})
        return found


def _key(rival: RivalPlanner, lazy: bool) -> str:
    return rival.name + EAGER * (not lazy)


def _answering(rival: RivalPlanner, planner: FindsPlans) -> Callable[[Queries], Plans]:
    """A rival's planner of a standing map as a function of queries."""
    return lambda queries: tuple([rival.plan(planner, query) for query in queries])


def _median_ms(record: Record[Queries, Plans], stage: str) -> float:
    """Milliseconds that all plans of a call took together, in one stage; the median of the calls."""
    return float(np.median([sum(plan.timings_ms.get(stage, 0.0) for plan in plans) for plans in record.results]))


def _arriving(rival: RivalPlanner, case: Case, lazy: bool) -> FreshMap:
    """The rival on the case's map, with a network of its own: what that has been shown is not kept."""
    if case.ground is None:
        raise InvalidQueryError("a fresh map is made from elevations, got a case of costs alone")
    return FreshMap(replace(rival, model=rival.model and rival.model.share()), case.ground, lazy=lazy)
