"""Lines freed from the grid beside fast marching at twice the resolution, Theta* and string pulling.

``python -m nnpp_edge.benchmarks.any_angle`` prints the figures as JSON. All lines are priced by the line integral of
`planners.refine`; the gap is to what fast marching takes from start to goal over the same density, sampled at every
half cell. Needs scikit-fmm (extra ``bench``).

Theta* (Nash et al., 2007) is A* whose cells may be reached from their parent's parent along a straight line, here by
the line integral. String pulling leaves out the cells of the grid's path that a clear straight line skips at no
higher integral, greedily from the start.
"""

import heapq
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import numba
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.suites import Case, TerrainFiles, cases_from
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.kernels.any_angle import ground_of, is_clear, leg_cost, line_cost
from nnpp_edge.runtime.map.grid import PackedGrid
from nnpp_edge.runtime.planners.planner import Planner

Points = NDArray[np.float64]
Float64s = NDArray[np.float64]
_REPEATS = 3
_NEAR = 1.0
"""Cells around the start that fast marching begins with: the density there is taken as even."""


def density_at_half_cells(planner: Planner) -> Float64s:
    """(2H - 1, 2W - 1) cost of a cell's length at middles of cells, sides and corners; inf where impassable."""
    grid = planner.state.grid
    cost = grid.model.steps[0] + 2.0 * grid.model.steps[2] * grid.map().astype(np.float64)
    rows, cols = cost.shape
    passable = np.isfinite(cost)
    values, shares = np.where(passable, cost, 0.0), passable.astype(np.float64)
    sums, counts, least = (np.empty((2 * rows - 1, 2 * cols - 1)) for _ in range(3))
    for out, cells in ((sums, values), (counts, shares)):
        out[::2, ::2] = cells
        out[1::2, ::2] = 0.5 * (cells[1:] + cells[:-1])
        out[:, 1::2] = 0.5 * (out[:, 2::2] + out[:, :-2:2])
    least[:] = counts > 1.0 - 1e-9
    return np.where(least > 0.0, sums / np.maximum(counts, 1e-12), np.inf)


def marched(density: Float64s, start: Cell) -> Float64s:
    """What fast marching takes from a cell to every half cell; inf where it does not come."""
    import skfmm

    rows, cols = np.indices(density.shape)
    away = np.hypot(rows - 2 * start[0], cols - 2 * start[1]) / 2.0
    blocked = ~np.isfinite(density)
    speed = np.where(blocked, 1.0, 1.0 / np.where(blocked, 1.0, density))
    times = skfmm.travel_time(np.ma.MaskedArray(away - _NEAR, blocked), speed, dx=0.5, order=2)
    found: Float64s = np.ma.filled(times, np.inf) + _NEAR * density[(away <= _NEAR) & ~blocked].mean()
    return found


