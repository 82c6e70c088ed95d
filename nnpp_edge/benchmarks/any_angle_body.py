"""A body's lines beside the finest lattice that can be searched: half cells, and legs in 16 directions.

``python -m nnpp_edge.benchmarks.any_angle_body`` prints the figures as JSON. Each leg of the lattice is checked and
priced as those of lines are (`kernels.any_heading`); whole steps of the grid are among them, so no path of the grid
is cheaper than the lattice's best. A lattice of 256² cells takes some 200 bytes a half cell and leg.
"""

import json
from pathlib import Path

import click
import numba
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from nnpp_edge.profiling.suites import TerrainFiles, terrain_cases
from nnpp_edge.runtime.kernels.any_heading import body_leg_cost
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.planners.refine import BodyLines, Refiner
from nnpp_edge.terrain.vehicle_files import load_vehicle

LEGS = [(1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2), (2, 2), (2, -2)] + [
    leg
    for long, wide in ((2, 1), (3, 1), (3, 2))
    for leg in ((wide, long), (long, wide), (wide, -long), (long, -wide))
]
"""Half cells down and to the right. Whole steps of the grid come beside half ones, checked by its own rule."""


@numba.njit(error_model="numpy")
def _leg_costs(body, grid, down, right, costs):  # type: ignore[no-untyped-def]
    """Write the costs of one kind of leg from each half cell."""
    rows, cols = costs.shape
    for i in range(rows - down):
        for j in range(max(-right, 0), min(cols - right, cols)):
            costs[i, j] = body_leg_cost(body, grid, 0.5 * i, 0.5 * j, 0.5 * (i + down), 0.5 * (j + right))


def lattice(planner: Planner) -> csr_array:
    """Costs between half cells, numbered row by row."""
    grid, (rows, cols) = planner.state.grid, planner.shape
    body, sides = BodyLines(grid).body, (2 * rows - 1, 2 * cols - 1)
    numbers = np.arange(sides[0] * sides[1], dtype=np.int32).reshape(sides)
    found, begins, ends = [], [], []
    for down, right in LEGS:
        costs = np.full(sides, np.inf)
        _leg_costs(body, grid.packed, down, right, costs)
        i, j = np.nonzero(np.isfinite(costs))
        found.append(costs[i, j])
        begins.append(numbers[i, j])
        ends.append(numbers[i + down, j + right])
    pairs = np.concatenate(begins), np.concatenate(ends)
    return coo_array((np.concatenate(found), pairs), shape=(numbers.size, numbers.size)).tocsr()


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
    found: list[tuple[float, ...]] = []
    for _ in range(maps):
        case = next(cases)
        assert case.ground is not None
        planner = case.ground.planner()
        graph, cost = lattice(planner), Refiner(planner.state).cost
        for start, goal in case.queries[:5]:
            plan = planner.plan(start, goal, method=method, refine="any-angle")
            cols = 2 * planner.shape[1] - 1
            best = dijkstra(graph, directed=False, indices=2 * start[0] * cols + 2 * start[1])
            least = float(best[2 * goal[0] * cols + 2 * goal[1]])
            if plan.ok and np.isfinite(least):
                own = plan.timings_ms["total"] - plan.timings_ms["refine"]
                gaps = cost(plan.path.astype(np.float64)) / least - 1.0, plan.line_cost / least - 1.0
                found.append((*gaps, own, plan.timings_ms["refine"]))
    grid, line, own, refine = np.array(found).T
    figures = {
        "n": len(found),
        "grid": _spread(grid),
        "any-angle": _spread(line),
        "plan_ms_median": round(float(np.median(own)), 3),
        "refine_ms_median": round(float(np.median(refine)), 3),
    }
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
