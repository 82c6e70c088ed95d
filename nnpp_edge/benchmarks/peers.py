"""Our planners beside other libraries' grid search, on the same maps and queries, in one
interleaved run.

The problem is the one that most of them can solve: a step costs its length times the mean weight of
the two cells, with weights 1 + 2·255·ω·T. What others minimise is said beside them, and the price
of their paths is counted by the common rule.
"""

import importlib
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version

import numpy as np

from nnpp_edge import __version__
from nnpp_edge.profiling.contest import Answer, Harness, RivalCalls, beside, priced
from nnpp_edge.profiling.rows import Facts, Row, Rows
from nnpp_edge.profiling.suites import Case, solvable, terrain_cases
from nnpp_edge.progress import Progress, ignore
from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.arrays import Cells, Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.terrain.step_cost import GREY_LEVELS, PAPER_OMEGA, StepModel
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.workloads import SOFT

REFERENCE = "astar"
SAME_OPTIMUM = 1e-4
"""Costs that differ by no more than this share count as the same."""
_LENGTH = "length × mean weight"
_FIGURES = "time_ms_median time_ms_p95 times_astar_median map_ms_median gap_mean gap_max"
Search = Callable[[Endpoints], Cells | None]
"""From start to goal: the path's cells, or None if there is none."""


@dataclass(frozen=True)
class PeerPlanner:
    """A planner of ours or of another library."""

    name: str
    package: str
    """Packages that must be installed."""
    objective: str
    """The sum that it minimises."""
    prepare: Callable[[Float2D], Search]
    """Do the work that depends on the map alone."""


def peer_planners() -> tuple[list[PeerPlanner], list[str]]:
    """Our planners, and the other libraries that are installed; the names of those that are not."""
    network = NetworkModel("edge", threads=1)
    methods = {"astar": "", "corridor": ", coarse to fine", "nnpp": ", in the network's region"}
    found = [
        PeerPlanner(method, "nnpp-edge", _LENGTH + how, partial(_ours, method, network))
        for method, how in methods.items()
    ]
    missing = []
    for modules, planner in _OTHERS.items():
        try:
            for module in modules:
                importlib.import_module(module)
            found.append(planner)
        except ImportError:
            missing.append(planner.package)
    return found, missing


def _ours(method: str, network: NetworkModel, weights: Float2D) -> Search:
    planner = Planner(weights, step_cost="length", model=network)

    def search(ends: Endpoints) -> Cells | None:
        plan = planner.plan(*ends, method=method)
        return plan.path if plan.ok else None

    return search


def _pyastar2d(weights: Float2D) -> Search:
    from pyastar2d import astar_path

    return lambda ends: astar_path(weights, *ends, allow_diagonal=True)


def _scikit_image(weights: Float2D) -> Search:
    from skimage.graph import MCP_Geometric

    search_all = MCP_Geometric(weights)

    def search(ends: Endpoints) -> Cells | None:
        start, goal = ends
        costs, _ = search_all.find_costs([start], [goal])
        return np.array(search_all.traceback(goal)) if math.isfinite(costs[goal]) else None

    return search


def _scipy(weights: Float2D) -> Search:
    from scipy.sparse.csgraph import dijkstra
    from skimage.graph import pixel_graph

    graph, cells = pixel_graph(  # type: ignore[no-untyped-call]
        weights.astype(np.float64),
        mask=np.isfinite(weights),
        edge_function=lambda one, other, length: 0.5 * length * (one + other),
        connectivity=2,
    )

    def search(ends: Endpoints) -> Cells | None:
        flat = np.ravel_multi_index(np.transpose(ends), weights.shape)
        source, node = np.searchsorted(cells, flat)
        distance, before = dijkstra(graph, indices=source, return_predecessors=True)
        if not math.isfinite(distance[node]):
            return None
        path = [node]
        while path[-1] != source:
            path.append(before[path[-1]])
        return np.stack(np.unravel_index(cells[path[::-1]], weights.shape), axis=1)

    return search


