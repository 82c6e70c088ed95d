"""A path by way of 12 places in the best order, by each step cost and method.

``python -m nnpp_edge.benchmarks.tours`` prints the figures as JSON: seconds until a planner is made of the elevations
and has answered once, and of a tour after that.
"""

import json
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import click
import numpy as np

from nnpp_edge.profiling.suites import Case, TerrainFiles, cases_from
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.map.slope_cost import SLOPE_COSTS
from nnpp_edge.runtime.search.connection import connected
from nnpp_edge.terrain.vehicle_files import load_mobility

_PLACES = 12


def stops_on(case: Case, seed: int) -> list[Cell]:
    """Start, places between and goal, spread evenly over the cells that can be reached from the first of them."""
    rng = np.random.default_rng(seed)
    found = [case.queries[0][0]]
    passable = np.argwhere(case.cost < 1.0)
    while len(found) < _PLACES + 2:
        row, col = passable[rng.integers(len(passable))].tolist()
        if connected([case.cost], (found[0], (row, col))):
            found.append((row, col))
    return found


def measure(case: Case, step_cost: str, method: str, vehicle: str, tours: int) -> dict[str, float]:
    """Seconds of the first plan and of tours on one map, and what the best orders save."""
    assert case.ground is not None
    ground = replace(case.ground, step_cost=step_cost, mobility=load_mobility(vehicle))
    began = time.perf_counter()
    planner = ground.planner()
    made = time.perf_counter() - began
    planner.plan(*case.queries[0], method=method)
    first = time.perf_counter() - began
    seconds, saved, planned = [], [], []
    for seed in range(tours):
        stops = stops_on(case, seed)
        began = time.perf_counter()
        tour = planner.plan_via(stops[0], stops[-1], stops[1:-1], best_order=True, method=method)
        seconds.append(time.perf_counter() - began)
        saved.append(1.0 - tour.plan.cost / tour.given_cost)
        planned.append(tour.plan.timings_ms.get("order", 0.0) / 1e3)
    return {
        "planner_s": made,
        "first_plan_s": first,
        "tour_s": median(seconds),
        "slowest_tour_s": max(seconds),
        "order_s": median(planned),
        "saved": median(saved),
    }


@click.command()
@click.option("--terrain", type=click.Path(path_type=Path), multiple=True, help="Elevation files; else the sample.")
@click.option("--rescale", type=float, default=20.0)
@click.option("--workload", default="limit20")
@click.option("--size", default=1024)
@click.option("--step-costs", default=",".join(("paper", *SLOPE_COSTS)))
@click.option("--methods", default="auto,astar")
@click.option("--mobility", default="large-rover", help="A vehicle that has the table.")
@click.option("--tours", default=5)
def main(
    terrain: tuple[Path, ...],
    rescale: float,
    workload: str,
    size: int,
    step_costs: str,
    methods: str,
    mobility: str,
    tours: int,
) -> None:
    """Print the figures as JSON, by step cost and method."""
    exercise()
    case = next(cases_from(TerrainFiles.or_sample(terrain, rescale).read(), workload, size, seed=1))
    figures = {
        f"{step_cost} {method}": measure(case, step_cost, method, mobility, tours)
        for step_cost in step_costs.split(",")
        for method in methods.split(",")
    }
    print(
        json.dumps(
            {name: {key: round(value, 4) for key, value in of.items()} for name, of in figures.items()}, indent=1
        )
    )


if __name__ == "__main__":
    main()
