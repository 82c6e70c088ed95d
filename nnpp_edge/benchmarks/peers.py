"""Our planners beside other libraries' grid search, on the same maps and queries, in one interleaved run.

The problem is the one that most of them can solve: a step costs its length times the mean weight of the two
cells, with weights 1 + 2·255·ω·T. scikit-image and scipy then solve the very same problem as our exact A*;
what the others minimise is said beside them, and the price of their paths is counted by the common rule.
"""

import importlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge import __version__
from nnpp_edge.profiling.suites import QUERIES_PER_MAP, SYNTHETIC, Case, TerrainSuite, synthetic_cases
from nnpp_edge.runtime.map.step_cost import GREY_LEVELS, PAPER_OMEGA
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.warmup import exercise
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.labels import Query
from nnpp_edge.terrain.workloads import SOFT

Weights = NDArray[np.float32]
Path2D = NDArray[np.integer]
Ask = Callable[[tuple[int, int], tuple[int, int]], Path2D | None]
"""From start to goal: the path's cells (N, 2), or None if there is none."""

REFERENCE = "astar"
SAME_OPTIMUM = 1e-4
"""Costs that differ by no more than this share count as the same."""
_LENGTH = "length × mean weight"


@dataclass(frozen=True)
class Contender:
    """A planner of ours or of another library."""

    name: str
    package: str
    """What must be installed."""
    objective: str
    """What it minimises."""
    prepare: Callable[[Weights], Ask]
    """Do the work that depends on the map alone."""


def _ours(method: str, objective: str) -> Contender:
    network: list[NetworkModel] = []

    def prepare(weights: Weights) -> Ask:
        if method == "nnpp" and not network:
            network.append(NetworkModel("edge", threads=1))
        planner = Planner(weights, step_cost="length", model=network[0] if network else "edge")

        def ask(start: tuple[int, int], goal: tuple[int, int]) -> Path2D | None:
            plan = planner.plan(start, goal, method=method)
            return plan.path if plan.ok else None

        return ask

    return Contender(method, "nnpp-edge", objective, prepare)


def _pyastar2d(weights: Weights) -> Ask:
    from pyastar2d import astar_path

    def ask(start: tuple[int, int], goal: tuple[int, int]) -> Path2D | None:
        return astar_path(weights, start, goal, allow_diagonal=True)

    return ask


def _scikit_image(weights: Weights) -> Ask:
    from skimage.graph import MCP_Geometric

    search = MCP_Geometric(weights)

    def ask(start: tuple[int, int], goal: tuple[int, int]) -> Path2D | None:
        costs, _ = search.find_costs([start], [goal])
        return np.array(search.traceback(goal)) if math.isfinite(costs[goal]) else None

    return ask


def _tcod(weights: Weights) -> Ask:
    from tcod.path import Pathfinder, SimpleGraph

    whole = np.where(np.isfinite(weights), np.rint(100.0 * weights), 0.0).astype(np.int32)  # 0 is impassable
    search = Pathfinder(SimpleGraph(cost=whole, cardinal=70, diagonal=99, greed=int(whole[whole > 0].min())))

    def ask(start: tuple[int, int], goal: tuple[int, int]) -> Path2D | None:
        search.clear()
        search.add_root(start)
        path = search.path_to(goal)
        return path if len(path) > 1 or start == goal else None

    return ask


def _scipy(weights: Weights) -> Ask:
    from scipy.sparse.csgraph import dijkstra

    graph, cols = _graph(weights), weights.shape[1]

    def ask(start: tuple[int, int], goal: tuple[int, int]) -> Path2D | None:
        source, node = start[0] * cols + start[1], goal[0] * cols + goal[1]
        distance, before = dijkstra(graph, indices=source, return_predecessors=True)
        if not math.isfinite(distance[node]):
            return None
        nodes = [node]
        while nodes[-1] != source:
            nodes.append(int(before[nodes[-1]]))
        return np.stack(np.divmod(nodes[::-1], cols), axis=1)

    return ask


def _graph(weights: Weights) -> Any:
    """The map as a sparse matrix of step costs, both ways."""
    from scipy.sparse import coo_array

    rows, cols = weights.shape
    nodes = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    parts = []
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = np.s_[: rows - i, max(-j, 0) : cols - max(j, 0)]
        there = np.s_[i:, max(j, 0) : cols + min(j, 0)]
        price = 0.5 * math.hypot(i, j) * (weights[here].astype(np.float64) + weights[there])
        open_ = np.isfinite(price)
        parts += [(price[open_], nodes[here][open_], nodes[there][open_])]
        parts += [(price[open_], nodes[there][open_], nodes[here][open_])]
    price, first, second = (np.concatenate(column) for column in zip(*parts, strict=True))
    return coo_array((price, (first, second)), shape=(rows * cols, rows * cols)).tocsr()


