"""Costs into the map: one pass that also says what changed."""

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel

_INF = np.float32(np.inf)
_NOTHING_LOW = np.int32(_INF.view(np.int32))
_NOTHING_HIGH = np.int32(-1)


@kernel
def fill_costs(cost, limits, row0, row1, weights, stride, found):
    """Put the weights of some rows of a new map into their places.

    Numbers from 0 up are in the order of their bits, read as integers; of integers the compiler
    finds the least of eight at once.

    Arguments as for `write_costs`, of the whole map. Written to `found`, (3,) int32, are the bits
    of the least passable cost above 0 or 0 itself, those of the greatest (-1 without any), and
    whether one lies below 0.
    """
    _, _, scale, ceiling = limits
    cols = cost.shape[1]
    lowest = _NOTHING_LOW
    highest = _NOTHING_HIGH
    below = False
    for row in range(row0, row1):
        first = (row + 1) * stride + 1
        line = cost[row]
        out = weights[first : first + cols]
        bits = line.view(np.int32)
        for col in range(cols):
            t = line[col]
            b = bits[col]
            passable = t < ceiling  # NaN is not
            out[col] = t * scale if passable else _INF
            below |= t < np.float32(0.0)
            lowest = min(lowest, max(b, np.int32(0)) if passable else _NOTHING_LOW)
            highest = max(highest, b if passable else _NOTHING_HIGH)
    found[0] = lowest
    found[1] = highest
    found[2] = below


@kernel
def write_costs(cost, seen, limits, first, stride, weights, bounds, changed_nodes, old_weights):
    """Put the weights of a rectangle of costs into the map, from node `first` on, unless one is out
    of range.

    Parameters
    ----------
    cost : (h, w) float32
        NaN and values from `ceiling` up are impassable.
    seen : (h, w) bool
        Cells that are written; (0, 0) for all.
    limits : (floor, most, scale, ceiling)
        Least and most that a passable cell may cost; weight of a cost of 1; see `cost`.
    first, stride : int
        Node of the first cell; nodes from one row to the next.
    weights : (nodes,) float32
        Written, unless a cost is out of range.
    bounds : (least, greatest)
        Bounds on the weights of passable cells so far.
    changed_nodes, old_weights : (h·w,) int32, float32
        Written: the changed nodes and what they weighed. Nothing where they are empty.

    Returns
    -------
    tuple
        A cost that is out of range, inf if none is; the number of changed cells; whether one became
        cheaper; (first row, first column, one past the last row, one past the last column) of them
        within the rectangle; the bounds, widened; whether a cell that lay at a bound has changed.
    """
    floor, most, scale, ceiling = limits
    changed = 0
    cheaper = False
    at_bound = False
    lowest = np.float32(np.inf)
    highest = np.float32(-np.inf)
    top = cost.shape[0]
    left = cost.shape[1]
    bottom = 0
    right = 0
    everywhere = seen.size == 0
    for row in range(cost.shape[0]):
        for col in range(cost.shape[1]):
            if not everywhere and not seen[row, col]:
                continue
            t = cost[row, col]
            w = np.float32(np.inf)
            if t < ceiling:  # no NaN comes here
                w = np.float32(t * scale)
                lowest = min(lowest, t)
                highest = max(highest, t)
            before = weights[first + row * stride + col]
            if w != before:
                changed += 1
                cheaper = cheaper or w < before
                at_bound = at_bound or before == bounds[0] or before == bounds[1]
                top = min(top, row)
                bottom = row + 1
                left = min(left, col)
                right = max(right, col + 1)
    widened = bounds[0], bounds[1]
    if lowest < np.inf:
        widened = (
            min(bounds[0], np.float64(lowest * scale)),
            max(bounds[1], np.float64(highest * scale)),
        )
    refused = lowest if lowest < floor else (highest if highest > most else np.float32(np.inf))
    if changed == 0 or refused < np.inf:
        return refused, 0, False, (0, 0, 0, 0), widened, False
    noted = 0
    for row in range(top, bottom):
        for col in range(left, right):
            if not everywhere and not seen[row, col]:
                continue
            node = first + row * stride + col
            t = cost[row, col]
            w = np.float32(t * scale) if t < ceiling else np.float32(np.inf)
            if len(changed_nodes) and w != weights[node]:
                changed_nodes[noted] = node
                old_weights[noted] = weights[node]
                noted += 1
            weights[node] = w
    return refused, changed, cheaper, (top, left, bottom, right), widened, at_bound
