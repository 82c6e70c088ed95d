"""Every planner on the same queries, in one interleaved run, judged by the exact optimum."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product

import numpy as np

from nnpp_edge.outcome import outcome
from nnpp_edge.profiling.contest import Harness, RivalCalls, answer
from nnpp_edge.profiling.rivals import EXACT, FindsPlans, RivalPlanner
from nnpp_edge.profiling.rows import Facts, Row, Rows
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
_ANSWERS = (
    "gap_mean gap_p95 gap_p99 gap_max time_ms_median time_ms_p95 time_ms_p99 speedup_median "
    "expansions_median region_share_mean widened_share whole_map_share mm_mean mm_network_mean "
    "cc_mean"
)
_ON_FRESH_MAP = "time_ms_median time_ms_p99 speedup_median gap_mean gap_p99"
"""The figures of docs/reference/figures.md, see `Rows.figure`."""


def evaluate(
    cases: Iterable[Case],
    rivals: Sequence[RivalPlanner],
    queries: int,
    *,
    repeats: int = 3,
    fresh_map: bool = False,
    progress: Progress = ignore,
) -> Rows:
    """Have every planner, exact A* among them, answer the same queries: a row for each answer, and
    one for each on a fresh map, which says whether it was made `eager`.

    docs/evaluate.md says what counts. `queries` are judged by, fewer if the cases run out, each
    answered `repeats` times in turns. `progress` is called with the number that are done. All cases
    are a vehicle's, or none. With `fresh_map` a planner is also made of the elevations for each
    call, lazily and eagerly.

    InvalidQueryError for 50 maps in a row without a path.
    """
    exercise()
    harness = Harness()
    rows = Rows()
    done = in_vain = unsolvable = 0
    for case in cases:
        on_map = _OnMap(case, rivals, fresh_map)
        solvable = [query for query, plan in on_map.exact.items() if plan.ok]
        unsolvable += len(on_map.exact) - len(solvable)
        in_vain = 0 if solvable else in_vain + 1
        if in_vain == _MAPS_WITHOUT_PATH:
            raise InvalidQueryError(
                f"no query has a path on {in_vain} maps in a row of the workload {case.workload}"
            )
        on_map.warm_up()
        of_case = {"unsolvable": unsolvable, "poses": on_map.poses}
        wanted = solvable[: queries - done]
        for records in harness.measure(on_map.calls, wanted, repeats=repeats, after=on_map.forget):
            rows += [of_case | row for row in on_map.judged(records)]
            done += 1
            progress(done)
        if done >= queries:
            break
    return rows


def evaluated(rows: Rows) -> list[Facts]:
    """A row of figures for each planner, and for one that computes all costs of a fresh map first;
    docs/reference/figures.md says what they are.
    """
    found = []
    for name, answers in rows.by("planner").items():
        own = answers.having("region_share")
        for eager in (False, True):
            fresh = answers.of(eager=eager)
            if eager and not fresh:
                continue
            figures: Facts = {
                "method": name + EAGER * eager,
                "n": len(own),
                "success_raw": own.mean("first"),
                "success": own.mean("solved"),
                "speedup_total": own.ratio("exact_ms", "time_ms"),
                **own.figures(_ANSWERS),
                "unsolvable": max(row["unsolvable"] for row in rows),
            }
            if poses := own[0]["poses"]:
                figures["time_ms_p99_first"] = own.of(first=1.0).figure("time_ms_p99")
                figures |= own.figures("checks_mean checks_share_mean")
                if eager:
                    figures |= {"checks_mean": poses, "checks_share_mean": 1.0}
            if fresh:
                for key, figure in fresh.figures(_ON_FRESH_MAP).items():
                    figures[f"fresh_{key.removeprefix('time_')}"] = figure
                figures["fresh_ms_p99_first"] = fresh.of(first=1.0).figure("time_ms_p99")
                figures["costs_computed_mean"] = fresh.figure("costs_computed_mean")
            found.append(figures)
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
            name = _FRESH + rival.name + EAGER * (not lazy)
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

    def judged(self, records: Records) -> Iterator[Row]:
        """Rows of what was measured on a query."""
        exact_ms = self._own_ms(EXACT, records)
        eager = records.get(_FRESH + EXACT + EAGER)
        eager_ms = None if eager is None else 1e3 * eager.median_s
        query = next(iter(records.values())).case
        optimum = self.exact[query]
        for rival in self._rivals:
            name = rival.name
            plan = rival.plan(self._planner(rival), query, keep_regions=True)
            own = answer(plan, self._own_ms(name, records), optimum, exact_ms)
            yield {"planner": name, **own, **self._searched(plan, optimum)}
            for key in (name, name + EAGER):
                if record := records.get(_FRESH + key):
                    row = answer(record.results[0], 1e3 * record.median_s, optimum, eager_ms)
                    yield {"planner": name, "eager": key != name, **row}

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
