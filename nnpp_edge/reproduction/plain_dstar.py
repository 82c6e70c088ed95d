"""D* as the paper has it beside A*: an explicit graph of the map, mended as the map changes, in plain Python.

Plain Python, on purpose, as `plain_astar` is: it is the yardstick of the paper's speed-ups of D*NN. The variant is
D* Lite (Koenig and Likhachev 2002), which finds the same paths as D*.
"""

import heapq
import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.reproduction.plain_astar import build_graph
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.map.step_cost import GREY_LEVELS, PAPER_OMEGA, SQRT2

Key = tuple[float, float]
_ROUNDING = 1e-9
"""Share by which equal keys may differ: on level ground many are equal, and each must be expanded."""


class PlainDStar:
    """Plans to one goal again and again, keeping what it knows from one plan to the next.

    Parameters
    ----------
    cost : (H, W) float32
        Traversability cost T in [0, 1]; impassable from 1 up, or NaN.
    start, goal : (row, col)
        Passable cells.
    inside : (H, W) bool, optional
        The heuristic region: the graph of its cells alone is built.
    omega : float
        Weight of the traversability cost per grey level.
    """

    def __init__(
        self,
        cost: Float2D,
        start: Cell,
        goal: Cell,
        inside: NDArray[np.bool_] | None = None,
        omega: float = PAPER_OMEGA,
    ) -> None:
        self._graph, self._factor = build_graph(cost, inside, omega), GREY_LEVELS * omega
        self._weights = self._weights_of(cost, inside)
        self._start, self._goal = self._graph.node(start), self._graph.node(goal)
        self._last, self._km = self._start, 0.0
        self._g: dict[int, float] = {}
        self._rhs = {self._goal: 0.0}
        self._keys: dict[int, Key] = {}
        """Of the nodes on the open list; entries of the heap with another key have been overtaken."""
        self._heap: list[tuple[Key, int]] = []
        self._queue(self._goal)
        self.expansions = 0

    def move(self, start: Cell) -> None:
        """Plan from here on."""
        self._start = self._graph.node(start)
        self._km += self._distance(self._last, self._start)
        self._last = self._start

    def change(self, cost: Float2D, inside: NDArray[np.bool_] | None = None) -> int:
        """The map, or the region, is another one from now on; the number of cells that have changed."""
        weights = self._weights_of(cost, inside)
        rows, cols = np.nonzero(~((weights == self._weights) | (np.isinf(weights) & np.isinf(self._weights))))
        self._weights = weights
        changed = (rows * self._graph.stride + cols).tolist()
        affected = {node + move for node in changed for move in (0, *self._moves())}
        for node in affected:
            self._set_edges(node)
        for node in affected:
            self._look_ahead(node)
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
        """Expand until the start is as near to the goal as it can be known to be."""
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
                self._look_ahead(node)
                for there, _ in edges.get(node, ()):
                    self._look_ahead(there)

    def _look_ahead(self, node: int) -> None:
        """What a node's neighbours say of its distance to the goal."""
        if node != self._goal:
            steps: Iterable[tuple[int, float]] = self._graph.edges.get(node, ())
            self._rhs[node] = min((step + self._g.get(there, math.inf) for there, step in steps), default=math.inf)
        self._queue(node)

    def _queue(self, node: int) -> None:
        """Put a node on the open list, under its key now, or take it off where the two distances agree."""
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

    def _moves(self) -> tuple[int, ...]:
        stride = self._graph.stride
        return -stride, stride, -1, 1, -stride - 1, -stride + 1, stride - 1, stride + 1

    def _set_edges(self, node: int) -> None:
        """The edges of a node, anew."""
        if math.isinf(own := self._weight(node)):
            self._graph.edges.pop(node, None)
            return
        edges = []
        for at, move in enumerate(self._moves()):
            if not math.isinf(weight := self._weight(node + move)):
                edges.append((node + move, (1.0 if at < 4 else SQRT2) + own + weight))
        self._graph.edges[node] = edges

    def _weight(self, node: int) -> float:
        """What a cell adds to a step to or from it; inf outside the graph."""
        row, col = self._graph.cell(node)
        rows, cols = self._weights.shape
        return float(self._weights[row, col]) if 0 <= row < rows and col < cols else math.inf

    def _weights_of(self, cost: Float2D, inside: NDArray[np.bool_] | None) -> NDArray[np.float64]:
        passable = (cost < 1.0) if inside is None else (cost < 1.0) & inside
        return np.where(passable, cost.astype(np.float64) * self._factor, np.inf)
