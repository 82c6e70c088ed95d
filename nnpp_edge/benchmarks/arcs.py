"""A body that drives arcs among rocks: its first plans, its ticks and its drives, beside the exact
lattice.

python -m nnpp_edge.benchmarks.arcs TERRAIN.tif --size 512 --radius 2 --queries 100
"""

import json
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import click
import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.suites import (
    Case,
    TerrainFiles,
    heights_of,
    large_enough,
    terrain_cases,
    whole_cost,
)
from nnpp_edge.runtime import DynamicPlanner, Plan, Planner, Vehicle
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.options import PlanOptions
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.labels import random_query
from nnpp_edge.terrain.rocks import Rocks, rock_heights

BODY = Vehicle(1.5, 1.2, 0.3)
CELL_M = 0.25
"""Side of the rescaled terrain's cells."""
SEED = 1
QUERIES_OF_A_MAP = 2
SMALL_ROCKS_M, SMALL_ROCKS_PER_M2 = (0.2, 1.0), 0.06
"""Diameters of small rocks, as many of each size as of twice that, and how many of them lie on a
square metre.
"""
ACROSS = 0.7
"""Least distance of start and goal among them, as a share of the map's side."""
TICKS = 40
STEP = 2
NEAR_CELLS = 25
ROCK_CELLS = 8
"""Ticks of a drive on which the map changes; states driven between two; greatest distance of a
change from the robot; a change's side.
"""
STRIDE = 24
"""States that are driven between two plans of a drive whose cost counts."""
FIGURES: dict[str, Callable[[list[float]], np.floating]] = {
    "mean": np.mean,
    "median": np.median,
    "p95": partial(np.quantile, q=0.95),
    "p99": partial(np.quantile, q=0.99),
    "max": np.max,
}
"""Shown of milliseconds and of shares."""


@click.command(context_settings={"show_default": True})
@click.argument(
    "terrain", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path)
)
@click.option("--size", default=256, help="Cells of a map's side.")
@click.option("--radius", "radius_m", default=2.0, help="Turning radius in metres.")
@click.option("--forwards", is_flag=True, help="The body cannot go backwards.")
@click.option("--fixed", is_flag=True, help="Goals have headings, too.")
@click.option("--small-rocks", is_flag=True, help="Many small rocks, ends across the map.")
@click.option("--queries", "count", default=20, help="Number of queries that have a path.")
def main(
    terrain: tuple[Path, ...],
    size: int,
    radius_m: float,
    forwards: bool,
    fixed: bool,
    small_rocks: bool,
    count: int,
) -> None:
    """Plan, tick and drive between random headings: figures as JSON, milliseconds and shares by
    which costs exceed the exact ones.
    """
    vehicle = replace(BODY, turning_radius_m=radius_m)
    if not forwards:
        vehicle = replace(vehicle, reverse_cost=2.0, gear_change_m=1.0)
    exercise()  # no kernel is compiled or loaded while the clock runs
    harness = Harness()
    rng = np.random.default_rng(SEED)  # of the headings alone, so that these stay the same
    solved = 0
    sources = Counter[str]()
    found = defaultdict[str, list[float]](list)
    dems = TerrainFiles(terrain, CELL_M).read()
    if small_rocks:
        cases = _among_small_rocks(dems, size)
    else:
        cases = terrain_cases(dems, "body-rocks10", size, SEED, vehicle=BODY)
    drawn = ((case, query) for case in cases for query in case.queries[:QUERIES_OF_A_MAP])
    for case, (start, goal) in islice(drawn, 4 * count):
        begin, end = rng.uniform(0.0, 360.0, 2)
        options: PlanOptions = {
            "start_heading_deg": begin,
            "goal_heading_deg": end if fixed else None,
        }
        heights = heights_of(case.ground)
        height_m, width_m = case.ground.sides_m
        make = partial(
            Ground.of_elevation, heights, height_m, cell_width_m=width_m, vehicle=vehicle
        )
        ground = make()
        exact = Planner(ground).plan(start, goal, **(options | {"method": "astar"}))
        if not exact.ok:
            continue
        seconds, plan = harness.timed(partial(_first_plan, make, start, goal, options))
        row = {
            "exact_ms": exact.timings_ms["total"],
            "first_ms": 1e3 * seconds,
            "exact_expansions": exact.expansions,
            "first_expansions": plan.expansions,
            "gap": plan.cost / exact.cost - 1.0,
        }
        for figure, value in row.items():
            found[figure].append(value)
        solved += plan.ok
        sources[str(plan.source)] += 1
        if not fixed:
            moving = DynamicPlanner(ground, goal)
            moving.move(start, begin)
            cost = _driven_cost(moving, moving.replan())
            found["driven"].append(cost / exact.cost - 1.0)
            moving.move(start, begin)
            changes = np.random.default_rng([SEED, solved])
            ms, cost = _ticks(harness, heights, moving, moving.replan(), changes)
            found["tick_ms"] += ms
            found["driven_on_ticks"].append(cost / exact.cost - 1.0)
        if len(found["gap"]) == count:
            break
    if not found:
        raise click.ClickException("no query has a path")
    figures: dict[str, object] = {
        "size": size,
        "radius_m": radius_m,
        "forwards": forwards,
        "fixed": fixed,
        "small_rocks": small_rocks,
        "n": len(found["gap"]),
        "solved": solved,
        "sources": sources,
        "ticks": len(found["tick_ms"]),
    }
    click.echo(json.dumps({**figures, **_summary(found)}, indent=1))


