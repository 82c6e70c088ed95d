"""Slow and obvious answers that the tests compare the code with."""

import itertools
import math

import numpy as np
from scipy.ndimage import label, map_coordinates
from scipy.sparse import coo_array, issparse
from scipy.sparse.csgraph import dijkstra as scipy_dijkstra


def traversability(dem, dy, dx, t):
    """Eq. 1 cell by cell, with numpy's least squares."""
    rows, cols = dem.shape
    cost = np.full(dem.shape, np.inf)
    limited = t.hard_gradient_deg < 90.0
    gradient = math.tan(math.radians(t.hard_gradient_deg)) if limited else math.inf
    for r, c in np.argwhere(np.isfinite(dem)).tolist():
        near = itertools.product(
            range(max(r - 1, 0), min(r + 2, rows)), range(max(c - 1, 0), min(c + 2, cols))
        )
        known = [(i, j) for i, j in near if np.isfinite(dem[i, j])]
        points = np.array(
            [((j - c) * dx, (i - r) * dy, float(dem[i, j]) - float(dem[r, c])) for i, j in known]
        )
        centre = points.mean(axis=0)
        moved = points - centre
        (a, b), *_ = np.linalg.lstsq(moved[:, :2], moved[:, 2], rcond=1e-9)
        normal = np.array([-a, -b, 1.0]) / math.sqrt(a * a + b * b + 1.0)
        slope = math.atan(math.hypot(a, b))
        roughness = math.sqrt(np.mean((moved @ normal) ** 2))
        step = abs(float(-centre @ normal))
        limits = math.radians(t.slope_limit_deg), t.roughness_limit_m, t.step_limit_m
        terms = np.minimum(np.divide((slope, roughness, step), limits), 1.0)
        beyond = (
            slope > math.radians(t.hard_slope_deg)
            or roughness > t.hard_roughness_m
            or step > t.hard_step_m
        )
        for (i, j), (x, y, rise) in zip(known, points, strict=True):
            if (i, j) != (r, c):
                beyond |= abs(rise) > math.hypot(x, y) * gradient
        if not beyond and terms.min() < 1.0:
            cost[r, c] = terms @ (t.slope_weight, t.roughness_weight, t.step_weight)
    return cost


# --- steps, and the cheapest paths of them


def steps(passable, price, corner_cutting=True):
    """Every step of a grid as arrays (from, to, cost), by the definition in words.

    `passable` is (H, W); `price` takes (rows, cols) that the step leads down and right, and the
    nodes that it leads from and to.
    """
    rows, cols = passable.shape
    nodes = np.arange(rows * cols).reshape(rows, cols)
    parts = []
    for dr, dc in itertools.product((-1, 0, 1), repeat=2):
        if not (dr or dc):
            continue
        here = slice(max(-dr, 0), rows - max(dr, 0)), slice(max(-dc, 0), cols - max(dc, 0))
        there = slice(max(dr, 0), rows - max(-dr, 0)), slice(max(dc, 0), cols - max(-dc, 0))
        allowed = passable[here] & passable[there]
        if dr and dc and not corner_cutting:
            allowed &= passable[here[0], there[1]] & passable[there[0], here[1]]
        one = nodes[here][allowed]
        other = nodes[there][allowed]
        parts.append((one, other, price((dr, dc), one, other)))
    return tuple(np.concatenate(each) for each in zip(*parts, strict=True))


def possible(ways):
    """All ways of some groups (from, to, cost) of arrays that cost less than inf, as `steps`."""
    one, other, cost = (
        np.concatenate(list(map(np.ravel, each))) for each in zip(*ways, strict=True)
    )
    made = np.isfinite(cost)
    return one[made], other[made], cost[made]


def graph_of(all_steps, shape):
    """What `costs_from` goes by, made once for several starts."""
    i, j, v = all_steps
    return coo_array((np.maximum(v, 1e-300), (i, j)), shape=(math.prod(shape),) * 2).tocsr()


def costs_from(all_steps, shape, *starts):
    """Cost of the cheapest path from one of some places to each of an array of this shape, by
    scipy; inf where there is none. The steps are arrays or a graph of them.
    """
    graph = all_steps if issparse(all_steps) else graph_of(all_steps, shape)
    nodes = np.ravel_multi_index(np.transpose(starts), shape, mode="wrap")
    return scipy_dijkstra(graph, indices=nodes, min_only=True).reshape(shape)


def step_costs(length, pair, step_cost, omega):
    """Of steps so long between cells whose costs sum to `pair`, in one of the two models."""
    return length + 255 * omega * pair if step_cost == "paper" else length * pair / 2


def steps_on(cost, step_cost="paper", corner_cutting=True, omega=0.011):
    """`steps` on a map of costs, in one of the two models."""
    weights = cost.astype(np.float64).ravel()

    def price(step, one, other):
        return step_costs(math.hypot(*step), weights[one] + weights[other], step_cost, omega)

    return steps(
        np.isfinite(cost) & ((cost < 1.0) | (step_cost == "length")), price, corner_cutting
    )