@numba.njit(error_model="numpy")
def _theta_star(grid, start, goal, shape):  # type: ignore[no-untyped-def]
    """Way points from goal to start, as far as there are any."""
    ground = ground_of(grid)
    rows, cols = shape
    costs, parents = np.full(rows * cols, np.inf), np.full(rows * cols, -1)
    first, last = start[0] * cols + start[1], goal[0] * cols + goal[1]
    closed = np.zeros(rows * cols, np.bool_)
    costs[first], parents[first] = 0.0, first
    waiting = [(0.0, first)]
    while len(waiting) and not closed[last]:
        _, node = heapq.heappop(waiting)
        if closed[node]:
            continue
        closed[node] = True
        row, col, above = node // cols, node % cols, parents[node]
        for k in range(9):
            i, j = row + k // 3 - 1, col + k % 3 - 1
            there = i * cols + j
            if i < 0 or j < 0 or i >= rows or j >= cols or closed[there]:
                continue
            for via in (above, node):
                r, c = float(via // cols), float(via % cols)
                if is_clear(ground, r, c, float(i), float(j)):
                    cost = costs[via] + leg_cost(ground, r, c, float(i), float(j))
                    if cost < costs[there]:
                        costs[there], parents[there] = cost, via
                        ahead = math.sqrt(float((i - goal[0]) ** 2 + (j - goal[1]) ** 2))
                        heapq.heappush(waiting, (cost + ground[2] * ahead, there))
    found, node = [last], last
    while closed[last] and node != first:
        node = parents[node]
        found.append(node)
    return found


def theta_star(grid: PackedGrid, start: Cell, goal: Cell, shape: tuple[int, int]) -> Points:
    """Way points of Theta*, all in the middles of cells."""
    nodes = np.array(_theta_star(grid, start, goal, shape)[::-1])
    return np.stack(np.divmod(nodes, shape[1]), axis=1).astype(np.float64)


@numba.njit(error_model="numpy")
def string_pulled(grid, points):  # type: ignore[no-untyped-def]
    """Way points of a path that greedy string pulling by the line integral leaves."""
    ground, kept, here = ground_of(grid), [0], 0
    while here < len(points) - 1:
        best, along = here + 1, 0.0
        for k in range(here + 1, len(points)):
            along += leg_cost(ground, points[k - 1, 0], points[k - 1, 1], points[k, 0], points[k, 1])
            ends = points[here, 0], points[here, 1], points[k, 0], points[k, 1]
            if not is_clear(ground, *ends):
                break
            if leg_cost(ground, *ends) <= along * (1.0 + 1e-9):
                best = k
        here = best
        kept.append(here)
    return points[np.array(kept)]


def lines_of(planner: Planner, case: Case, method: str, theta: bool) -> Iterator[dict[str, tuple[float, float, int]]]:
    """Of each query that has a path: gap, milliseconds beyond the plan's and way points, by the name of the rival."""
    density, grid = density_at_half_cells(planner), planner.state.grid.packed
    start = case.queries[0][0]
    times = marched(density, start)
    goals = [cell for query in case.queries for cell in query]
    for goal in goals:
        best = times[2 * goal[0], 2 * goal[1]]
        plans = [planner.plan(start, goal, method=method, refine="any-angle") for _ in range(1 + _REPEATS)][1:]
        plan = min(plans, key=lambda each: each.timings_ms.get("refine", 0.0))
        least = case.least_distance
        if not plan.ok or not math.isfinite(best) or math.hypot(goal[0] - start[0], goal[1] - start[1]) < least:
            continue
        own = min(each.timings_ms["total"] - each.timings_ms["refine"] for each in plans)
        path = plan.path.astype(np.float64)
        assert plan.waypoints is not None
        found = {
            "grid": (line_cost(grid, path) / best - 1.0, own, len(path)),
            "any-angle": (plan.line_cost / best - 1.0, plan.timings_ms["refine"], len(plan.waypoints)),
            "string pulling": _timed(lambda path=path: string_pulled(grid, path), grid, best),  # type: ignore[misc]
        }
        if theta:
            found["Theta*"] = _timed(lambda goal=goal: theta_star(grid, start, goal, planner.shape), grid, best)  # type: ignore[misc]
        yield found


def _timed(line: Callable[[], Points], grid: PackedGrid, best: float) -> tuple[float, float, int]:
    line()
    began = time.perf_counter()
    points = line()
    return line_cost(grid, points) / best - 1.0, 1e3 * (time.perf_counter() - began), len(points)


def compare(
    cases: Iterator[Case], queries: int, method: str, step_cost: str, theta: bool
) -> dict[str, dict[str, float]]:
    """Figures by rival over at least so many queries."""
    found: list[dict[str, tuple[float, float, int]]] = []
    while len(found) < queries:
        case = next(cases)
        found += lines_of(_planner(case.cost, step_cost), case, method, theta)
    figures = {}
    for name in found[0]:
        gaps, times, points = np.array([each[name] for each in found]).T
        figures[name] = {
            "n": len(gaps),
            "gap_mean_percent": round(100.0 * float(gaps.mean()), 3),
            "gap_p95_percent": round(100.0 * float(np.quantile(gaps, 0.95)), 3),
            "gap_max_percent": round(100.0 * float(gaps.max()), 3),
            "ms_median": round(float(np.median(times)), 3),
            "way_points_median": float(np.median(points)),
        }
    return figures


def _planner(cost: Float2D, step_cost: str) -> Planner:
    if step_cost == "paper":
        return Planner(cost)
    return Planner(np.where(cost < 1.0, 1.0 + 2.0 * 255.0 * 0.011 * cost, np.inf), step_cost="length")


@click.command()
@click.option("--terrain", type=click.Path(path_type=Path), multiple=True, help="Elevation files; else the sample.")
@click.option("--rescale", type=float, default=20.0)
@click.option("--workload", default="soft,limit20")
@click.option("--sizes", default="256")
@click.option("--queries", type=int, default=200)
@click.option("--methods", default="corridor,astar")
@click.option("--step-cost", type=click.Choice(["paper", "length"]), default="paper")
@click.option("--theta/--no-theta", default=True, help="Theta* takes seconds on large maps.")
def main(
    terrain: tuple[Path, ...],
    rescale: float,
    workload: str,
    sizes: str,
    queries: int,
    methods: str,
    step_cost: str,
    theta: bool,
) -> None:
    """Print the figures as JSON, by workload, size and method."""
    dems = TerrainFiles.or_sample(terrain, rescale).read()
    figures = {}
    for name in workload.split(","):
        for size in map(int, sizes.split(",")):
            for method in methods.split(","):
                cases = cases_from(dems, name, size, seed=1)
                figures[f"{name} {size} {method}"] = compare(cases, queries, method, step_cost, theta)
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
