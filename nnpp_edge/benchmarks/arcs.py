"""A body that drives arcs among rocks: its first plans, its ticks and its drives, beside the exact
lattice.

python -m nnpp_edge.benchmarks.arcs TERRAIN.tif --size 512 --radius 2 --queries 100
"""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import click
import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.rows import Row, Rows
from nnpp_edge.profiling.suites import dems_of, heights_of, terrain_cases
from nnpp_edge.progress import ignore
from nnpp_edge.runtime import DynamicPlanner, Plan, Planner, Vehicle
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.options import PlanOptions

BODY = Vehicle(1.5, 1.2, 0.3)
CELL_M = 0.25
"""Side of the rescaled terrain's cells."""
SEED = 1
QUERIES_OF_A_MAP = 2
TICKS = 40
STEP = 2
NEAR_CELLS = 25
ROCK_CELLS = 8
"""Ticks of a drive on which the map changes; states driven between two; greatest distance of a
change from the robot; a change's side.
"""
STRIDE = 24
"""States that are driven between two plans of a drive whose cost counts."""
COLUMNS = ("exact_ms", "first_ms", "gap", "driven", "tick_ms")
SHOWN = ("mean", "median", "p95", "p99", "max")
"""Columns of the rows, and figures of each."""


@click.command(context_settings={"show_default": True})
@click.argument(
    "terrain", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path)
)
@click.option("--size", default=256, help="Cells of a map's side.")
@click.option("--radius", "radius_m", default=2.0, help="Turning radius in metres.")
@click.option("--forwards", is_flag=True, help="The body cannot go backwards.")
@click.option("--fixed", is_flag=True, help="Goals have headings, too.")
@click.option("--queries", "count", default=20, help="Number of queries that have a path.")
def main(
    terrain: tuple[Path, ...],
    size: int,
    radius_m: float,
    forwards: bool,
    fixed: bool,
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
    rows = Rows()
    done = 0
    for ground, start, goal in islice(_queries(terrain, size, vehicle), 4 * count):
        begin, end = rng.uniform(0.0, 360.0, 2)
        options: PlanOptions = {
            "start_heading_deg": begin,
            "goal_heading_deg": end if fixed else None,
        }
        exact = Planner(ground).plan(start, goal, **(options | {"method": "astar"}))
        if not exact.ok:
            continue
        done += 1
        seconds, plan = harness.timed(partial(_first_plan, ground, start, goal, options))
        row: Row = {
            "exact_ms": exact.timings_ms["total"],
            "first_ms": 1e3 * seconds,
            "gap": plan.cost / exact.cost - 1.0,
            "solved": plan.ok,
        }
        rows.append(row)
        if not fixed:
            moving = DynamicPlanner(ground, goal)
            moving.move(start, begin)
            _, cost = _driven(harness, moving, STRIDE)
            row["driven"] = cost / exact.cost - 1.0
            moving.move(start, begin)
            changes = np.random.default_rng([SEED, done])
            change = partial(_change, moving, heights_of(ground), changes)
            times, _ = _driven(harness, moving, STEP, change, TICKS)
            rows += times
        if done == count:
            break
    if not done:
        raise click.ClickException("no query has a path")
    figures = {
        "size": size,
        "radius_m": radius_m,
        "forwards": forwards,
        "fixed": fixed,
        "n": done,
        "solved": round(sum(rows.all("solved"))),
    }
    for name in COLUMNS:
        figures |= rows.figures(" ".join(f"{name}_{how}" for how in SHOWN))
    click.echo(json.dumps(figures, indent=1))


def _queries(
    terrain: Sequence[Path], size: int, vehicle: Vehicle
) -> Iterator[tuple[Ground, Cell, Cell]]:
    """Grounds among rocks for this vehicle, with start and goal, without end."""
    dems = dems_of(terrain, CELL_M)
    for case in terrain_cases(dems, "body-rocks10", size, SEED, vehicle=BODY):
        for start, goal in case.queries[:QUERIES_OF_A_MAP]:
            yield replace(case.ground, vehicle=vehicle), start, goal


def _first_plan(ground: Ground, start: Cell, goal: Cell, options: PlanOptions) -> Plan:
    """From elevations to the first answer of a planner."""
    return Planner(ground).plan(start, goal, **options)


def _driven(
    harness: Harness,
    planner: DynamicPlanner,
    step: int,
    change: Callable[[Cell], None] = ignore,
    most: int = sys.maxsize,
) -> tuple[Rows, float]:
    """Milliseconds of the plans of a drive, a plan every so many states, at `most` so many; and
    what is driven, and left in the end, costs. The map may `change` around a robot's next cell.
    """
    times = Rows()
    driven = 0.0
    plan = planner.replan()
    while plan.ok and len(plan.path) > step and len(times) < most:
        costs = np.empty(len(plan.path))
        planner.state.grid.walk(plan.walked, 0, costs)
        driven += costs[step]
        row, col = plan.path[step].tolist()
        change((row, col))
        planner.move((row, col), float(plan.headings_deg[step]))
        seconds, plan = harness.timed(planner.replan)
        times.append({"tick_ms": 1e3 * seconds})
    return times, driven + plan.cost


def _change(
    planner: DynamicPlanner, heights: Float2D, rng: np.random.Generator, cell: Cell
) -> None:
    """A patch near a cell, with a rock unless that would lie under it."""
    rock = ROCK_CELLS
    near = rng.integers(-NEAR_CELLS, NEAR_CELLS + 1, 2)
    corner = np.clip(np.add(cell, near), 0, np.array(planner.shape) - rock)
    row, col = corner.tolist()
    patch = heights[row : row + rock, col : col + rock].copy()
    if np.abs(near + rock // 2).max() > rock + 2:
        patch[2:5, 2:5] += rng.choice([0.0, 0.2, 0.5])
    planner.update_elevation(row, col, patch)


if __name__ == "__main__":
    main()
