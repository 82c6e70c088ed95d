"""Grid search of ours and of other libraries, behind one call: from start to goal on a map of weights."""

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.planner import Planner

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Weights = NDArray[np.float32]
CellPath = NDArray[np.integer]
"""Cells (N, 2)."""
Search = Callable[[Cell, Cell], CellPath | None]
"""From start to goal: the path's cells, or None if there is none."""
_LENGTH, _ENTERED = "length × mean weight", "weight of the cell entered, diagonals no longer"


@dataclass(frozen=True)
class PeerPlanner:
    """A planner of ours or of another library."""

    name: str
    package: str
    """What must be installed."""
    objective: str
    """What it minimises."""
    prepare: Callable[[Weights], Search]
    """Do the work that depends on the map alone."""


def peer_planners() -> tuple[list[PeerPlanner], list[str]]:
    """Our planners, and the other libraries that are installed; the names of those that are not."""
    found = [
        _ours("astar", _LENGTH),
        _ours("corridor", f"{_LENGTH}, coarse to fine"),
        _ours("nnpp", f"{_LENGTH}, in the network's region"),
    ]
    missing = []
    for module, planner in _OTHERS:
        try:
            importlib.import_module(module)
        except ImportError:
            missing.append(planner.package)
        else:
            found.append(planner)
    return found, missing


def _ours(method: str, objective: str) -> PeerPlanner:
    network: list[NetworkModel] = []

    def prepare(weights: Weights) -> Search:
        if method == "nnpp" and not network:
            network.append(NetworkModel("edge", threads=1))
        planner = Planner(weights, step_cost="length", model=network[0] if network else "edge")

        def search(start: Cell, goal: Cell) -> CellPath | None:
            plan = planner.plan(start, goal, method=method)
            return plan.path if plan.ok else None

        return search

    return PeerPlanner(method, "nnpp-edge", objective, prepare)


def _pyastar2d(weights: Weights) -> Search:
    from pyastar2d import astar_path

    def search(start: Cell, goal: Cell) -> CellPath | None:
        path: CellPath | None = astar_path(weights, start, goal, allow_diagonal=True)
        return path

    return search


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


_OTHERS = (
    (
        "pyastar2d",
        PeerPlanner("pyastar2d", "pyastar2d", "weight of the cell entered, diagonals no longer", _pyastar2d),
    ),
    ("skimage", PeerPlanner("skimage.graph", "scikit-image", _LENGTH, _scikit_image)),
    ("tcod", PeerPlanner("tcod.path", "tcod", "length × weight entered, whole numbers", _tcod)),
    ("scipy", PeerPlanner("scipy dijkstra", "scipy", f"{_LENGTH}, to every cell", _scipy)),
)
"""The module that must be importable, and the planner."""
