"""A body that drives arcs among rocks: its first plans, its ticks and its drives, beside the exact
lattice.

python -m nnpp_edge.benchmarks.arcs TERRAIN.tif --size 512 --radius 2 --queries 100
"""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import click
import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.suites import TerrainFiles, heights_of, terrain_cases
from nnpp_edge.runtime import DynamicPlanner, Plan, Planner, Vehicle
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.planners.query import PlanOptions

BODY = Vehicle(1.5, 1.2, 0.3)
QUERIES_OF_A_MAP = 2
TICKS = 40
STEP = 2
NEAR_CELLS = 25
ROCK_CELLS = 8
"""Ticks of a drive on which the map changes; states driven in between; where it changes, from the
robot; its size.
"""
STRIDE = 24
"""States that are driven between two plans of a drive whose cost counts."""


def first_plan(make: Callable[[], Ground], start: Cell, goal: Cell, options: PlanOptions) -> Plan:
    """From elevations to the first answer of a planner."""
    return Planner(make()).plan(start, goal, **options)


def driven_cost(planner: DynamicPlanner, plan: Plan) -> float:
    """Cost of the drive to the goal by a new plan every `STRIDE` states, the first being this."""
    driven = 0.0
    while len(plan.path) > STRIDE:
        grid = planner.state.grid
        costs = np.empty(len(plan.path))
        grid.walk(plan.walked, 0, costs)
        driven += costs[STRIDE]
        planner.move(tuple(plan.path[STRIDE].tolist()), float(plan.headings_deg[STRIDE]))
        plan = planner.replan()
        if not plan.ok:
            return np.inf
    return driven + plan.cost


def tick_times(
    harness: Harness,
    heights: Float2D,
    planner: DynamicPlanner,
    plan: Plan,
    rng: np.random.Generator,
) -> Iterator[float]:
    """Milliseconds of the plans of a drive on which rocks appear and vanish near the robot."""
    rock = ROCK_CELLS
    for _ in range(TICKS):
        if not plan.ok or len(plan.path) <= STEP:
            return
        cell = plan.path[STEP]
        near = rng.integers(-NEAR_CELLS, NEAR_CELLS + 1, 2)
        row, col = np.clip(cell + near, 0, np.array(planner.shape) - rock).tolist()
        patch = heights[row : row + rock, col : col + rock].copy()
        if np.abs(near + rock // 2).max() > rock + 2:
            patch[2:5, 2:5] += rng.choice([0.0, 0.2, 0.5])
        planner.update_elevation(row, col, patch)
        planner.move((int(cell[0]), int(cell[1])), float(plan.headings_deg[STEP]))
        seconds, plan = harness.timed(planner.replan)
        yield 1e3 * seconds


def measured(
    terrain: tuple[Path, ...],
    size: int,
    radius_m: float,
    count: int,
    *,
    cell_size_m: float = 0.25,
    forwards: bool = False,
    fixed: bool = False,
    seed: int = 1,
) -> dict[str, object]:
    """Figures of so many queries that have a path: milliseconds, expansions, and shares that costs
    lie above the exact ones.
    """
    vehicle = replace(BODY, turning_radius_m=radius_m)
    if not forwards:
        vehicle = replace(vehicle, reverse_cost=2.0, gear_change_m=1.0)
    harness = Harness()
    rng = np.random.default_rng(seed)
    solved = 0
    exact_ms, first_ms, tick_ms, gaps, drives = (list[float]() for _ in range(5))
    expansions = dict[str, list[float]](exact_expansions=[], first_expansions=[])
    sources = Counter[str]()
    flat = Planner.of_elevation(
        np.zeros((80, 80), np.float32), cell_size_m, vehicle=vehicle, warn=False
    )
    for method in ("corridor", "astar"):
        flat.plan((20, 20), (60, 70), method=method)
    cases = terrain_cases(
        TerrainFiles(terrain, cell_size_m).read(), "body-rocks10", size, seed, vehicle=BODY
    )
    drawn = ((case, query) for case in cases for query in case.queries[:QUERIES_OF_A_MAP])
    for case, (start, goal) in islice(drawn, 4 * count):
        begin, end = rng.uniform(0.0, 360.0, 2)
        options: PlanOptions = {
            "start_heading_deg": begin,
            "goal_heading_deg": end if fixed else None,
        }
        height_m, width_m = case.ground.sides_m
        make = partial(
            Ground.of_elevation,
            heights_of(case.ground),
            height_m,
            cell_width_m=width_m,
            vehicle=vehicle,
        )
        ground = make()
        exact = Planner(ground).plan(start, goal, **(options | {"method": "astar"}))
        if not exact.ok:
            continue
        seconds, plan = harness.timed(partial(first_plan, make, start, goal, options))
        exact_ms.append(exact.timings_ms["total"])
        first_ms.append(1e3 * seconds)
        expansions["exact_expansions"].append(exact.expansions)
        expansions["first_expansions"].append(plan.expansions)
        solved += plan.ok
        sources[str(plan.source)] += 1
        gaps.append(plan.cost / exact.cost - 1.0)
        if not fixed:
            moving = DynamicPlanner(ground, goal)
            moving.move(start, begin)
            drives.append(driven_cost(moving, moving.replan()) / exact.cost - 1.0)
            moving.move(start, begin)
            tick_ms += tick_times(harness, heights_of(case.ground), moving, moving.replan(), rng)
        if len(gaps) == count:
            break
    if not gaps:
        raise click.ClickException("no query has a path")
    found: dict[str, object] = {
        "size": size,
        "radius_m": radius_m,
        "forwards": forwards,
        "fixed": fixed,
    }
    found |= {"n": len(gaps), "solved": solved, "sources": dict(sources), "ticks": len(tick_ms)}
    taken = {"exact_ms": exact_ms, "first_ms": first_ms, "tick_ms": tick_ms}
    for name, values in (taken | expansions).items():
        if values:
            cuts = {"median": 0.5, "p95": 0.95, "p99": 0.99, "max": 1.0}
            found |= {
                f"{name}_{cut}": float(np.quantile(values, share)) for cut, share in cuts.items()
            }
    for name, values in ("gap", gaps), ("driven", drives):
        if values:
            found |= {
                f"{name}_mean": float(np.mean(values)),
                f"{name}_p95": float(np.quantile(values, 0.95)),
            }
    return found


@click.command()
@click.argument(
    "terrain", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path)
)
@click.option("--size", default=256, show_default=True, help="Cells of a map's side.")
@click.option(
    "--radius", "radius_m", default=2.0, show_default=True, help="Turning radius in metres."
)
@click.option(
    "--cell-size", "cell_size_m", default=0.25, show_default=True, help="Metres of a rescaled cell."
)
@click.option("--forwards", is_flag=True, help="The body cannot go backwards.")
@click.option("--fixed", is_flag=True, help="Goals have headings, too.")
@click.option(
    "--queries", "count", default=20, show_default=True, help="Those that have a path count."
)
@click.option("--seed", default=1, show_default=True)
def main(terrain: tuple[Path, ...], **how: Any) -> None:
    """Plan, tick and drive between random headings: figures as JSON, milliseconds and shares of the
    exact cost.
    """
    click.echo(json.dumps(measured(terrain, **how), indent=1))


if __name__ == "__main__":
    main()
