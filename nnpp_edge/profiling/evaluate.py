"""Every planner on the same queries, in one interleaved run, judged by the exact optimum."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product

from nnpp_edge.outcome import outcome
from nnpp_edge.profiling.contest import Harness, RivalCalls, answer
from nnpp_edge.profiling.rivals import EXACT, FindsPlans, OnMap, RivalPlanner
from nnpp_edge.profiling.rows import Facts, Row, Rows
from nnpp_edge.profiling.suites import Case
from nnpp_edge.progress import Progress, ignore
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT
from nnpp_edge.runtime.map.ground import Ground
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
        of_body = case.ground.vehicle is not None
        on_map = OnMap(case, rivals, lazy=of_body)
        solvable = list(filter(case.connections(), case.queries))
        unsolvable += len(case.queries) - len(solvable)
        in_vain = 0 if solvable else in_vain + 1
        if in_vain == _MAPS_WITHOUT_PATH:
            raise InvalidQueryError(
                f"no query has a path on {in_vain} maps in a row of the workload {case.workload}"
            )
        calls = dict(on_map.calls)
        kept: list[FindsPlans] = []
        for rival, lazy in product(rivals, [True] * (fresh_map or of_body) + [False] * fresh_map):
            name = _FRESH + rival.name + EAGER * (not lazy)
            calls[name] = partial(_from_elevations, rival.apart(), case.ground, lazy, kept)
        for call in calls.values():  # outside the time that counts
            call(case.queries[0])
        of_case = {"unsolvable": unsolvable, "poses": _poses(case)}
        wanted = solvable[: queries - done]
        for records in harness.measure(
            calls,
            wanted,
            repeats=repeats,
            before=on_map.renew,
            after=lambda *_, kept=kept: kept.clear(),
        ):
            for name, row in _judged(on_map, records):
                checks = row.get("checks", 0) / max(of_case["poses"], 1)
                rows.append({"planner": name, **row, **of_case, "checks_share": checks})
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


def _poses(case: Case) -> int:
    """Of a vehicle's body on the map; 0 of a point."""
    body = case.ground.vehicle
    if body is None:
        return 0
    motions = all_motions(body, case.ground.sides_m)
    return int(motions.poses_of[2 * AXIS_COUNT]) * case.cost.size


def _from_elevations(
    rival: RivalPlanner, ground: Ground, lazy: bool, kept: list[FindsPlans], query: Endpoints
) -> Plan:
    """From elevations to the plan; the planner is kept, so that it ends after the clock."""
    planner = rival.planner(ground, lazy=lazy)
    kept.append(planner)
    return rival.plan(planner, query)


def _judged(on_map: OnMap, records: Records) -> Iterator[tuple[str, Row]]:
    """Rows of what was measured on a query, by planner."""
    eager = records.get(_FRESH + EXACT + EAGER)
    eager_ms = None if eager is None else 1e3 * eager.median_s
    query = records[EXACT].case
    optimum = records[EXACT].results[0]
    for name in on_map.calls:
        on_map.renew(name)
        plan = on_map.plan(name, query, keep_regions=True)
        exact_ms = 1e3 * records[EXACT].median_s
        own = answer(plan, 1e3 * records[name].median_s, optimum, exact_ms)
        yield name, own | _searched(plan, optimum)
        for key in (name, name + EAGER):
            if record := records.get(_FRESH + key):
                row = answer(record.results[0], 1e3 * record.median_s, optimum, eager_ms)
                yield name, row | {"eager": key != name}


def _searched(plan: Plan, optimum: Plan) -> Row:
    """Cells and poses that a plan's search went over, its regions kept.

    MM is that of the region that was searched, where one was, and of the network's at the threshold
    itself.
    """
    found: Row = {
        "widened": plan.source is Source.WIDENED,
        "whole_map": plan.source is Source.FALLBACK,
        "region_share": 1.0,
    }
    beside = (plan.cost, optimum.cost, len(optimum.path))
    if plan.region is not None:
        searched = outcome(*beside, plan.region)
        found |= {"region_share": searched["share"], "mm": searched["mm"]}
    if plan.network_region is not None:
        found["mm_network"] = outcome(*beside, plan.network_region)["mm"]
    return found
