"""A body's lines beside the best that a finer lattice has: half cells, and legs in 16 directions.

``python -m nnpp_edge.benchmarks.any_angle_body`` prints the figures as JSON. Each leg of the lattice is checked and
priced as those of lines are (`kernels.any_heading`); whole steps of the grid are among them, so no path of the grid
is cheaper than the lattice's best. Sixteen directions are too few on even ground: the yardstick is the lattice's best
path after way points are left out of it, `pulled`, wherever a straight leg that the body can follow is cheaper.
"""

import heapq
import json
import math
from pathlib import Path
from typing import NamedTuple

import click
import numba
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.suites import Case, TerrainFiles, terrain_cases
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.kernels.any_heading import body_leg_cost
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.planners.refine import BodyLines, Refiner
from nnpp_edge.terrain.vehicle_files import load_vehicle

Points = NDArray[np.float64]
LEGS = np.array(
    [(1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2), (2, 2), (2, -2)]
    + [
        leg
        for long, wide in ((2, 1), (3, 1), (3, 2))
        for leg in ((wide, long), (long, wide), (wide, -long), (long, -wide))
    ]
)
"""Half cells down and to the right. Whole steps of the grid come beside half ones, checked by its own rule."""
_PULLED_OVER = 48
"""Points of the lattice's path that a leg may skip."""
_REPEATS = 3


