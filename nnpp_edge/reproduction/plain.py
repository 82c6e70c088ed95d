"""A* and D* as the paper had them, in plain Python: an explicit graph of the map, and searches with `heapq`.

Slow on purpose: they are the yardstick of the paper's speed-ups. The planners of this toolkit build no graph.
"""

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.map.step_cost import GREY_LEVELS, PAPER_OMEGA, SQRT2

_ROUNDING = 1e-9
"""Share by which equal keys of D* may differ: on level ground many are equal, and each must be expanded."""


@dataclass(frozen=True)
class Graph:
    """For each node its weight, and its neighbours with the costs of the steps to them.

    Cell (row, col) is node row · stride + col; stride is longer than a row by one, so that no node has a neighbour
    across the map's edge.
    """

    stride: int
    weights: dict[int, float]
    edges: dict[int, list[tuple[int, float]]]

    def node(self, cell: Cell) -> int:
        """The node of a cell."""
        return cell[0] * self.stride + cell[1]

    def cell(self, node: int) -> Cell:
        """The cell of a node."""
        return divmod(node, self.stride)

    def distance(self, a: int, b: int) -> float:
        """Euclidean distance of two nodes, in cells."""
        return math.dist(divmod(a, self.stride), divmod(b, self.stride))

    def moves(self) -> tuple[tuple[int, float], ...]:
        """The steps to the eight neighbours of a node, and their lengths."""
        ways = [(down, across) for down in (-1, 0, 1) for across in (-1, 0, 1) if down or across]
        return tuple((down * self.stride + across, SQRT2 if down and across else 1.0) for down, across in ways)

    def connect(self, node: int, moves: tuple[tuple[int, float], ...]) -> None:
        """Set a node's edges by the weights: a step costs L + 255·ω·(T_i + T_j) (Eq. 2 and 4)."""
        own, weights = self.weights[node], self.weights
        self.edges[node] = [
            (node + move, length + own + weights[node + move]) for move, length in moves if node + move in weights
        ]


