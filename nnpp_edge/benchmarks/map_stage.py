"""From elevations to costs, coarse levels and a first path: what each stage takes, beside a copy of the elevations.

``python -m nnpp_edge.benchmarks.map_stage --size 256 --size 512`` prints medians in milliseconds as JSON. Stages take
turns. Memory that is freed stays with the process: start it with ``MALLOC_MMAP_THRESHOLD_=33554432`` and
``MALLOC_TRIM_THRESHOLD_=2147483648``, or arrays that the system has to hand out anew cost microseconds a page.
"""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import click
import numpy as np

from nnpp_edge.benchmarks.dynamic_scene import run_alone
from nnpp_edge.profiling.harness import Harness
from nnpp_edge.profiling.suites import Case, TerrainFiles, cases_from, source_of
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.pyramid import Pyramid
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.terrain.traversability import traversability_cost
from nnpp_edge.terrain.workloads import SOFT

PATCH = (22, 31)
"""Rows and columns of the elevations that a patch brings."""
METHODS = ("astar", "corridor", "nnpp")


def stages(case: Case, model: NetworkModel) -> dict[str, Callable[[Endpoints], object]]:
    """The stages on one map, as functions of the query; what they make is freed off the clock."""
    ground = case.ground
    assert ground is not None
    dem, sides = ground.elevation, (ground.cell_size_m, ground.cell_width_m)
    steps, patched = StepModel.of("paper"), 0
    grid = Grid.of(case.cost, steps)
    row, col = (side // 2 for side in dem.shape)
    flat = dem[row : row + PATCH[0], col : col + PATCH[1]]
    hill = flat + np.float32(0.2 * sides[0]) * np.outer(*(np.hanning(side) for side in flat.shape)).astype(np.float32)

    def of_elevation(*, lazy: bool) -> Planner:
        return Planner.of_elevation(dem, sides[0], cell_width_m=sides[1], lazy=lazy, model=model.share(), warn=False)

    def whole(_: Endpoints) -> object:
        planner = of_elevation(lazy=False)
        return planner, planner.state.pyramid

    standing = of_elevation(lazy=False)

    def patch(_: Endpoints) -> object:
        nonlocal patched
        patched += 1
        standing.update_elevation(row, col, hill if patched % 2 else flat)
        return standing.state.pyramid

    def first_path(method: str, lazy: bool, query: Endpoints) -> object:
        planner = of_elevation(lazy=lazy)
        return planner, planner.plan(*query, method=method)

    found: dict[str, Callable[[Endpoints], object]] = {
        "copy": lambda _: dem.copy(),
        "cost map": lambda _: traversability_cost(dem, sides[0], cell_width_m=sides[1], warn=False),
        "grid": lambda _: Grid.of(case.cost, steps),
        "pyramid": lambda _: Pyramid(grid),
        "all costs and levels": whole,
        f"patch of {PATCH[0]} x {PATCH[1]}": patch,
    }
    for method in METHODS:
        for how, lazy in (("lazy", True), ("eager", False)):
            found[f"first path: {method}, {how}"] = partial(first_path, method, lazy)
    return found


def measure(case: Case, model: NetworkModel, repetitions: int) -> dict[str, float]:
    """Median milliseconds of each stage over so many repetitions, which go through the map's queries."""
    planner = Planner(case.cost)
    ready = [query for query in case.queries if planner.plan(*query, method="corridor").ok] or case.queries[:1]
    queries = [ready[at % len(ready)] for at in range(repetitions)]
    times: dict[str, list[float]] = {}
    for records in Harness().measure(stages(case, model), queries, warm_up=queries[:2]):
        for name, record in records.items():
            times.setdefault(name, []).append(1e3 * record.median_s)
    return {name: round(float(np.median(each)), 4) for name, each in times.items()}


@click.command()
@click.option("--terrain", multiple=True, type=click.Path(path_type=Path), help="Elevation file; else synthetic.")
@click.option("--rescale", type=float, help="Rescale the terrain to cells of so many metres, slopes kept.")
@click.option("--cell-size", type=float, help="Side of a cell in metres, where the files do not say.")
@click.option("--size", "sizes", type=click.IntRange(64), multiple=True, default=(256, 512, 1024, 2048))
@click.option("--repetitions", type=click.IntRange(1), default=15, show_default=True)
@click.option("--model", default="edge", show_default=True, help="Shipped model or file.")
def main(
    terrain: tuple[Path, ...],
    rescale: float | None,
    cell_size: float | None,
    sizes: tuple[int, ...],
    repetitions: int,
    model: str,
) -> None:
    """Print the figures as JSON: for each size the terrain, and milliseconds by stage."""
    dems, network = TerrainFiles(terrain, rescale, cell_size).read(), NetworkModel(model)
    rows = [
        {"size": size, "terrain": source_of(dems, size)}
        | measure(next(cases_from(dems, SOFT, size, 1)), network, repetitions)
        for size in sizes
    ]
    click.echo(json.dumps(rows, indent=1))


if __name__ == "__main__":
    run_alone(main)