_OTHERS = {
    ("pyastar2d",): PeerPlanner(
        "pyastar2d", "pyastar2d", "weight of the cell entered, diagonals no longer", _pyastar2d
    ),
    ("skimage",): PeerPlanner("skimage.graph", "scikit-image", _LENGTH, _scikit_image),
    ("scipy", "skimage"): PeerPlanner(
        "scipy dijkstra", "scipy", f"{_LENGTH}, to every cell", _scipy
    ),
}
"""By the modules that must be importable; scikit-image makes the graph for scipy."""


def compare(
    planners: Sequence[PeerPlanner],
    cases: Iterable[Case],
    queries: int,
    *,
    progress: Progress = ignore,
) -> list[Facts]:
    """Have every planner answer the same queries on maps of one size, in turns: a row of figures
    for each.

    Our exact A*, `REFERENCE`, must be among them. `progress` is called with the number of queries
    that are done. Before the clock starts, each planner prepares the map (counted apart) and
    answers its first query.
    """
    harness = Harness()
    rows = Rows()
    done = 0
    for case in solvable(cases, queries):
        place = {"size": case.size, "terrain": case.terrain}
        # inf where impassable
        weights = (1.0 + 2.0 * GREY_LEVELS * PAPER_OMEGA * case.cost).astype(np.float32)
        searches = dict[str, Search]()
        for planner in planners:
            map_s, search = harness.timed(partial(planner.prepare, weights))
            search(case.queries[0])
            searches[planner.name] = search
            rows.append({"planner": planner.name, "map_ms": 1e3 * map_s})
        grid = Grid.of(weights, StepModel.of("length"))
        for records in harness.measure(searches, case.queries):
            reference = records[REFERENCE]
            optimum = _answer(grid, reference)
            for name, record in records.items():
                row: Row = {"planner": name, "time_ms": 1e3 * record.median_s}
                row["times_astar"] = record.median_s / reference.median_s
                rows.append(row | beside(_answer(grid, record), optimum))
            done += 1
            progress(done)
    return [place | _figures(planner, rows.of(planner.name)) for planner in planners]


def _answer(grid: Grid, record: RivalCalls[Endpoints, Cells | None]) -> Answer:
    """A planner's answer, priced; none unless it leads from start to goal."""
    path = record.results[0]
    if path is None or (tuple(path[0]), tuple(path[-1])) != record.case:
        path = np.empty((0, 2), np.int32)
    return priced(grid, np.asarray(path, np.int32))


def _figures(planner: PeerPlanner, rows: Rows) -> Facts:
    """All that a planner did."""
    answers = rows.having("time_ms")
    gaps = answers.all("gap")
    same = len(gaps) == len(answers) and max(map(abs, gaps), default=math.inf) <= SAME_OPTIMUM
    return {
        "planner": planner.name,
        "version": __version__ if planner.package == "nnpp-edge" else version(planner.package),
        "objective": planner.objective,
        "n": len(answers),
        "failed": len(answers) - len(gaps),
        **rows.figures(_FIGURES),
        "same_optimum": same,
    }


def run(
    sizes: Sequence[int],
    queries: int,
    dems: Sequence[Dem],
    *,
    seed: int = 1,
    progress: Progress = ignore,
) -> tuple[list[Facts], list[str]]:
    """The comparison at every size: rows of figures, and the packages that are not installed.

    Sizes that no terrain file is large enough for are run on synthetic terrain, and say so.
    """
    planners, missing = peer_planners()
    exercise()
    rows = list[Facts]()
    for at, size in enumerate(sorted(sizes)):
        cases = terrain_cases(dems, SOFT, size, seed)
        report = partial(lambda before, done: progress(before + done), at * queries)
        rows += compare(planners, cases, queries, progress=report)
    return rows, missing
