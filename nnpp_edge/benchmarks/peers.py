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
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import islice

import numpy as np

from nnpp_edge import __version__
from nnpp_edge.benchmarks.peer_planners import CellPath, PeerPlanner, Search, Weights, peer_planners, weights_of
from nnpp_edge.profiling.contest import Figures, Row, Summary, gap, mean, quantile, summarised
from nnpp_edge.profiling.ground import Ground
from nnpp_edge.profiling.harness import Harness, Record
from nnpp_edge.profiling.suites import QUERIES_PER_MAP, Case, TerrainFiles, cases_from, source_of
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.terrain.workloads import SOFT

REFERENCE = "astar"
_FRESH_QUERIES = 3
"""Of a map, that are also asked with nothing kept: some libraries take many times longer to set up than to search."""
SAME_OPTIMUM = 1e-4
"""Costs that differ by no more than this share count as the same."""


def path_cost(weights: Weights, path: CellPath) -> float:
    """Length times mean weight, summed over a path's steps; inf if it is none on this map."""
    steps = np.abs(np.diff(path, axis=0))
    if len(steps) and steps.max() > 1:
        return math.inf
    along = weights[path[:, 0], path[:, 1]].astype(np.float64)
    return float(np.sum(np.hypot(*steps.T) * 0.5 * (along[1:] + along[:-1])))


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


@dataclass
class _Comparison:
    """Planners at one size."""

    planners: Sequence[PeerPlanner]
    limit_s: float
    harness: Harness
    rows: list[Row] = field(default_factory=list)
    notes: dict[str, str] = field(default_factory=dict)
    """Why a planner was left out."""

    def figures(self, planner: PeerPlanner) -> Figures:
        """All that a planner did."""
        rows = [row for row in self.rows if row.rival == planner.name]
        answered = any("time_ms" in row.figures for row in rows)
        gaps = [abs(row.figures["gap"]) for row in rows if "gap" in row.figures]
        same = bool(gaps) and max(gaps) <= SAME_OPTIMUM and not any(row.figures.get("failed") for row in rows)
        facts: Figures = {
            "planner": planner.name,
            "version": __version__ if planner.package == "nnpp-edge" else version(planner.package),
            "objective": planner.objective,
            **summarised(rows if answered else (), _FIGURES),
            "same_optimum": same if answered else None,
            "note": self.notes.get(planner.name) or ("" if answered else "no query had a path"),
        }
        return facts

    def add(self, records: Mapping[str, Record[Endpoints, CellPath | None]], figure: str) -> None:
        """Count the time of a query as this figure, of every planner."""
        for name, record in records.items():
            self.rows.append(Row(name, record.case, {figure: 1e3 * record.median_s}))

    def on_map(self, case: Case, queries: int, progress: Callable[[], None]) -> None:
        """Have every planner answer at most so many queries on one map."""
        weights = weights_of(case.cost)
        searches = self._prepared(weights, case.queries[0])
        answered: list[Endpoints] = []
        for records in self.harness.measure(searches, case.queries):
            exact = records[REFERENCE].results[0]
            if exact is None:
                continue
            query, exact_s = records[REFERENCE].case, records[REFERENCE].median_s
            optimum = path_cost(weights, exact)
            for name, record in records.items():
                path, found = record.results[0], {"time_ms": 1e3 * record.median_s}
                found |= {"times_astar": record.median_s / exact_s, "failed": True}
                if path is not None and (tuple(path[0]), tuple(path[-1])) == query:
                    found |= {"failed": False, "gap": gap(path_cost(weights, path), optimum)}
                self.rows.append(Row(name, query, found))
            answered.append(query)
            progress()
            if len(answered) == queries:
                break
        self._on_fresh_map(list(searches), weights, case.ground, answered[:_FRESH_QUERIES])

    def _on_fresh_map(
        self, names: Sequence[str], weights: Weights, ground: Ground | None, queries: Sequence[Endpoints]
    ) -> None:
        """Have these planners answer queries with nothing kept: from weights, and from elevations where there are."""
        planners = {planner.name: planner for planner in self.planners if planner.name in names}
        once = {name: _once(planner, weights) for name, planner in planners.items()}
        arriving = {name: _arriving(planner, ground) for name, planner in planners.items() if ground is not None}
        for records in self.harness.measure(once, queries, warm_up=queries[:1]):
            self.add(records, "once_ms")
        for records in self.harness.measure(arriving, queries, warm_up=queries[:1]):
            self.add(records, "elevation_ms")

    def _prepared(self, weights: Weights, first: Endpoints) -> dict[str, Callable[[Endpoints], CellPath | None]]:
        """Every planner that is within the limit, ready for a map: compiled, allocated, its network shown the map."""
        found: dict[str, Callable[[Endpoints], CellPath | None]] = {}
        for planner in self.planners:
            if planner.name in self.notes:
                continue
            map_s, search = self.harness.timed(lambda planner=planner: planner.prepare(weights))  # type: ignore[misc]
            search(*first)
            seconds, _ = self.harness.timed(lambda search=search: search(*first))  # type: ignore[misc]
            tried = any(row.rival == planner.name for row in self.rows)
            self.rows.append(Row(planner.name, first, {"map_ms": 1e3 * map_s}))
            if seconds > self.limit_s and planner.name != REFERENCE and not tried:
                self.notes[planner.name] = f"left out: {seconds:.1f} s a query, over the limit of {self.limit_s:g} s"
            else:
                found[planner.name] = _of_query(search)
        return found


def _once(planner: PeerPlanner, weights: Weights) -> Callable[[Endpoints], CellPath | None]:
    return lambda query: planner.plan_once(weights, *query)


def _arriving(planner: PeerPlanner, ground: Ground) -> Callable[[Endpoints], CellPath | None]:
    return lambda query: planner.plan_on(ground, *query)


def _of_query(search: Search) -> Callable[[Endpoints], CellPath | None]:
    return lambda query: search(*query)


def compare(
    planners: Sequence[PeerPlanner],
    cases: Iterator[Case],
    queries: int,
    *,
    limit_s: float = 5.0,
    expected_s: dict[str, float] | None = None,
    harness: Harness | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, Figures]:
    """Have every planner answer the same queries on maps of one size, in turns: a row of figures for each.

    Our exact A*, `REFERENCE`, must be among them; queries that it finds no path for are passed over. A planner that
    would take longer than `limit_s` for a query is left out; `expected_s` is the time by planner that a smaller size
    has shown. `progress` is called with the number of queries that are done.

    Notes
    -----
    Before the clock starts, each planner prepares the map (counted apart) and answers the map's first query
    once: for ``nnpp`` that is when the network is shown the map.
    """
    comparison = _Comparison(planners, limit_s, harness or Harness())
    for name, seconds in (expected_s or {}).items():
        if seconds > limit_s and name != REFERENCE:
            note = f"left out: about {seconds:.1f} s a query, over the limit of {limit_s:g} s"
            comparison.notes[name] = note
    done = 0

    def one_done() -> None:
        nonlocal done
        done += 1
        progress(done)

    for case in cases:
        comparison.on_map(case, queries - done, one_done)
        if done == queries:
            break
    return {planner.name: comparison.figures(planner) for planner in planners}


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
    dems = terrain.read()
    rows: list[Figures] = []
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
