"""D* as the paper has it beside A*: an explicit graph of the map, repaired as the map changes, in plain Python.

The variant is D* Lite (Koenig and Likhachev 2002), which finds the same paths as D*.
"""

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.reproduction.plain_astar import build_graph, weights_of
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell

Key = tuple[float, float]
_ROUNDING = 1e-9
"""Share by which equal keys may differ: on level ground many are equal, and each must be expanded."""


class PlainDStar:
    """Plans to one goal again and again, keeping what it knows from one plan to the next; arguments as of A*."""

    def __init__(self, cost: Float2D, start: Cell, goal: Cell, inside: NDArray[np.bool_] | None = None) -> None:
        self._graph, self._weights = build_graph(cost, inside), weights_of(cost, inside)
        self._moves = self._graph.moves()
        self._start, self._goal, self._km = self._graph.node(start), self._graph.node(goal), 0.0
        self._g: dict[int, float] = {}
        self._rhs = {self._goal: 0.0}
        self._keys: dict[int, Key] = {}
        """Of the nodes on the open list; entries of the heap with another key have been overtaken."""
        self._heap: list[tuple[Key, int]] = []
        self._queue(self._goal)
        self.expansions = 0

    def move(self, start: Cell) -> None:
        """Plan from here on."""
        before, self._start = self._start, self._graph.node(start)
        self._km += self._distance(before, self._start)

    def change(self, cost: Float2D, inside: NDArray[np.bool_] | None = None) -> int:
        """The map, or the region, is another one from now on; the number of cells that have changed."""
        graph, weights = self._graph, weights_of(cost, inside)
        rows, cols = np.nonzero(weights != self._weights)
        changed = dict(zip((rows * graph.stride + cols).tolist(), weights[rows, cols].tolist(), strict=True))
        self._weights = weights
        for node, weight in changed.items():
            graph.weights.pop(node, None)
            if math.isfinite(weight):
                graph.weights[node] = weight
        affected = {node + move for node in changed for move, _ in ((0, 0.0), *self._moves)}
        for node in affected:
            graph.edges.pop(node, None)
            if node in graph.weights:
                graph.connect(node, self._moves)
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

    def _key(self, node: int) -> Key:
        least = min(self._g.get(node, math.inf), self._rhs.get(node, math.inf))
        return least + self._distance(self._start, node) + self._km, least

    def _distance(self, a: int, b: int) -> float:
        return math.dist(self._graph.cell(a), self._graph.cell(b))
