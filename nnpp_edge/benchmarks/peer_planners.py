"""Grid search of ours and of other libraries, behind one call: from start to goal on a map of weights."""

import functools
import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.ground import whole_cost
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.step_cost import GREY_LEVELS, PAPER_OMEGA
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.planner import Planner, plan_path

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Weights = NDArray[np.float32]
CellPath = NDArray[np.integer]
"""Cells (N, 2)."""
Search = Callable[[Cell, Cell], CellPath | None]
"""From start to goal: the path's cells, or None if there is none."""
_LENGTH = "length × mean weight"


@dataclass(frozen=True)
class PeerPlanner:
    """A planner of ours or of another library."""

    name: str
    package: str
    """Packages that must be installed."""
    objective: str
    """The sum that it minimises."""
    prepare: Callable[[Weights], Search]
    """Do the work that depends on the map alone."""
    once: Callable[[Weights, Endpoints], CellPath | None] | None = None
    """From weights to one path, where that is another call than `prepare` and a search."""
    of_elevation: Callable[[Ground, Endpoints], CellPath | None] | None = None
    """From elevations to one path; None for who knows weights alone."""

    def plan_once(self, weights: Weights, query: Endpoints) -> CellPath | None:
        """From weights to one path, nothing being kept."""
        return self.once(weights, query) if self.once is not None else self.prepare(weights)(*query)

    def plan_on(self, ground: Ground, query: Endpoints) -> CellPath | None:
        """From elevations to one path; a library without cost maps of its own gets ours."""
        if self.of_elevation is not None:
            return self.of_elevation(ground, query)
        return self.plan_once(weights_of(whole_cost(ground)), query)


def weights_of(cost: Float2D) -> Weights:
    """The weights that all planners are given, 1 + 2·255·ω·T; inf where impassable."""
    return (1.0 + 2.0 * GREY_LEVELS * PAPER_OMEGA * cost).astype(np.float32)


def peer_planners() -> tuple[list[PeerPlanner], list[str]]:
    """Our planners, and the other libraries that are installed; the names of those that are not."""
    found = [
        _ours("astar", _LENGTH),
        _ours("corridor", f"{_LENGTH}, coarse to fine"),
        _ours("nnpp", f"{_LENGTH}, in the network's region"),
    ]
    missing = []
    for module, planner in _OTHERS.items():
        try:
            importlib.import_module(module)
        except ImportError:
            missing.append(planner.package)
        else:
            found.append(planner)
    return found, missing


def _ours(method: str, objective: str) -> PeerPlanner:
    @functools.cache
    def network() -> NetworkModel:
        return NetworkModel("edge", threads=1)

    def model() -> str | NetworkModel:
        """A network of one's own: maps that are planned on once must not be shown to that of a standing map."""
        return network().share() if method == "nnpp" else "edge"

    def prepare(weights: Weights) -> Search:
        planner = Planner(weights, step_cost="length", model=model())
        return lambda start, goal: _path(planner.plan(start, goal, method=method))

    def once(weights: Weights, query: Endpoints) -> CellPath | None:
        return _path(plan_path(weights, *query, method, "length", model=model()))

    def of_elevation(ground: Ground, query: Endpoints) -> CellPath | None:
        return _path(Planner(ground, model=model()).plan(*query, method=method))

    return PeerPlanner(method, "nnpp-edge", objective, prepare, once, of_elevation)


def _path(plan: Plan) -> CellPath | None:
    return plan.path if plan.ok else None


def _pyastar2d(weights: Weights) -> Search:
    from pyastar2d import astar_path

    return lambda start, goal: astar_path(weights, start, goal, allow_diagonal=True)


def _scikit_image(weights: Weights) -> Search:
    from skimage.graph import MCP_Geometric

    search_all = MCP_Geometric(weights)

    def search(start: Cell, goal: Cell) -> CellPath | None:
        costs, _ = search_all.find_costs([start], [goal])
        return np.array(search_all.traceback(goal)) if math.isfinite(costs[goal]) else None

    return search


def _tcod(weights: Weights) -> Search:
    from tcod.path import Pathfinder, SimpleGraph

    whole = np.where(np.isfinite(weights), np.rint(100.0 * weights), 0.0).astype(np.int32)  # 0 is impassable
    finder = Pathfinder(SimpleGraph(cost=whole, cardinal=70, diagonal=99, greed=int(whole[whole > 0].min())))

    def search(start: Cell, goal: Cell) -> CellPath | None:
        finder.clear()
        finder.add_root(start)
        path = finder.path_to(goal)
        return path if len(path) > 1 or start == goal else None

    return search


def _scipy(weights: Weights) -> Search:
    from scipy.sparse.csgraph import dijkstra

    graph, cols = _graph(weights), weights.shape[1]

    def search(start: Cell, goal: Cell) -> CellPath | None:
        source, node = start[0] * cols + start[1], goal[0] * cols + goal[1]
        distance, before = dijkstra(graph, indices=source, return_predecessors=True)
        if not math.isfinite(distance[node]):
            return None
        nodes = [node]
        while nodes[-1] != source:
            nodes.append(int(before[nodes[-1]]))
        return np.stack(np.divmod(nodes[::-1], cols), axis=1)

    return search


def _graph(weights: Weights) -> "csr_array":
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


_OTHERS = {
    "pyastar2d": PeerPlanner("pyastar2d", "pyastar2d", "weight of the cell entered, diagonals no longer", _pyastar2d),
    "skimage": PeerPlanner("skimage.graph", "scikit-image", _LENGTH, _scikit_image),
    "tcod": PeerPlanner("tcod.path", "tcod", "length × weight entered, whole numbers", _tcod),
    "scipy": PeerPlanner("scipy dijkstra", "scipy", f"{_LENGTH}, to every cell", _scipy),
}
"""By the module that must be importable."""
