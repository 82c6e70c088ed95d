"""Costs into the map: one pass that also says what changed."""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel


@kernel
def write_costs(cost, limits, first, stride, weights, bounds, changed_nodes, old_weights):
    """Put the weights of a rectangle of costs into the map, from node `first` on, unless one of them is too low.

    Parameters
    ----------
    cost : (h, w) float32
        NaN and values from `ceiling` up are impassable.
    limits : (floor, scale, ceiling)
        Lowest cost allowed; weight of a cost of 1; see `cost`.
    first, stride : int
        Node of the first cell; nodes from one row to the next.
    weights : (nodes,) float32
        Written, unless a cost is below `floor`.
    bounds : (least, greatest)
        Bounds on the weights of passable cells so far.
    changed_nodes, old_weights : (h·w,) int32, float32
        Written: the changed nodes and what they weighed. Nothing where they are empty.

    Returns
    -------
    tuple
        The least cost; the number of changed cells; whether one became cheaper; (first row, first column, one past
        the last row, one past the last column) of them within the rectangle; the bounds, widened.
    """
    floor, scale, ceiling = limits
    changed, cheaper, lowest = 0, False, np.float32(np.inf)
    top, left, bottom, right = cost.shape[0], cost.shape[1], 0, 0
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for row in range(cost.shape[0]):
        for col in range(cost.shape[1]):
            t, w = cost[row, col], np.float32(np.inf)
            if t < ceiling:  # no NaN comes here
                w = np.float32(t * scale)
                lowest = min(lowest, t)
                low, high = min(low, w), max(high, w)
            before = weights[first + row * stride + col]
            if w != before:
                changed += 1
                cheaper = cheaper or w < before
                top, bottom = min(top, row), row + 1
                left, right = min(left, col), max(right, col + 1)
    widened = min(bounds[0], np.float64(low)), max(bounds[1], np.float64(high))
    if changed == 0 or lowest < floor:
        return lowest, 0, False, (0, 0, 0, 0), widened
    noted = 0
    for row in range(top, bottom):
        for col in range(left, right):
            node, t = first + row * stride + col, cost[row, col]
            w = np.float32(t * scale) if t < ceiling else np.float32(np.inf)
            if len(changed_nodes) and w != weights[node]:
                changed_nodes[noted], old_weights[noted] = node, weights[node]
                noted += 1
            weights[node] = w
    return lowest, changed, cheaper, (top, left, bottom, right), widened
