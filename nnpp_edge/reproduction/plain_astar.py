"""A* as the paper had it: an explicit graph of the map, built anew for each query, then a search with `heapq`.

Plain Python, on purpose: it is the yardstick of the paper's speed-ups. The planners of this toolkit build no graph.
"""

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.map.step_cost import GREY_LEVELS, PAPER_OMEGA, SQRT2


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

    def moves(self) -> tuple[tuple[int, float], ...]:
        """The steps to the eight neighbours of a node, and their lengths."""
        straight, s = (-self.stride, self.stride, -1, 1), self.stride
        return tuple((move, 1.0 if move in straight else SQRT2) for move in (*straight, -s - 1, -s + 1, s - 1, s + 1))

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
    """The cheapest path in the graph from start to goal, both among its cells; None if there is none.

    The heuristic is the Euclidean distance, as in the paper.
    """
    first, last = graph.node(start), graph.node(goal)
    reached, parent, closed = {first: 0.0}, dict[int, int](), set[int]()
    open_list = [(math.dist(start, goal), first)]
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
                heapq.heappush(open_list, (g + math.dist(graph.cell(neighbour), goal), neighbour))
    return None