def _among_small_rocks(dems: Sequence[Dem], size: int) -> Iterator[Case]:
    """Crops of the terrain with rocks of many small sizes, and queries across them."""
    rng = np.random.default_rng([SEED, size])
    fitting = large_enough(dems, size)
    if not fitting:
        raise click.ClickException(f"wanted terrain of at least {size} × {size} cells")
    while True:
        dem = fitting[int(rng.integers(len(fitting)))]
        sides = dem.cell_size_m, dem.cell_width_m
        count = int(SMALL_ROCKS_PER_M2 * size**2 * math.prod(sides))
        least, greatest = SMALL_ROCKS_M
        diameters = least * (greatest / least) ** rng.random(count)
        rocks = Rocks(rng.random((count, 2)) * size - 0.5, diameters)
        heights = dem.random_square(rng, size) + rock_heights((size, size), sides, rocks)
        heights = np.ascontiguousarray(heights)
        ground = Ground.of_elevation(heights, sides[0], cell_width_m=sides[1], vehicle=BODY)
        cost = whole_cost(ground)
        drawn = [random_query(rng, cost, ACROSS * size) for _ in range(QUERIES_OF_A_MAP)]
        queries = tuple(query for query in drawn if query is not None)
        yield Case("small-rocks", size, cost, queries, ground)


def _summary(found: Mapping[str, list[float]]) -> dict[str, float]:
    """All of `FIGURES` of each list that holds anything."""
    return {
        f"{name}_{figure}": float(of(values))
        for name, values in found.items()
        for figure, of in FIGURES.items()
        if values
    }


def _first_plan(make: Callable[[], Ground], start: Cell, goal: Cell, options: PlanOptions) -> Plan:
    """From elevations to the first answer of a planner."""
    return Planner(make()).plan(start, goal, **options)


def _driven_cost(planner: DynamicPlanner, plan: Plan) -> float:
    """Cost of the drive to the goal by a new plan every `STRIDE` states, the first being this."""
    driven = 0.0
    while len(plan.path) > STRIDE:
        costs = np.empty(len(plan.path))
        planner.state.grid.walk(plan.walked, 0, costs)
        driven += costs[STRIDE]
        _move(planner, plan, STRIDE)
        plan = planner.replan()
        if not plan.ok:
            return np.inf
    return driven + plan.cost


def _ticks(
    harness: Harness,
    heights: Float2D,
    planner: DynamicPlanner,
    plan: Plan,
    rng: np.random.Generator,
) -> tuple[list[float], float]:
    """Milliseconds of the plans of a drive on which rocks appear and vanish near the robot; and
    what is driven, and left in the end, costs.
    """
    rock = ROCK_CELLS
    times = list[float]()
    driven = 0.0
    for _ in range(TICKS):
        if not plan.ok or len(plan.path) <= STEP:
            break
        costs = np.empty(len(plan.path))
        planner.state.grid.walk(plan.walked, 0, costs)
        driven += costs[STEP]
        # a change near the robot, with a rock unless that would lie under it
        near = rng.integers(-NEAR_CELLS, NEAR_CELLS + 1, 2)
        corner = np.clip(plan.path[STEP] + near, 0, np.array(planner.shape) - rock)
        row, col = corner.tolist()
        patch = heights[row : row + rock, col : col + rock].copy()
        if np.abs(near + rock // 2).max() > rock + 2:
            patch[2:5, 2:5] += rng.choice([0.0, 0.2, 0.5])
        planner.update_elevation(row, col, patch)
        _move(planner, plan, STEP)
        seconds, plan = harness.timed(planner.replan)
        times.append(1e3 * seconds)
    return times, driven + plan.cost


def _move(planner: DynamicPlanner, plan: Plan, steps: int) -> None:
    row, col = plan.path[steps].tolist()
    planner.move((row, col), float(plan.headings_deg[steps]))


if __name__ == "__main__":
    main()
