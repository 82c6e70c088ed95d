"""Costs into the map: one pass that also says what changed."""

from numpy import float32, float64, inf, int32

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.pooling import NO_AREA, with_cell
from nnpp_edge.runtime.kernels.records import CostLimits

_INF = float32(inf)
_NOTHING_LOW = int32(_INF.view(int32))
_NOTHING_HIGH = int32(-1)


@kernel
def fill_costs(cost, limits: CostLimits, weights, stride):
    """Put the weights of a new map into their places.

    Numbers from 0 up are in the order of their bits, read as integers; of integers the compiler
    finds the least of eight at once.

    Arguments as for `write_costs`, of the whole map. Returns the bits of the least passable cost
    above 0 or 0 itself, those of the greatest (-1 without any), and whether one lies below 0.
    """
    rows, cols = cost.shape
    lowest = _NOTHING_LOW
    highest = _NOTHING_HIGH
    below = False
    for row in range(rows):
        first = (row + 1) * stride + 1
        line = cost[row]
        out = weights[first : first + cols]
        bits = line.view(int32)
        for col in range(cols):
            t = line[col]
            b = bits[col]
            passable = t < limits.ceiling  # NaN is not
            out[col] = t * limits.scale if passable else _INF
            below |= t < float32(0.0)
            lowest = min(lowest, max(b, int32(0)) if passable else _NOTHING_LOW)
            highest = max(highest, b if passable else _NOTHING_HIGH)
    return lowest, highest, below


@kernel
def write_costs(cost, seen, limits: CostLimits, first, stride, weights, bounds, nodes, old_weights):
    """Put the weights of a rectangle of costs into the map, from node `first` on, unless one is out
    of range.

    Parameters
    ----------
    cost : (h, w) float32
        As `limits`, `CostLimits`, say.
    seen : (h, w) bool
        Cells that are written; (0, 0) for all.
    first, stride : int
        Node of the first cell; nodes from one row to the next.
    weights : (nodes,) float32
        Written, unless a cost is out of range.
    bounds : (least, greatest)
        Of the weights of passable cells, so far.
    nodes, old_weights : (h·w,) int32, float32
        Written: the changed nodes and what they weighed. Nothing where they are empty.

    Returns
    -------
    tuple
        A cost that is out of range, inf if none is; the number of changed cells; whether one became
        cheaper; the `Area` of them within the rectangle; the bounds, widened; whether a cell that
        lay at a bound has changed.
    """
    rows, cols = cost.shape
    least, greatest = bounds
    everywhere = seen.size == 0
    lowest = _INF
    highest = -_INF
    for row in range(rows):
        for col in range(cols):
            t = cost[row, col]
            if t < limits.ceiling and (everywhere or seen[row, col]):
                lowest = min(lowest, t)
                highest = max(highest, t)
    refused = lowest if lowest < limits.floor else (highest if highest > limits.most else _INF)
    changed = 0
    cheaper = False
    at_bound = False
    area = NO_AREA
    for row in range(rows if refused == _INF else 0):
        for col in range(cols):
            if not everywhere and not seen[row, col]:
                continue
            t = cost[row, col]
            weight = float32(t * limits.scale) if t < limits.ceiling else _INF  # of NaN, too
            node = first + row * stride + col
            before = weights[node]
            if weight != before:
                if len(nodes):
                    nodes[changed] = node
                    old_weights[changed] = before
                weights[node] = weight
                changed += 1
                cheaper = cheaper or weight < before
                at_bound = at_bound or before in (least, greatest)
                area = with_cell(area, row, col)
    if lowest < inf:
        least = min(least, float64(lowest * limits.scale))
        greatest = max(greatest, float64(highest * limits.scale))
    part = (area.row0, area.row1, area.col0, area.col1) if changed else (0, 0, 0, 0)
    return refused, changed, cheaper, part, (least, greatest), at_bound
