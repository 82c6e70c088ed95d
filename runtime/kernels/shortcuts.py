"""Short cuts of a body's path: straight legs between cells of it, where the body can follow them and they cost less.

Prices are quickly told, whether the body can follow a leg is not. So the cheapest choice of legs is made by their
prices, its legs are checked, those that fail are struck out, and it is made again, until all its legs have passed.
"""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.any_heading import body_leg_price, stands_on_leg, under_body
from nnpp_edge.runtime.kernels.by_address import borrowed
from nnpp_edge.runtime.kernels.clock import late
from nnpp_edge.runtime.kernels.pose_weights import body_weight_at, headings_of, known_weight


@kernel
def with_shortcuts(body, grid, path, skips, tolerance, until):
    """Cells of a body's path that the cheapest line along it turns at.

    Parameters
    ----------
    body, grid
        As everywhere.
    path : (N, 2) int32
        Cells, each a neighbour of the one before it, whose poses pass.
    skips : (S,) int64
        Cells of the path from one end of a leg to the other, 1 first.
    tolerance : float
        Cells of mean ground, whose cost a way point must save.
    until : float
        As everywhere. By then no more short cuts are looked for.

    Returns
    -------
    (M, 2) float64
        The way points.
    float
        The line integral along them.
    """
    legs = _prices(body, grid, path, skips, until)
    legs += tolerance * legs[1:, 0].mean()
    n, first = len(path), 1
    passed, costs, before = np.zeros(legs.shape, np.bool_), np.zeros(n), np.zeros(n, np.int64)
    passed[:, 0] = True
    under, contacts = under_body(body), np.empty((2, len(body[1])))
    while first < n:
        _choose(legs, skips, first, costs, before)
        first, k = n, n - 1
        while k > 0:
            chosen = before[k]
            i = k - skips[chosen]
            if not passed[k, chosen] and not late(until):
                ends = np.float64(path[i, 0]), np.float64(path[i, 1]), np.float64(path[k, 0]), np.float64(path[k, 1])
                passed[k, chosen] = stands_on_leg(under, contacts, body, grid[1], ends)
            if not passed[k, chosen]:
                legs[k, chosen], first = np.inf, k
            k = i
    return _line_of(body, grid, path, skips, before)


@helper
def _prices(body, grid, path, skips, until):
    """(N, S) about what the legs to each cell cost, by one sample a cell; inf where the path is not so long."""
    codes, unit, stride, steps = borrowed(body[0][0]), body[0][1], grid[1], grid[2]
    legs = np.full((len(path), len(skips)), np.inf)
    for k in range(1, len(path)):
        for s in range(len(skips)):
            if skips[s] > k or (s > 0 and late(until)):
                break
            row, col = np.float64(path[k - skips[s], 0]), np.float64(path[k - skips[s], 1])
            rows, cols = path[k, 0] - row, path[k, 1] - col
            length, total = math.sqrt(rows * rows + cols * cols), 0.0
            samples, headings = max(np.int64(length + 0.5), 1), headings_of(rows, cols)
            for part in range(samples):
                share = (part + 0.5) / samples
                at = row + share * rows, col + share * cols
                weight = known_weight(codes, unit, stride, at[0], at[1], headings)
                total += weight if weight >= 0.0 else body_weight_at(body[0], stride, at[0], at[1], headings)
            legs[k, s] = length * (steps[0] + 2.0 * steps[2] * total / samples)
    return legs


@helper
def _choose(legs, skips, first, costs, before):
    """Write the cheapest way to each cell from `first` on, and the number of its last leg's skip."""
    for k in range(first, len(legs)):
        costs[k] = np.inf
        for s in range(len(skips)):
            if skips[s] <= k and costs[k - skips[s]] + legs[k, s] < costs[k]:
                costs[k], before[k] = costs[k - skips[s]] + legs[k, s], s


@helper
def _line_of(body, grid, path, skips, before):
    """The chosen way points, and the line integral along them."""
    count, k = 1, len(path) - 1
    while k > 0:
        count, k = count + 1, k - skips[before[k]]
    points, k, cost = np.empty((count, 2)), len(path) - 1, 0.0
    for m in range(count - 1, -1, -1):
        points[m, 0], points[m, 1] = path[k, 0], path[k, 1]
        k -= skips[before[k]]
    for m in range(count - 1):
        cost += body_leg_price(body[0], grid, (points[m, 0], points[m, 1], points[m + 1, 0], points[m + 1, 1]))
    return points, cost
