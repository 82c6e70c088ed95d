"""A* as the paper had it: an explicit graph of the map, built anew for each query, then a search with `heapq`.

Plain Python, on purpose: it is the yardstick of the paper's speed-ups, and serves nothing else here. The
planners of this toolkit build no graph.
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
    """Nodes and edges of a map. Cell (row, col) is the node row · stride + col."""

    stride: int
    """Longer than a row of the map by one, so that no node has a neighbour across the map's edge."""
    edges: dict[int, list[tuple[int, float]]]
    """For each node its neighbours, and what the step to each costs."""

    def node(self, cell: Cell) -> int:
        """The node of a cell."""
        return cell[0] * self.stride + cell[1]

    def cell(self, node: int) -> Cell:
        """The cell of a node."""
        return divmod(node, self.stride)


def build_graph(cost: Float2D, inside: NDArray[np.bool_] | None = None, omega: float = PAPER_OMEGA) -> Graph:
    """The graph of a cost map: a node for each passable cell, an edge to each passable neighbour.

    Parameters
    ----------
    cost : (H, W) float32
        Traversability cost T in [0, 1]; impassable from 1 up, or NaN.
    inside : (H, W) bool, optional
        The heuristic region: the graph of its cells alone is built, as in Fig. 10.
    omega : float
        Weight of the traversability cost per grey level.

    Notes
    -----
    NNPP (arXiv 2308.04792v3), Eq. 2 and 4: a step costs L + 255·ω·(T_i + T_j).
    """
    passable = cost < 1.0
    stride = cost.shape[1] + 1
    rows, cols = np.nonzero(passable if inside is None else passable & inside)
    weights = cost[rows, cols].astype(np.float64) * (GREY_LEVELS * omega)
    weight = dict(zip((rows * stride + cols).tolist(), weights.tolist(), strict=True))
    straight, diagonal = (-stride, stride, -1, 1), (-stride - 1, -stride + 1, stride - 1, stride + 1)
    moves = [*((move, 1.0) for move in straight), *((move, SQRT2) for move in diagonal)]
    edges: dict[int, list[tuple[int, float]]] = {}
    for node, own in weight.items():
        edges[node] = []
        for move, length in moves:
            neighbour = node + move
            if neighbour in weight:
                edges[node].append((neighbour, length + own + weight[neighbour]))
    return Graph(stride, edges)


def search(graph: Graph, start: Cell, goal: Cell) -> list[Cell] | None:
    """The cheapest path in the graph from start to goal, both among its cells; None if there is none.

    The heuristic is the Euclidean distance, as in the paper.
    """
    first, last = graph.node(start), graph.node(goal)
    reached = {first: 0.0}
    parent: dict[int, int] = {}
    closed: set[int] = set()
    open_list = [(math.dist(start, goal), first)]
    while open_list:
        _, node = heapq.heappop(open_list)
        if node == last:
            return _trace(graph, parent, last)
        if node in closed:
            continue
        closed.add(node)
        for neighbour, step in graph.edges[node]:
            g = reached[node] + step
            if g < reached.get(neighbour, math.inf):
                reached[neighbour] = g
                parent[neighbour] = node
                h = math.dist(graph.cell(neighbour), goal)
                heapq.heappush(open_list, (g + h, neighbour))
    return None


def _trace(graph: Graph, parent: dict[int, int], last: int) -> list[Cell]:
    nodes = [last]
    while nodes[-1] in parent:
        nodes.append(parent[nodes[-1]])
    return [graph.cell(node) for node in reversed(nodes)]