def dijkstra(cost, start, step_cost="paper", corner_cutting=True, omega=0.011):
    """(H, W) cost of the cheapest path from `start` to each cell of a map of costs."""
    return costs_from(steps_on(cost, step_cost, corner_cutting, omega), cost.shape, start)


def octile(shape, goal, straight, diagonal):
    """(H, W) least cost from each cell to the goal, where a straight and a diagonal step cost at
    least so much.
    """
    rows, cols = (np.abs(np.arange(cells) - at) for cells, at in zip(shape, goal, strict=True))
    near = np.minimum(rows[:, None], cols)
    far = np.maximum(rows[:, None], cols)
    return straight * (far - near) + diagonal * near


def least_refused(all_steps, region, start, to_go):
    """The least that a path from `start` can cost that leaves a region (H, W) bool: its first step
    out, and on.

    `to_go` is the (H, W) least cost to the goal.
    """
    (i, j, v), inside = all_steps, region.ravel()
    within = inside[i] & inside[j]
    out = inside[i] & ~inside[j]
    came = costs_from((i[within], j[within], v[within]), region.shape, start).ravel()
    return float((came[i[out]] + v[out] + to_go.ravel()[j[out]]).min(initial=math.inf))


def bound_by_region(cost, region, start, goal, step_cost="paper", corner_cutting=True, omega=0.011):
    """`least_refused` on a map of costs, where no step costs less than among the cheapest cells."""
    pair = 2.0 * float(cost[np.isfinite(cost) & (cost > 0.0)].min())
    lengths = np.array((1.0, math.sqrt(2.0)))
    straight, diagonal = step_costs(lengths, pair, step_cost, omega)
    to_go = octile(cost.shape, goal, straight, min(diagonal, 2.0 * straight))
    return least_refused(steps_on(cost, step_cost, corner_cutting, omega), region, start, to_go)


def path_cost(path, cost, step_cost="paper", omega=0.011):
    """Sum of the path's steps."""
    steps = np.diff(path, axis=0)
    assert (np.abs(steps).max(1) == 1).all(), "steps go to one of eight neighbours"
    weights = cost[tuple(np.transpose(path))].astype(np.float64)
    return float(step_costs(np.hypot(*steps.T), weights[:-1] + weights[1:], step_cost, omega).sum())


def threshold_by_loop(levels, start, goal):
    """The largest level at which start and goal are connected, found by lowering it one
    at a time.
    """
    for td in range(255, -1, -1):
        labels, _ = label(levels >= td, structure=np.ones((3, 3)))
        if labels[start] and labels[start] == labels[goal]:
            return td
    return -1


def path_problem(path, cost, start, goal, corner_cutting=True):
    """What forbids a path over a map whose impassable cells are inf; empty if nothing does."""
    if not len(path) or tuple(path[0]) != tuple(start) or tuple(path[-1]) != tuple(goal):
        return "a path with other ends"
    for r, c in path:
        if not (0 <= r < cost.shape[0] and 0 <= c < cost.shape[1]):
            return "a path that leaves the map"
        if not np.isfinite(cost[r, c]):
            return "a path through what is forbidden"
    for (r, c), (i, j) in itertools.pairwise(path):
        if max(abs(i - r), abs(j - c)) != 1:
            return "a path with a leap"
        if (
            not corner_cutting
            and r != i
            and c != j
            and not (np.isfinite(cost[r, j]) and np.isfinite(cost[i, c]))
        ):
            return "a path that cuts a corner"
    return ""


def line_cost(points, cost, step_cost="paper", per_cell=400):
    """The integral along a line's points, by very many samples of a bilinear density written down
    plainly.
    """
    passable = np.isfinite(cost) & ((cost < 1.0) | (step_cost == "length"))
    density = (
        1.0 + 2.0 * 255.0 * 0.011 * cost.astype(np.float64)
        if step_cost == "paper"
        else cost.astype(np.float64)
    )
    values = np.where(passable, density, 0.0)
    total = 0.0
    for begin, end in itertools.pairwise(points):
        length = math.hypot(*(end - begin))
        count = max(int(per_cell * length), 1)
        at = begin + ((np.arange(count) + 0.5) / count)[:, None] * (end - begin)
        sums, shares = (
            map_coordinates(each, at.T, float, order=1, mode="grid-constant")
            for each in (values, passable)
        )
        total += length * float(np.mean(sums / shares))
    return total


def cheapest_order(between):
    """By trying all, and what the order given costs; between[i][j] from stop i to stop j."""
    last = len(between) - 1
    orders = ([0, *order, last] for order in itertools.permutations(range(1, last)))
    costs = [sum(between[a][b] for a, b in itertools.pairwise(order)) for order in orders]
    return min(costs), costs[0]