def weights_of(cost: Float2D, inside: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
    """(H, W) 255·ω·T at the paper's ω; inf where impassable, and outside a region if one is given."""
    passable = cost < 1.0 if inside is None else (cost < 1.0) & inside
    return np.where(passable, cost.astype(np.float64) * (GREY_LEVELS * PAPER_OMEGA), np.inf)


def build_graph(cost: Float2D, inside: NDArray[np.bool_] | None = None) -> Graph:
    """The graph of a cost map, of a region's cells alone if one is given (Fig. 10).

    It has a node for each passable cell, T < 1, and an edge to each passable neighbour.
    """
    weights, stride = weights_of(cost, inside), cost.shape[1] + 1
    rows, cols = np.nonzero(np.isfinite(weights))
    graph = Graph(stride, dict(zip((rows * stride + cols).tolist(), weights[rows, cols].tolist(), strict=True)), {})
    moves = graph.moves()
    for node in graph.weights:
        graph.connect(node, moves)
    return graph


def search(graph: Graph, start: Cell, goal: Cell) -> list[Cell] | None:
    """A*: the cheapest path in the graph from start to goal, both among its cells; None if there is none.

    The heuristic is the Euclidean distance, as in the paper.
    """
    first, last = graph.node(start), graph.node(goal)
    reached, parent, closed = {first: 0.0}, dict[int, int](), set[int]()
    open_list = [(graph.distance(first, last), first)]
    while open_list:
        _, node = heapq.heappop(open_list)
        if node == last:
            nodes = [node]
            while nodes[-1] in parent:
                nodes.append(parent[nodes[-1]])
            return [graph.cell(node) for node in reversed(nodes)]
        if node in closed:
            continue
        closed.add(node)
        for neighbour, step in graph.edges[node]:
            g = reached[node] + step
            if g < reached.get(neighbour, math.inf):
                reached[neighbour], parent[neighbour] = g, node
                heapq.heappush(open_list, (g + graph.distance(neighbour, last), neighbour))
    return None


class PlainDStar:
    """D*: plans to one goal again and again; the graph and the search are repaired as the map changes.

    The variant is D* Lite (Koenig and Likhachev 2002), which finds the same paths. Arguments as of `build_graph`.
    """

    def __init__(self, cost: Float2D, start: Cell, goal: Cell, inside: NDArray[np.bool_] | None = None) -> None:
        self._graph, self._weights = build_graph(cost, inside), weights_of(cost, inside)
        self._start, self._goal, self._km = self._graph.node(start), self._graph.node(goal), 0.0
        self._g: dict[int, float] = {}
        self._rhs = {self._goal: 0.0}
        self._keys: dict[int, tuple[float, float]] = {}
        """Of the nodes on the open list; entries of the heap with another key have been overtaken."""
        self._heap: list[tuple[tuple[float, float], int]] = []
        self._queue(self._goal)
        self.expansions = 0

    def move(self, start: Cell) -> None:
        """Plan from here on."""
        before, self._start = self._start, self._graph.node(start)
        self._km += self._graph.distance(before, self._start)

    def change(self, cost: Float2D, inside: NDArray[np.bool_] | None = None) -> int:
        """The map, or the region, is another one from now on; the number of cells that have changed."""
        graph, weights, moves = self._graph, weights_of(cost, inside), self._graph.moves()
        rows, cols = np.nonzero(weights != self._weights)
        changed = dict(zip((rows * graph.stride + cols).tolist(), weights[rows, cols].tolist(), strict=True))
        self._weights = weights
        for node, weight in changed.items():
            graph.weights.pop(node, None)
            if math.isfinite(weight):
                graph.weights[node] = weight
        affected = {node + move for node in changed for move, _ in ((0, 0.0), *moves)}
        for node in affected:
            graph.edges.pop(node, None)
            if node in graph.weights:
                graph.connect(node, moves)
        for node in affected:
            self._update(node)
        return len(changed)

    def plan(self) -> list[Cell] | None:
        """The cheapest path from the start to the goal; None if there is none."""
        self._search()
        if math.isinf(self._rhs.get(self._start, math.inf)):
            return None
        path, edges, g = [self._start], self._graph.edges, self._g
        while path[-1] != self._goal:
            _, node = min((step + g.get(there, math.inf), there) for there, step in edges[path[-1]])
            path.append(node)
            assert len(path) <= len(edges)
        return [self._graph.cell(node) for node in path]

    def _search(self) -> None:
        """Expand until the start's distance to the goal is known."""
        g, rhs, edges = self._g, self._rhs, self._graph.edges
        while self._heap:
            old, node = self._heap[0]
            if self._keys.get(node) != old:
                heapq.heappop(self._heap)
                continue
            start_g, start_rhs = (of.get(self._start, math.inf) for of in (g, rhs))
            if start_g == start_rhs and old[0] > (start_rhs + self._km) * (1.0 + _ROUNDING):
                return
            if old < self._key(node):
                self._queue(node)
                continue
            self.expansions += 1
            if g.get(node, math.inf) > rhs[node]:
                g[node] = rhs[node]
                self._queue(node)
                for there, step in edges.get(node, ()):
                    if step + g[node] < rhs.get(there, math.inf):
                        rhs[there] = step + g[node]
                        self._queue(there)
            else:
                g[node] = math.inf
                for there in (node, *(there for there, _ in edges.get(node, ()))):
                    self._update(there)

    def _update(self, node: int) -> None:
        """Compute a node's one-step lookahead `rhs` from its neighbours."""
        if node != self._goal:
            steps = self._graph.edges.get(node, ())
            self._rhs[node] = min((step + self._g.get(there, math.inf) for there, step in steps), default=math.inf)
        self._queue(node)

    def _queue(self, node: int) -> None:
        """Put a node on the open list under its key now, or take it off where `g` and `rhs` agree."""
        if self._g.get(node, math.inf) == self._rhs.get(node, math.inf):
            self._keys.pop(node, None)
        elif self._keys.get(node) != (key := self._key(node)):
            self._keys[node] = key
            heapq.heappush(self._heap, (key, node))

    def _key(self, node: int) -> tuple[float, float]:
        least = min(self._g.get(node, math.inf), self._rhs.get(node, math.inf))
        return least + self._graph.distance(self._start, node) + self._km, least