@numba.njit(error_model="numpy")
def _cheapest(body, grid, legs, shape, ends, known):  # type: ignore[no-untyped-def]
    """Nodes of the lattice's cheapest path, from the goal on; none without. `known` keeps costs of legs, else NaN."""
    rows, cols = shape
    start, goal = ends
    g, parents = np.full(rows * cols, np.inf), np.full(rows * cols, -1)
    closed = np.zeros(rows * cols, np.bool_)
    g[start] = 0.0
    waiting = [(0.0, start)]
    while len(waiting) and not closed[goal]:
        _, node = heapq.heappop(waiting)
        if closed[node]:
            continue
        closed[node] = True
        for k in range(2 * len(legs)):
            sign, leg = 1 - 2 * (k & 1), k >> 1
            i, j = node // cols + sign * legs[leg, 0], node % cols + sign * legs[leg, 1]
            there = i * cols + j
            if i < 0 or j < 0 or i >= rows or j >= cols or closed[there]:
                continue
            begin = min(node, there)  # legs lead down, or to the right
            if np.isnan(known[leg, begin]):
                row, col = 0.5 * (begin // cols), 0.5 * (begin % cols)
                to = row + 0.5 * legs[leg, 0], col + 0.5 * legs[leg, 1]
                known[leg, begin] = body_leg_cost(body, grid, row, col, to[0], to[1])
            cost = g[node] + known[leg, begin]
            if cost < g[there]:
                g[there], parents[there] = cost, node
                down, right = i - goal // cols, j - goal % cols
                ahead = 0.5 * math.sqrt(float(down * down + right * right))
                heapq.heappush(waiting, (cost + grid[2][0] * ahead, there))
    found, node = [goal], goal
    while closed[goal] and node != start:
        node = parents[node]
        found.append(node)
    return found if closed[goal] else found[:0]


@numba.njit(error_model="numpy")
def pulled(body, grid, points, most):  # type: ignore[no-untyped-def]
    """The cheapest way points among these, legs skipping up to `most`."""
    n = len(points)
    costs, before = np.full(n, np.inf), np.zeros(n, np.int64)
    costs[0] = 0.0
    for k in range(1, n):
        for i in range(k - 1, max(k - most, 0) - 1, -1):
            rows, cols = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
            if costs[i] + grid[2][0] * math.sqrt(rows * rows + cols * cols) < costs[k]:
                cost = costs[i] + body_leg_cost(body, grid, points[i, 0], points[i, 1], points[k, 0], points[k, 1])
                if cost < costs[k]:
                    costs[k], before[k] = cost, i
    kept = [n - 1]
    while kept[-1] > 0:
        kept.append(before[kept[-1]])
    return points[np.array(kept)[::-1]]


class Lattice:
    """The lattice of one map; costs of legs are kept from one query to the next, 160 bytes a half cell."""

    def __init__(self, planner: Planner) -> None:
        rows, cols = planner.shape
        self._shape = 2 * rows - 1, 2 * cols - 1
        self._grid, self._body = planner.state.grid.packed, BodyLines(planner.state.grid).body
        self._known = np.full((len(LEGS), self._shape[0] * self._shape[1]), np.nan)

    def best(self, start: Cell, goal: Cell) -> tuple[Points, Points] | None:
        """The cheapest path of the lattice, and what is left of it where way points are left out; None without."""
        ends = tuple(2 * row * self._shape[1] + 2 * col for row, col in (start, goal))
        nodes = np.array(_cheapest(self._body, self._grid, LEGS, self._shape, ends, self._known)[::-1])
        if not len(nodes):
            return None
        points = 0.5 * np.stack(np.divmod(nodes, self._shape[1]), axis=1)
        return points, pulled(self._body, self._grid, points, _PULLED_OVER)


class Found(NamedTuple):
    """Costs of a query's lines over that of the yardstick, and milliseconds of the plan and of its refinement."""

    grid: float
    line: float
    lattice: float
    plan_ms: float
    refine_ms: float


def compare(case: Case, method: str) -> list[Found]:
    """Of each query of a map that has a path."""
    assert case.ground is not None
    planner = case.ground.planner()
    lattice, cost, found = Lattice(planner), Refiner(planner.state).cost, []
    for start, goal in case.queries:
        plans = [planner.plan(start, goal, method=method, refine="any-angle") for _ in range(1 + _REPEATS)][1:]
        plan = min(plans, key=lambda each: each.timings_ms.get("refine", 0.0))
        if not plan.ok or (best := lattice.best(start, goal)) is None:
            continue
        least = cost(best[1])
        on_grid, on_lattice = cost(plan.path.astype(np.float64)) / least - 1.0, cost(best[0]) / least - 1.0
        own = min(each.timings_ms["total"] - each.timings_ms["refine"] for each in plans)
        found.append(Found(on_grid, plan.line_cost / least - 1.0, on_lattice, own, plan.timings_ms["refine"]))
    return found


def _spread(gaps: NDArray[np.float64]) -> dict[str, float]:
    names = ("mean", "p50", "p95", "max", "min")
    values = (gaps.mean(), *np.quantile(gaps, (0.5, 0.95)), gaps.max(), gaps.min())
    return {f"gap_{name}_percent": round(100.0 * float(value), 3) for name, value in zip(names, values, strict=True)}


@click.command()
@click.option("--terrain", type=click.Path(path_type=Path), multiple=True, help="Elevation files; else the sample.")
@click.option("--rescale", type=float, default=0.25)
@click.option("--vehicle", default="small-rover")
@click.option("--workload", default="body-rocks10")
@click.option("--size", type=int, default=256)
@click.option("--maps", type=int, default=3)
@click.option("--method", default="astar")
def main(
    terrain: tuple[Path, ...], rescale: float, vehicle: str, workload: str, size: int, maps: int, method: str
) -> None:
    """Print the figures as JSON."""
    cases = terrain_cases(
        TerrainFiles.or_sample(terrain, rescale).read(), workload, size, seed=1, vehicle=load_vehicle(vehicle)
    )
    found = np.array([each for _ in range(maps) for each in compare(next(cases), method)])
    figures = {
        "n": len(found),
        "grid": _spread(found[:, 0]),
        "any-angle": _spread(found[:, 1]),
        "lattice": _spread(found[:, 2]),
        "plan_ms_median": round(float(np.median(found[:, 3])), 3),
        "refine_ms_median": round(float(np.median(found[:, 4])), 3),
    }
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
