"""Paths: what they cost, whether they can be walked, and how far changes of the map can matter to
them.
"""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.nodes import octile


@kernel
def measure(weights, stride, path):
    """Straight and diagonal steps, weights summed over straight and over diagonal steps, and over
    cells.
    """
    straight = 0
    diagonal = 0
    by_straight = 0.0
    by_diagonal = 0.0
    total = 0.0
    before = 0.0
    for n in range(len(path)):
        w = np.float64(weights[(path[n, 0] + 1) * stride + path[n, 1] + 1])
        total += w
        if n == 0:
            pass
        elif path[n, 0] != path[n - 1, 0] and path[n, 1] != path[n - 1, 1]:
            diagonal += 1
            by_diagonal += before + w
        else:
            straight += 1
            by_straight += before + w
        before = w
    return straight, diagonal, by_straight, by_diagonal, total


@kernel
def remember(nodes, old_weights, before, noted, stamp, touched, count):
    """Note what changed nodes weighed before, unless that is noted; how many nodes are
    noted now.
    """
    for n in range(len(nodes)):
        node = nodes[n]
        if noted[node] != stamp:
            noted[node] = stamp
            before[node] = old_weights[n]
            touched[count] = node
            count += 1
    return count


@kernel
def savings(weights, before, touched, count, stride, at, goal, prices):
    """Savings of the nodes that became cheaper, and the least octile distances by way of one of
    them.

    The sum of the weights saved by those that were passable; the least distance by way of these;
    and by way of those that were not.
    """
    saved = 0.0
    by_cheaper = np.inf
    by_opened = np.inf
    for n in range(count):
        node = np.int64(touched[n])
        now = np.float64(weights[node])
        then = np.float64(before[node])
        if now < then:
            r = node // stride - 1
            c = node % stride - 1
            distance = octile(at[0], at[1], r, c, prices[0], prices[1])
            distance += octile(r, c, goal[0], goal[1], prices[0], prices[1])
            if then < np.inf:
                saved += then - now
                by_cheaper = min(by_cheaper, distance)
            else:
                by_opened = min(by_opened, distance)
    return saved, by_cheaper, by_opened


@kernel
def walk(grid, path, first, costs):
    """Costs of a path from its cell `first` to each of the later ones; the first that cannot be
    stepped on, or -1.
    """
    weights, stride, steps, corner_cutting, _ = grid
    total = 0.0
    for n in range(first, len(path)):
        node = (path[n, 0] + 1) * stride + path[n, 1] + 1
        if weights[node] == np.inf:
            return n
        if n > first:
            up = path[n, 0] - path[n - 1, 0]
            left = path[n, 1] - path[n - 1, 1]
            diagonal = up != 0 and left != 0
            corners = weights[node - up * stride] == np.inf or weights[node - left] == np.inf
            if diagonal and not corner_cutting and corners:
                return n
            length, factor = (steps[1], steps[3]) if diagonal else (steps[0], steps[2])
            total += length + factor * (
                np.float64(weights[node - up * stride - left]) + np.float64(weights[node])
            )
        costs[n] = total
    return -1
