"""A run's figures: what each planner did at each workload and size, as rows of a report."""

from collections.abc import Sequence

from nnpp_edge.profiling.arrivals import patch_side
from nnpp_edge.profiling.quantities import BASES, QUANTITIES, THOUSANDTH
from nnpp_edge.profiling.rows import Facts, Rows
from nnpp_edge.runtime.loop.settings import OnboardLoop

STAGES = ("encode", "inference", "threshold", "coarse", "search", "path", "other")
"""Of a plan, in the order of work."""
_COUNTS = ("planned", "kept", "without_path", "late")
"""Of the loop's answers."""


def results(answers: Rows) -> list[Facts]:
    """A row for each workload, size and planner, in order: ``results`` in
    docs/reference/figures.md.
    """
    return [_result(rows) for rows in answers.groups(("workload", "size", "planner")).values()]


def _result(rows: Rows) -> Facts:
    """Of one planner's answers; a query's time is the mean of both halves."""
    queries = rows.averaged("query")
    stages = stages_of(rows)
    taken = Rows(dict.fromkeys(stages, 0.0) | row["stages_ms"] for row in rows)
    halves = {
        basis: [figure(half) for half in rows.by("half").values()]
        for basis, figure in BASES.items()
        if figure(rows) is not None
    }
    quantities = QUANTITIES.items()
    return {
        **{key: rows[0][key] for key in ("workload", "size", "terrain", "planner")},
        "n": len(queries),
        **{key: queries.spread(key) for key in ("time_ms", "map_ms", "patch_ms")},
        "stages_ms": {stage: taken.spread(stage) for stage in stages},
        **{name: kind.figure(queries) for name, kind in quantities if kind.figure is not None},
        "halves": halves,
    }


def stages_of(rows: Sequence[Facts]) -> list[str]:
    """The stages of all rows, in the order of work."""
    found = {stage for row in rows for stage in row["stages_ms"]}
    return [*(stage for stage in STAGES if stage in found), *sorted(found - set(STAGES))]


def loop_rows(reactions: Rows, loop: OnboardLoop) -> list[Facts]:
    """A row for each workload and size at which the reactions of this loop were measured."""
    found: list[Facts] = []
    for (workload, size), rows in reactions.groups(("workload", "size")).items():
        counts = {key: round(sum(rows.all(key))) for key in _COUNTS}
        reaction_ms = rows.spread("reaction_ms") or {}
        if len(rows) >= THOUSANDTH:
            reaction_ms["p999"] = rows.figure("reaction_ms_p999")
        halves = [half.figure("reaction_ms_median") for half in rows.by("half").values()]
        found.append(
            {
                "workload": workload,
                "size": size,
                "method": loop.method,
                "rate_hz": loop.rate_hz,
                "patch_side": patch_side((size, size)),
                "n": len(rows),
                "reaction_ms": reaction_ms,
                "late_per_hour": 3600.0 * counts["late"] * loop.rate_hz / len(rows),
                **counts,
                "halves": {"reaction": halves},
            }
        )
    return found
