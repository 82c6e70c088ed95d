"""Our planners beside other libraries' grid search, on the same maps and queries, in one interleaved run.

The problem is the one that most of them can solve: a step costs its length times the mean weight of the two
cells, with weights 1 + 2·255·ω·T. scikit-image and scipy then solve the very same problem as our exact A*;
what the others minimise is said beside them, and the price of their paths is counted by the common rule.

Beside a plan on a standing map stand one-off use, from weights to a path with nothing kept (ours by `plan_path`), and
a map that has just arrived, from elevations to a path: ours by `Planner.of_elevation`, in the paper's step costs; the
others, which know no terrain, get their weights from our `traversability_cost`, on the clock.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib.metadata import version
from itertools import islice

import numpy as np

from nnpp_edge import __version__
from nnpp_edge.benchmarks.peer_planners import CellPath, PeerPlanner, Weights, peer_planners, weights_of
from nnpp_edge.profiling.contest import Figures, Row, Summary, gap, mean, quantile, summarised
from nnpp_edge.profiling.harness import Harness
from nnpp_edge.profiling.suites import QUERIES_PER_MAP, Case, TerrainFiles, cases_from, source_of
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.terrain.workloads import SOFT

REFERENCE = "astar"
_FRESH_QUERIES = 3
"""Of a map, that are also asked with nothing kept: some libraries take many times longer to set up than to search."""
SAME_OPTIMUM = 1e-4
"""Costs that differ by no more than this share count as the same."""
_FIGURES: Summary = {
    "n": lambda columns: len(columns["time_ms"]),
    "failed": lambda columns: int(sum(columns["failed"])),
    "time_ms_median": quantile("time_ms", 0.5),
    "time_ms_p95": quantile("time_ms", 0.95),
    "times_astar_median": quantile("times_astar", 0.5),
    "map_ms_median": quantile("map_ms", 0.5),
    "once_ms_median": quantile("once_ms", 0.5),
    "elevation_ms_median": quantile("elevation_ms", 0.5),
    "gap_mean": mean("gap"),
    "gap_max": quantile("gap", 1.0),
}


def path_cost(weights: Weights, path: CellPath) -> float:
    """Length times mean weight, summed over a path's steps; inf if it is none on this map."""
    steps = np.abs(np.diff(path, axis=0))
    if len(steps) and steps.max() > 1:
        return math.inf
    along = weights[path[:, 0], path[:, 1]].astype(np.float64)
    return float(np.sum(np.hypot(*steps.T) * 0.5 * (along[1:] + along[:-1])))


