"""Paths: what they cost, whether they can be walked, and how far changes of the map can matter to
them.
"""

from numpy import float64, inf, int64

from nnpp_edge.runtime.compiled.kernel import inlined, kernel
from nnpp_edge.runtime.kernels.nodes import COL, ROW, beside_wall, octile, step_cost
from nnpp_edge.runtime.kernels.records import GridRecord
from nnpp_edge.runtime.kernels.tiles import open_at


@inlined
def step_to(path, n):
    """Rows and columns from the cell before to cell n of a path."""
    here = path[n]
    before = path[n - 1]
    return here[ROW] - before[ROW], here[COL] - before[COL]


@inlined
def node_on(path, n, stride):
    """The node of cell n of a path."""
    return (path[n, ROW] + 1) * stride + path[n, COL] + 1


@kernel
def measure(grid: GridRecord, path):
    """Cost of a path of cells, straight and diagonal steps, and the sum of the cells' weights."""
    terms = grid.steps
    straight = 0
    diagonal = 0
    by_straight = 0.0
    by_diagonal = 0.0
    total = 0.0
    before = 0.0
    for n in range(len(path)):
        open_at(grid.tiles, path[n, ROW], path[n, COL])  # a search may not have read it
        weight = float64(grid.weights[node_on(path, n, grid.stride)])
        total += weight
        if n > 0:
            down, right = step_to(path, n)
            if down != 0 and right != 0:
                diagonal += 1
                by_diagonal += before + weight
            else:
                straight += 1
                by_straight += before + weight
        before = weight
    cost = terms.length_straight * straight + terms.length_diagonal * diagonal
    cost += terms.weight_straight * by_straight + terms.weight_diagonal * by_diagonal
    return cost, straight, diagonal, total


@kernel
def remember(nodes, old_weights, before, noted, touched, count):
    """Note what changed nodes weighed before, unless that is noted; how many nodes are
    noted now.
    """
    for n in range(len(nodes)):
        node = nodes[n]
        if not noted[node]:
            noted[node] = True
            before[node] = old_weights[n]
            touched[count] = node
            count += 1
    return count


@kernel
def savings(weights, before, touched, count, stride, at, goal, prices):
    """Savings of the nodes that became cheaper, and the least octile distances by way of one of
    them.

    The sum of the weights saved by those that were passable; the least distance by way of these;
    and by way of those that were not. `at` and `goal` are (row, col), `prices` those of a straight
    and of a diagonal step.
    """
    row, col = at
    goal_row, goal_col = goal
    h_straight, h_diagonal = prices
    saved = 0.0
    by_cheaper = inf
    by_opened = inf
    for n in range(count):
        node = int64(touched[n])
        now = float64(weights[node])
        then = float64(before[node])
        if now < then:
            i = node // stride - 1
            j = node % stride - 1
            distance = octile(row, col, i, j, h_straight, h_diagonal)
            distance += octile(i, j, goal_row, goal_col, h_straight, h_diagonal)
            if then < inf:
                saved += then - now
                by_cheaper = min(by_cheaper, distance)
            else:
                by_opened = min(by_opened, distance)
    return saved, by_cheaper, by_opened


@kernel
def walk(grid: GridRecord, path, first, costs):
    """Costs of a path from its cell `first` to each of the later ones; the first that cannot be
    stepped on, or -1.
    """
    terms = grid.steps
    weights = grid.weights
    stride = grid.stride
    total = 0.0
    for n in range(first, len(path)):
        open_at(grid.tiles, path[n, ROW], path[n, COL])
        node = node_on(path, n, stride)
        if weights[node] == inf:
            return n
        if n > first:
            down, right = step_to(path, n)
            diagonal = down != 0 and right != 0
            before = node - down * stride - right
            checked = diagonal and not grid.corner_cutting
            if checked and beside_wall(weights, before, down * stride, right):
                return n
            pair = float64(weights[before]) + float64(weights[node])
            total += step_cost(diagonal, pair, terms)
        costs[n] = total
    return -1
