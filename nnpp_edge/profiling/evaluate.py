"""Every planner on the same queries, in one interleaved run, judged by the exact optimum."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial

from nnpp_edge.outcome import outcome
from nnpp_edge.profiling.contest import Harness, RivalCalls, answer
from nnpp_edge.profiling.quantities import EXACT
from nnpp_edge.profiling.rivals import Answers, OnMap, RivalPlanner
from nnpp_edge.profiling.rows import Facts, Row, Rows
from nnpp_edge.profiling.suites import Case, solvable
from nnpp_edge.progress import Progress, ignore
from nnpp_edge.runtime.cells import Endpoints
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

    docs/evaluate.md says what counts. `queries` are judged by, each answered `repeats` times in
    turns. `progress` is called with the number that are done. All cases are a vehicle's, or none.
    With `fresh_map` a planner is also made of the elevations for each call, lazily and eagerly.

    InvalidQueryError if too few queries have a path.
    """
    exercise()
    harness = Harness()
    rows = Rows()
    done = 0
    for case in solvable(cases, queries):
        of_body = case.ground.vehicle is not None
        on_map = OnMap(case, rivals, lazy=of_body)
        of_case = {"unsolvable": case.unsolvable, "poses": _poses(case)}
        kept: list[Answers] = []
        for rival in rivals:
            make = partial(rival.on, case.ground)
            if fresh_map or of_body:
                fresh = partial(_from_elevations, make, kept)
                on_map.calls[_FRESH + rival.name] = fresh
            if fresh_map:
                eager = partial(_from_elevations, partial(make, lazy=False), kept)
                on_map.calls[_FRESH + rival.name + EAGER] = eager
        for call in on_map.calls.values():  # outside the time that counts
            call(case.queries[0])
        for records in harness.measure(
            on_map.calls,
            case.queries,
            repeats=repeats,
            before=on_map.renew,
            after=lambda *_, kept=kept: kept.clear(),
        ):
            rows += [row | of_case for row in _judged(rivals, on_map, records)]
            done += 1
            progress(done)
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
                "success_raw": own.mean("found"),
                "success": own.mean("solved"),
                "speedup_total": own.ratio("exact_ms", "time_ms"),
                **own.figures(_ANSWERS),
                "unsolvable": max(row["unsolvable"] for row in rows),
            }
            if poses := own[0]["poses"]:
                figures["time_ms_p99_first"] = own.of(found=1.0).figure("time_ms_p99")
                checks = poses if eager else own.mean("checks")
                figures |= {"checks_mean": checks, "checks_share_mean": checks / poses}
            if fresh:
                for key, figure in fresh.figures(_ON_FRESH_MAP).items():
                    figures[f"fresh_{key.removeprefix('time_')}"] = figure
                figures["fresh_ms_p99_first"] = fresh.of(found=1.0).figure("time_ms_p99")
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


def _from_elevations(make: Callable[[], Answers], kept: list[Answers], query: Endpoints) -> Plan:
    """From elevations to the plan; the planner is kept, so that it ends after the clock."""
    planner = make()
    kept.append(planner)
    return planner(query)


def _judged(rivals: Iterable[RivalPlanner], on_map: OnMap, records: Records) -> Iterator[Row]:
    """Rows of what was measured on a query."""
    query = records[EXACT].case
    optimum = records[EXACT].results[0]
    exact_ms = 1e3 * records[EXACT].median_s
    eager = records.get(_FRESH + EXACT + EAGER)
    eager_ms = None if eager is None else 1e3 * eager.median_s
    for name in [rival.name for rival in rivals]:
        on_map.renew(name)
        plan = on_map.calls[name](query, keep_regions=True)
        own = answer(plan, 1e3 * records[name].median_s, optimum, exact_ms)
        searched: Row = {
            "widened": plan.source is Source.WIDENED,
            "whole_map": plan.source is Source.FALLBACK,
            "region_share": 1.0,
        }
        if plan.network_region is not None:  # at the threshold itself
            beside = (plan.cost, optimum.cost, len(optimum.path), plan.network_region)
            searched["mm_network"] = outcome(*beside)["mm"]
        yield {"planner": name, **searched, **own}
        for end in ("", EAGER):
            if record := records.get(_FRESH + name + end):
                row = answer(record.results[0], 1e3 * record.median_s, optimum, eager_ms)
                yield {"planner": name, **row, "eager": bool(end)}