def contenders() -> tuple[list[Contender], list[str]]:
    """Our planners, and the other libraries that are installed; the names of those that are not."""
    ours = [_ours(REFERENCE, _LENGTH), _ours("corridor", f"{_LENGTH}, coarse to fine"),
            _ours("nnpp", f"{_LENGTH}, in the network's region")]  # fmt: skip
    others = [
        ("pyastar2d", "pyastar2d", "weight of the cell entered, diagonals no longer", _pyastar2d),
        ("skimage.graph", "scikit-image", _LENGTH, _scikit_image),
        ("tcod.path", "tcod", "length × weight entered, whole numbers", _tcod),
        ("scipy dijkstra", "scipy", f"{_LENGTH}, to every cell", _scipy),
    ]
    modules = {"scikit-image": "skimage"}
    found, missing = ours, []
    for name, package, objective, prepare in others:
        try:
            importlib.import_module(modules.get(package, package))
        except ImportError:
            missing.append(package)
        else:
            found.append(Contender(name, package, objective, prepare))
    return found, missing


def path_cost(weights: Weights, path: Path2D) -> float:
    """Length times mean weight, summed over a path's steps; inf if it is none on this map."""
    steps = np.abs(np.diff(path, axis=0))
    if len(steps) and steps.max() > 1:
        return math.inf
    along = weights[path[:, 0], path[:, 1]].astype(np.float64)
    return float(np.sum(np.hypot(*steps.T) * 0.5 * (along[1:] + along[:-1])))


@dataclass
class _Tally:
    """What one planner did at one size."""

    time_ms: list[float] = field(default_factory=list)
    against: list[float] = field(default_factory=list)
    """Its time over exact A*'s, query by query."""
    map_ms: list[float] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)
    failed: int = 0
    """Queries that exact A* answered and this one did not."""
    note: str = ""


def compare(
    planners: Sequence[Contender],
    cases: Iterator[Case],
    queries: int,
    *,
    limit_s: float = 5.0,
    expected_s: dict[str, float] | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, dict[str, Any]]:
    """Put the same queries to every planner, in turns.

    Parameters
    ----------
    planners : sequence of Contender
        Our exact A*, `REFERENCE`, among them.
    cases : iterator of Case
        Maps and queries of one size. Queries that exact A* finds no path for are passed over.
    queries : int
        How many to judge by.
    limit_s : float
        A planner that would take longer for a query is left out.
    expected_s : dict
        Time that a query is expected to take, by planner, where a smaller size has shown it.
    progress : callable
        Told how many queries are done.

    Returns
    -------
    dict
        A row of figures for each planner.

    Notes
    -----
    Before the clock starts, each planner prepares the map (counted apart) and answers the map's first query
    once: for ``nnpp`` that is when the network takes the map over.
    """
    tallies = {p.name: _Tally() for p in planners}
    for name, seconds in (expected_s or {}).items():
        if seconds > limit_s and name != REFERENCE:
            tallies[name].note = f"left out: about {seconds:.1f} s a query, over the limit of {limit_s:g} s"
    done = 0
    for case in cases:
        weights = (1.0 + 2.0 * GREY_LEVELS * PAPER_OMEGA * case.cost).astype(np.float32)
        asks: dict[str, Ask] = {}
        for p in planners:
            tally = tallies[p.name]
            if tally.note:
                continue
            began = time.perf_counter()
            ask = p.prepare(weights)
            tally.map_ms.append(1e3 * (time.perf_counter() - began))
            ask(*case.queries[0])  # compiles, allocates, takes the map over
            began = time.perf_counter()
            ask(*case.queries[0])
            seconds = time.perf_counter() - began
            if seconds > limit_s and p.name != REFERENCE and not tally.time_ms:
                tally.note = f"left out: {seconds:.1f} s a query, over the limit of {limit_s:g} s"
            else:
                asks[p.name] = ask
        for start, goal in case.queries:
            if done == queries:
                break
            if _answer(weights, asks, (start, goal), done, tallies):
                done += 1
                progress(done)
        if done == queries:
            break
    return {p.name: _row(p, tallies[p.name]) for p in planners}


