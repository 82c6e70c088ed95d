"""Every planner on the same queries, in one interleaved run, judged by the exact optimum."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product

import numpy as np

from nnpp_edge.outcome import outcome
from nnpp_edge.profiling.contest import (
    Figures,
    Harness,
    RivalCalls,
    Row,
    answer,
    mean,
    quantile,
    ratio,
    summarised,
)
from nnpp_edge.profiling.rivals import EXACT, FindsPlans, RivalPlanner
from nnpp_edge.profiling.suites import Case
from nnpp_edge.progress import Progress, ignore
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT
from nnpp_edge.runtime.planners.plan import Plan, Source
from nnpp_edge.runtime.robots.body.motions import all_motions

Records = Mapping[str, RivalCalls[Endpoints, Plan]]
"""Measurements on a query, by the names of the calls."""
EAGER = "-eager"
"""Ends the name of a planner that computes all costs of a fresh map before it plans."""
_FRESH = "fresh map: "
"""Before the names of planners that are measured on fresh maps beside others of the same name."""
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
"""The figures of docs/reference/figures.md."""
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
    progress: Progress = ignore,
    rows: dict[str, list[Row]] | None = None,
) -> dict[str, Figures]:
    """Have every planner, exact A* among them, answer the same queries: a row of figures for each
    planner's key, in order.

    docs/evaluate.md says what counts, docs/reference/figures.md what the figures are. `queries` are
    judged by, fewer if the cases run out, each answered `repeats` times in turns. `progress` is
    called with the number that are done. All cases are a vehicle's, or none. With `fresh_map` a
    planner is also made of the elevations for each call, lazily and eagerly. `rows` is filled with
    each planner's answers, in the order of the queries.

    InvalidQueryError for 50 maps in a row without a path.
    """
    exercise()
    harness = Harness()
    rows = {} if rows is None else rows
    done = in_vain = unsolvable = poses = 0
    for case in cases:
        on_map = _OnMap(case, rivals, fresh_map)
        poses = on_map.poses
        solvable = [query for query, plan in on_map.exact.items() if plan.ok]
        unsolvable += len(on_map.exact) - len(solvable)
        in_vain = 0 if solvable else in_vain + 1
        if in_vain == _MAPS_WITHOUT_PATH:
            raise InvalidQueryError(
                f"no query has a path on {in_vain} maps in a row of the workload {case.workload}"
            )
        on_map.warm_up()
        wanted = solvable[: queries - done]
        for records in harness.measure(on_map.calls, wanted, repeats=repeats, after=on_map.forget):
            for name, row in on_map.judged(records):
                rows.setdefault(name, []).append(row)
            done += 1
            progress(done)
        if done >= queries:
            break

    found: dict[str, Figures] = {}
    for rival, lazy in product(rivals, (True, False)):
        key = _key(rival, lazy)
        answers = rows.get(rival.name)
        on_fresh = rows.get(_FRESH + key)
        if not answers or not (lazy or on_fresh):
            continue
        figures = {"method": key, **summarised(answers, _ANSWERS), "unsolvable": unsolvable}
        if poses:
            every_pose = {"checks_mean": poses, "checks_share_mean": 1.0}
            figures |= summarised(answers, _OF_BODY) | ({} if lazy else every_pose)
        if on_fresh:
            figures |= summarised(on_fresh, _ON_FRESH_MAP)
        found[key] = figures
    return found


class _OnMap:
    """The rivals on the map of one case, as functions of a query."""

    def __init__(self, case: Case, rivals: Sequence[RivalPlanner], fresh_map: bool) -> None:
        body = case.ground.vehicle
        self._case = case
        self._rivals = rivals
        self.poses = 0
        """Of a vehicle's body on the map; 0 of a point."""
        if body is not None:
            motions = all_motions(body, case.ground.sides_m)
            self.poses = int(motions.poses_of[2 * AXIS_COUNT]) * case.cost.size
        self._kept: FindsPlans | None = None
        self.calls: dict[str, Callable[[Endpoints], Plan]] = {}
        self._standing: dict[str, FindsPlans] = {}
        for rival in rivals if body is None else ():
            planner = rival.planner(case.standing, lazy=False)
            self._standing[rival.name] = planner
            self.calls[rival.name] = partial(rival.plan, planner)
        # with a vehicle each answer is that of a planner that has checked no pose before
        lazily = fresh_map or body is not None
        for rival, lazy in product(rivals, [True] * lazily + [False] * fresh_map):
            name = _FRESH + _key(rival, lazy)
            self.calls[name] = partial(self._from_elevations, rival.apart(), lazy)

        exact = next(rival for rival in rivals if rival.name == EXACT)
        planner = self._planner(exact)
        self.exact = {query: exact.plan(planner, query) for query in case.queries}
        """Optima, and answers to queries without a path."""

    def warm_up(self) -> None:
        """Make each call once, outside the time that counts."""
        for call in self.calls.values():
            call(self._case.queries[0])
            self.forget()

    def forget(self, *_: object) -> None:
        """Give a fresh map's planner back after a call, outside the time that counts."""
        self._kept = None

    def _from_elevations(self, rival: RivalPlanner, lazy: bool, query: Endpoints) -> Plan:
        """From elevations to the plan; the planner is kept until `forget`."""
        self._kept = rival.planner(self._case.ground, lazy=lazy)
        return rival.plan(self._kept, query)

    def judged(self, records: Records) -> Iterator[tuple[str, Row]]:
        """Rows of what was measured on a query, by planner."""
        exact_ms = self._own_ms(EXACT, records)
        eager = records.get(_FRESH + EXACT + EAGER)
        eager_ms = None if eager is None else 1e3 * eager.median_s
        query = next(iter(records.values())).case
        optimum = self.exact[query]
        for rival in self._rivals:
            plan = rival.plan(self._planner(rival), query, keep_regions=True)
            own = answer(plan, self._own_ms(rival.name, records), optimum.cost, exact_ms)
            yield rival.name, own | self._searched(plan, optimum)
        for name, record in records.items():
            if name.startswith(_FRESH):
                plan = record.results[0]
                yield name, answer(plan, 1e3 * record.median_s, optimum.cost, eager_ms)

    def _searched(self, plan: Plan, optimum: Plan) -> Row:
        """Cells and poses that a plan's search went over, its regions kept.

        MM is that of the region that was searched, where one was, and of the network's at the
        threshold itself.
        """
        found: Row = {
            "checks": plan.checks,
            "checks_share": plan.checks / max(self.poses, 1),
            "widened": plan.source is Source.WIDENED,
            "whole_map": plan.source is Source.FALLBACK,
            "region_share": 1.0,
        }
        beside = (plan.cost, optimum.cost, len(optimum.path))
        if plan.region is not None:
            searched = outcome(*beside, plan.region)
            found["region_share"] = searched["share"]
            found["mm"] = searched["mm"]
        if plan.network_region is not None:
            found["mm_network"] = outcome(*beside, plan.network_region)["mm"]
        return found

    def _own_ms(self, name: str, records: Records) -> float:
        """An answer's time: with a vehicle without the making of the planner."""
        if self._standing:
            return 1e3 * records[name].median_s
        plans = records[_FRESH + name].results
        return float(np.median([plan.timings_ms.get("total", 0.0) for plan in plans]))

    def _planner(self, rival: RivalPlanner) -> FindsPlans:
        return self._standing[rival.name] if self._standing else rival.planner(self._case.ground)


def _key(rival: RivalPlanner, lazy: bool) -> str:
    return rival.name + EAGER * (not lazy)
