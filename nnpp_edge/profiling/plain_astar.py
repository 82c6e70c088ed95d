"""A* as the paper had it, in plain Python: an explicit graph of the map, and a search with `heapq`.

Slow on purpose: it is the yardstick of the paper's speed-ups. The planners of this toolkit build no
graph.
"""

import heapq
import math
from dataclasses import dataclass

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.terrain.step_cost import GREY_LEVELS, PAPER_OMEGA


@dataclass(frozen=True)
class Graph:
    """For each node its neighbours, with the costs of the steps to them.

    Cell (row, col) is node row · stride + col; stride is longer than a row by one, so that no node
    has a neighbour across the map's edge.
    """

    stride: int
    edges: dict[int, list[tuple[int, float]]]

    def node(self, cell: Cell) -> int:
        return cell[0] * self.stride + cell[1]

    def distance(self, a: int, b: int) -> float:
        """Euclidean distance of two nodes, in cells."""
        return math.dist(divmod(a, self.stride), divmod(b, self.stride))


def build_graph(cost: Float2D, inside: Bool | None = None) -> Graph:
    """The graph of a cost map, or of the cells in a region (Fig. 10).

    It has a node for each passable cell, T < 1, and an edge to each passable neighbour: a step
    costs L + 255·ω·(T_i + T_j) (Eq. 2 and 4).
    """
    stride = cost.shape[1] + 1
    moves = [
        (down * stride + across, math.hypot(down, across))
        for down in (-1, 0, 1)
        for across in (-1, 0, 1)
        if down or across
    ]
    passable = cost < 1.0 if inside is None else (cost < 1.0) & inside
    rows, cols = np.nonzero(passable)
    nodes = rows * stride + cols
    terms = cost[passable].astype(np.float64) * (GREY_LEVELS * PAPER_OMEGA)
    weights = dict(zip(nodes.tolist(), terms.tolist(), strict=True))
    edges = {}
    for node, own in weights.items():
        edges[node] = [
            (node + move, length + own + weights[node + move])
            for move, length in moves
            if node + move in weights
        ]
    return Graph(stride, edges)


def search(graph: Graph, start: Cell, goal: Cell) -> list[Cell] | None:
    """A*: the cheapest path in the graph from start to goal, both among its cells; None if there is
    none.

    The heuristic is the Euclidean distance, as in the paper.
    """
    first = graph.node(start)
    last = graph.node(goal)
    reached = {first: 0.0}
    parent = dict[int, int]()
    closed = set[int]()
    open_list = [(graph.distance(first, last), first)]
    while open_list:
        _, node = heapq.heappop(open_list)
        if node == last:
            nodes = [node]
            while nodes[-1] in parent:
                nodes.append(parent[nodes[-1]])
            return [divmod(node, graph.stride) for node in reversed(nodes)]
        if node in closed:
            continue
        closed.add(node)
        for neighbour, step in graph.edges[node]:
            g = reached[node] + step
            if g < reached.get(neighbour, math.inf):
                reached[neighbour] = g
                parent[neighbour] = node
                heapq.heappush(open_list, (g + graph.distance(neighbour, last), neighbour))
    return None