def _answer(
    weights: Weights, asks: dict[str, Ask], query: Query, turn: int, tallies: dict[str, _Tally]
) -> bool:  # fmt: skip
    """Put one query to all and book it; False, and nothing booked, where exact A* finds no path."""
    names = list(asks)
    shift = turn % len(names)
    answers: dict[str, tuple[float, Path2D | None]] = {}
    for name in names[shift:] + names[:shift]:
        began = time.perf_counter()
        path = asks[name](*query)
        answers[name] = (1e3 * (time.perf_counter() - began), path)
    exact_ms, exact = answers[REFERENCE]
    if exact is None:
        return False
    optimum = path_cost(weights, exact)
    for name, (ms, path) in answers.items():
        tally = tallies[name]
        tally.time_ms.append(ms)
        tally.against.append(ms / exact_ms)
        if path is None or tuple(path[0]) != query[0] or tuple(path[-1]) != query[1]:
            tally.failed += 1
        else:
            tally.gaps.append(path_cost(weights, path) / optimum - 1.0 if optimum else 0.0)
    return True


def _row(planner: Contender, tally: _Tally) -> dict[str, Any]:
    def of(values: list[float], figure: Callable[[Any], Any]) -> float | None:
        return float(figure(values)) if tally.time_ms and values else None

    same = not tally.failed and bool(tally.gaps) and max(map(abs, tally.gaps)) <= SAME_OPTIMUM
    return {
        "planner": planner.name,
        "version": __version__ if planner.package == "nnpp-edge" else version(planner.package),
        "objective": planner.objective,
        "n": len(tally.time_ms),
        "failed": tally.failed,
        "time_ms_median": of(tally.time_ms, np.median),
        "time_ms_p95": of(tally.time_ms, lambda values: np.quantile(values, 0.95)),
        "times_astar_median": of(tally.against, np.median),
        "map_ms_median": of(tally.map_ms, np.median),
        "gap_mean": of(tally.gaps, np.mean),
        "gap_max": of(tally.gaps, np.max),
        "same_optimum": same if tally.time_ms else None,
        "note": tally.note or ("" if tally.time_ms else "no query had a path"),
    }


def run(
    sizes: Sequence[int],
    queries: int,
    terrain: Sequence[Path],
    *,
    rescale: float | None = None,
    cell_size: float | None = None,
    seed: int = 1,
    limit_s: float = 5.0,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[list[dict[str, Any]], list[str]]:
    """The comparison at every size: rows of figures, and the packages that are not installed.

    Sizes that no terrain file is large enough for are run on synthetic terrain, and say so.
    """
    planners, missing = contenders()
    exercise()
    dems = [read_dem(path, cell_size_m=cell_size) for path in terrain]
    dems = [dem if rescale is None else dem.rescaled(rescale) for dem in dems]
    rows: list[dict[str, Any]] = []
    known: dict[str, tuple[int, float]] = {}
    """The last size that a planner was measured at, or thought too slow for, and seconds a query."""
    for at, size in enumerate(sorted(sizes)):
        source, cases = _cases(dems, size, seed, -(-queries // QUERIES_PER_MAP))
        expected = {name: seconds * (size / side) ** 2 for name, (side, seconds) in known.items()}
        figures = compare(
            planners, cases, queries, limit_s=limit_s, expected_s=expected,
            progress=lambda done, at=at: progress(at * queries + done),  # type: ignore[misc]
        )  # fmt: skip
        for name, row in figures.items():
            if row["time_ms_median"] is not None:
                known[name] = (size, 1e-3 * row["time_ms_median"])
            elif row["note"]:
                known.setdefault(name, (size, 2.0 * limit_s))
        rows += [{"size": size, "terrain": source} | row for row in figures.values()]
    return rows, missing


def _cases(dems: Sequence[Dem], size: int, seed: int, maps: int) -> tuple[str, Iterator[Case]]:
    """Where the maps come from, and maps of one size: enough of them, and some for queries without a path."""
    fitting = [dem for dem in dems if min(dem.elevation.shape) >= size]
    if fitting:
        names = ", ".join(dict.fromkeys(dem.source.stem for dem in fitting))
        suite = TerrainSuite(tuple(dem.source for dem in fitting), sizes=(size,), seed=seed)
        return names, islice(suite.cases(fitting, SOFT, size), 4 * maps)
    return SYNTHETIC, islice(synthetic_cases(SOFT, size, seed), 4 * maps)