def compare(
    planners: Sequence[PeerPlanner],
    cases: Iterator[Case],
    queries: int,
    *,
    limit_s: float = 5.0,
    expected_s: Mapping[str, float] | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, Figures]:
    """Have every planner answer the same queries on maps of one size, in turns: a row of figures for each.

    Our exact A*, `REFERENCE`, must be among them; queries that it finds no path for are passed over. A planner that
    takes longer than `limit_s` for a query is left out, and one that would by `expected_s`, the time by planner that
    a smaller size has shown. `progress` is called with the number of queries that are done. Before the clock starts,
    each planner prepares the map (counted apart) and answers the map's first query once.
    """
    harness, rows, done = Harness(), list[Row](), 0
    left_out = {
        name: f"left out: about {seconds:.1f} s a query, over the limit of {limit_s:g} s"
        for name, seconds in (expected_s or {}).items()
        if seconds > limit_s and name != REFERENCE
    }
    for case in cases:
        weights, searches = weights_of(case.cost), dict[str, Callable[[Endpoints], CellPath | None]]()
        for planner in (each for each in planners if each.name not in left_out):
            map_s, search = harness.timed(partial(planner.prepare, weights))
            search(*case.queries[0])
            seconds, _ = harness.timed(partial(search, *case.queries[0]))
            tried = any(row.rival == planner.name for row in rows)
            rows.append(Row(planner.name, case.queries[0], {"map_ms": 1e3 * map_s}))
            if seconds > limit_s and planner.name != REFERENCE and not tried:
                left_out[planner.name] = f"left out: {seconds:.1f} s a query, over the limit of {limit_s:g} s"
            else:
                searches[planner.name] = lambda query, search=search: search(*query)  # type: ignore[misc]
        answered = list[Endpoints]()
        for records in harness.measure(searches, case.queries):
            exact, query = records[REFERENCE].results[0], records[REFERENCE].case
            if exact is None:
                continue
            for name, record in records.items():
                found = {"time_ms": 1e3 * record.median_s, "failed": True}
                found["times_astar"] = record.median_s / records[REFERENCE].median_s
                path = record.results[0]
                if path is not None and (tuple(path[0]), tuple(path[-1])) == query:
                    optimum = path_cost(weights, exact)
                    found |= {"failed": False, "gap": gap(path_cost(weights, path), optimum)}
                rows.append(Row(name, query, found))
            answered.append(query)
            done += 1
            progress(done)
            if done == queries:
                break
        taking_part = [planner for planner in planners if planner.name in searches]
        fresh = {"once_ms": {each.name: partial(each.plan_once, weights) for each in taking_part}}
        if case.ground is not None:
            fresh["elevation_ms"] = {each.name: partial(each.plan_on, case.ground) for each in taking_part}
        for figure, calls in fresh.items():
            again = answered[:_FRESH_QUERIES]
            for records in harness.measure(calls, again, warm_up=again[:1]):
                rows += [Row(name, record.case, {figure: 1e3 * record.median_s}) for name, record in records.items()]
        if done == queries:
            break
    return {planner.name: _figures(planner, rows, left_out.get(planner.name)) for planner in planners}


def _figures(planner: PeerPlanner, rows: Sequence[Row], note: str | None) -> Figures:
    """All that a planner did."""
    own = [row for row in rows if row.rival == planner.name]
    answered = any("time_ms" in row.figures for row in own)
    gaps = [abs(row.figures["gap"]) for row in own if "gap" in row.figures]
    same = bool(gaps) and max(gaps) <= SAME_OPTIMUM and not any(row.figures.get("failed") for row in own)
    return {
        "planner": planner.name,
        "version": __version__ if planner.package == "nnpp-edge" else version(planner.package),
        "objective": planner.objective,
        **summarised(own if answered else (), _FIGURES),
        "same_optimum": same if answered else None,
        "note": note or ("" if answered else "no query had a path"),
    }


def run(
    sizes: Sequence[int],
    queries: int,
    terrain: TerrainFiles,
    *,
    seed: int = 1,
    limit_s: float = 5.0,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[list[Figures], list[str]]:
    """The comparison at every size: rows of figures, and the packages that are not installed.

    Sizes that no terrain file is large enough for are run on synthetic terrain, and say so.
    """
    planners, missing = peer_planners()
    exercise()
    dems, rows = terrain.read(), list[Figures]()
    known: dict[str, tuple[int, float]] = {}
    """The last size that a planner was measured at, or thought too slow for, and seconds a query."""
    for at, size in enumerate(sorted(sizes)):
        # enough maps, and some for queries without a path
        cases = islice(cases_from(dems, SOFT, size, seed), 4 * -(-queries // QUERIES_PER_MAP))
        expected = {name: seconds * (size / side) ** 2 for name, (side, seconds) in known.items()}

        def of_size(done: int, before: int = at * queries) -> None:
            progress(before + done)

        figures = compare(planners, cases, queries, limit_s=limit_s, expected_s=expected, progress=of_size)
        for name, row in figures.items():
            if isinstance(median_ms := row["time_ms_median"], float):
                known[name] = (size, 1e-3 * median_ms)
            elif row["note"]:
                known.setdefault(name, (size, 2.0 * limit_s))
        rows += [{"size": size, "terrain": source_of(dems, size), **row} for row in figures.values()]
    return rows, missing
