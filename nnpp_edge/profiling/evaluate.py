"""Every planner on the same queries, in one interleaved run, judged by the exact optimum."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from nnpp_edge.profiling.answers import Answers, Figures, FreshAnswers
from nnpp_edge.profiling.harness import Harness, Record
from nnpp_edge.profiling.rivals import EXACT, FindsPlans, Forgetting, FreshMap, RivalPlanner, call_on
from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.warmup import exercise

Records = Mapping[str, Record[Endpoints, Plan]]
"""What was measured on one query, by the names of the calls."""
EAGER = "-eager"
"""Ends the name of a planner that computes all costs of a fresh map before it plans."""
_FRESH = "fresh map: "
"""Before the names of planners that are measured on fresh maps beside others of the same name."""
_MAPS_WITHOUT_PATH = 50
"""So many maps in a row without any path, and there will be none."""


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
    turns: a planner is made of the elevations for each call, all of it on the clock.

    On the maps of a vehicle every answer is that of a planner which has not checked any pose before, and which is
    made of the elevations for it: its time is the plan's own, and from the elevations on it is given as of a fresh
    map. All cases are a vehicle's, or none.

    Returns
    -------
    dict
        A row of figures for each planner's key, in order. With `fresh_map` a row that ends in ``-eager`` follows
        each: the figures of a standing map are the same in both, as there all costs have been computed.

    Raises
    ------
    InvalidQueryError
        A case without elevations where they are needed, or 50 maps in a row without a path.

    Notes
    -----
    A query's time is the whole call: encoding, inference, threshold, searches, path, and every widening and
    fallback. What depends on the map alone (weights, pyramid, the network's view of the map) is made when
    the map is set, before the clock starts, for all planners alike.
    """
    exercise()
    harness, counts = harness or Harness(), _Counts(rivals)
    done = in_vain = 0
    for case in cases:
        on_map = _OnMap(case, rivals, fresh_map)
        exact = on_map.exact_plans()
        solvable = [query for query in case.queries if exact[query].ok][: queries - done]
        counts.unsolvable += sum(not plan.ok for plan in exact.values())
        in_vain = 0 if solvable else in_vain + 1
        if in_vain == _MAPS_WITHOUT_PATH:
            raise InvalidQueryError(f"no query has a path on {in_vain} maps in a row of the workload {case.workload}")
        for call in on_map.calls.values():
            call(case.queries[0])
        measured = harness.measure(on_map.calls, solvable, repeats=repeats, observer=Forgetting(on_map.fresh))
        for query, records in zip(solvable, measured, strict=True):
            counts.add(on_map, query, records, exact[query])
            progress(done := done + 1)
        if done == queries:
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
        self._standing = {} if self.has_body else {rival.key: rival.planner(case.cost) for rival in rivals}
        self.calls: dict[str, Callable[[Endpoints], Plan]] = {
            rival.key: call_on(self._standing[rival.key], rival.method) for rival in rivals if self._standing
        }
        self.calls |= self.fresh

    def exact_plans(self) -> dict[Endpoints, Plan]:
        """The optimum of each query."""
        planner = self._planner(EXACT)
        return {query: planner.plan(*query, method=Method.ASTAR) for query in self.case.queries}

    def plan(self, rival: RivalPlanner, query: Endpoints) -> Plan:
        """The rival's plan with its regions, of a planner that has checked no pose."""
        return rival.plan(self._planner(rival.key), query, keep_regions=True)

    def own_s(self, key: str, records: Records) -> float:
        """What an answer took: with a vehicle without the making of the planner, which has to be made for each."""
        if not self.has_body:
            return records[key].median_s
        return 1e-3 * float(np.median([plan.timings_ms["total"] for plan in records[_FRESH + key].results]))

    def _planner(self, key: str) -> FindsPlans:
        if self._standing:
            return self._standing[key]
        assert self.case.ground is not None
        return self.fresh[_FRESH + key].rival.planner_of(self.case.ground, lazy=True)


class _Counts:
    """What the rivals did so far, on all maps."""

    def __init__(self, rivals: Sequence[RivalPlanner]) -> None:
        self._rivals = rivals
        self._answers = {rival.key: Answers() for rival in rivals}
        self._on_fresh: dict[str, FreshAnswers] = {}
        self._has_body = False
        self.unsolvable = 0

    def add(self, on_map: _OnMap, query: Endpoints, records: Records, exact: Plan) -> None:
        """Count what was measured on one query."""
        self._has_body = on_map.has_body
        cells, exact_s = on_map.case.cost.size, on_map.own_s(EXACT, records)
        for rival in self._rivals:
            plan, seconds = on_map.plan(rival, query), on_map.own_s(rival.key, records)
            self._answers[rival.key].add(plan, seconds, exact, exact_s, cells)
        eager = records.get(_FRESH + EXACT + EAGER)
        for name in on_map.fresh:
            arrived = self._on_fresh.setdefault(name.removeprefix(_FRESH), FreshAnswers())
            arrived.add(records[name], None if eager is None else 1e3 * eager.median_s, exact.cost)

    def rows(self) -> dict[str, Figures]:
        """By the rivals' keys; none where nothing was counted."""
        rows: dict[str, Figures] = {}
        for rival in self._rivals:
            answers = self._answers[rival.key]
            if not answers.time_ms:
                continue
            for lazy in (True, False):
                key = _key(rival, lazy)
                fresh = self._on_fresh.get(key)
                if not lazy and fresh is None:
                    continue
                rows[key] = {"method": rival.name + EAGER * (not lazy), "price": rival.price, **answers.figures()}
                rows[key]["unsolvable"] = self.unsolvable
                if self._has_body:
                    rows[key] |= answers.body_figures(eager=not lazy)
                if fresh is not None:
                    rows[key] |= fresh.figures()
        return rows


def _key(rival: RivalPlanner, lazy: bool) -> str:
    return rival.key + EAGER * (not lazy)


def _arriving(rival: RivalPlanner, case: Case, lazy: bool) -> FreshMap:
    """The rival on the case's map, with a network of its own: what that has been shown is not kept."""
    if case.ground is None:
        raise InvalidQueryError("a fresh map is made from elevations, got a case of costs alone")
    return FreshMap(replace(rival, model=rival.model and rival.model.share()), case.ground, lazy=lazy)
