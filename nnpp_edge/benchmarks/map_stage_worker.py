"""Times the stages from elevations to a path, one at a time, as it is told on stdin: the other half of `map_stage`.

Run as a file with PYTHONPATH set to any checkout of the project, an older one too: it uses only names that these have
in common. What they lack (`Planner.of_elevation`) is done as it was then: the whole cost map, then a planner of it.
A line of JSON in, a line of JSON out.
"""

import contextlib
import functools
import gc
import json
import os
import resource
import sys
import time
from collections.abc import Callable

import numpy as np

from nnpp_edge.runtime import NetworkModel, Planner, traversability_cost, update_cost

METHODS = ("astar", "corridor", "nnpp")
PATCH = (22, 31)
PATCHES = 21
"""In a row, of which the one of middle time counts: a single one after other stages would find all caches cold."""
Query = tuple[tuple[int, int], tuple[int, int]]


class Stages:
    """The stages on one map."""

    def __init__(self, dem: np.ndarray, sides: tuple[float, float], queries: list[Query], model: str) -> None:
        self.dem, (self.cell_size_m, self.cell_width_m) = dem, sides
        self.queries = queries
        self.network, self.lazy_ones = NetworkModel(model), hasattr(Planner, "of_elevation")
        self.cost = self.cost_map()
        self.standing = self.eager()
        row, col = ((side - wanted) // 2 for side, wanted in zip(dem.shape, PATCH, strict=True))
        old = dem[row : row + PATCH[0], col : col + PATCH[1]].copy()
        self.patches, self.at = (old + np.float32(0.3 * self.cell_size_m) * _bump(old.shape), old), (row, col)
        self.patched = 0

    def tasks(self) -> dict[str, Callable[[int], object]]:
        """By name, each a function of the repetition's number."""
        found: dict[str, Callable[[int], object]] = {"copy": lambda _: self.dem.copy()}
        found |= {"cost map": lambda _: self.cost_map(), "grid and pyramid": lambda _: self.of_cost()}
        found |= {"all": lambda _: self.eager(), "patch": lambda _: self.patch()}
        for method in METHODS:
            for how, lazy in (("lazy", True), ("eager", False)):
                found[f"{method}, {how}"] = functools.partial(self.first_path, method, lazy)
        with contextlib.suppress(ImportError):
            found |= self.halves()
        return found

    def halves(self) -> dict[str, Callable[[int], object]]:
        """Grid and pyramid apart, where the checkout has them in these places."""
        from nnpp_edge.runtime.map.grid import Grid
        from nnpp_edge.runtime.map.pyramid import Pyramid
        from nnpp_edge.runtime.map.step_cost import StepModel

        model = StepModel.of("paper")
        grid = Grid.of(self.cost, model)
        return {"grid": lambda _: Grid.of(self.cost, model), "pyramid": lambda _: Pyramid(grid)}

    def cost_map(self) -> np.ndarray:
        """All costs."""
        return traversability_cost(self.dem, self.cell_size_m, cell_width_m=self.cell_width_m, warn=False)

    def of_cost(self) -> Planner:
        """A planner of costs, its coarse levels made."""
        planner = Planner(self.cost, model=self.network)
        levels(planner)
        return planner

    def of_elevation(self, *, lazy: bool) -> Planner:
        """A planner of elevations."""
        if not self.lazy_ones:
            return Planner(self.cost_map(), model=self.network)
        return Planner.of_elevation(
            self.dem, self.cell_size_m, cell_width_m=self.cell_width_m, lazy=lazy, model=self.network, warn=False
        )

    def eager(self) -> Planner:
        """The same with all costs and coarse levels."""
        planner = self.of_elevation(lazy=False)
        levels(planner)
        return planner

    def first_path(self, method: str, lazy: bool, number: int) -> object:
        """From elevations to the path of a query, and the planner: to give its memory back is no part of planning."""
        planner = self.of_elevation(lazy=lazy)
        start, goal = self.queries[number % len(self.queries)]
        plan = planner.plan(start, goal, method=method)
        assert plan.ok
        return planner, plan

    def patch(self) -> None:
        """A patch of elevations into all costs and coarse levels; another one each time."""
        self.patched += 1
        (row, col), patch = self.at, self.patches[self.patched % 2]
        if self.lazy_ones:
            self.standing.update_elevation(row, col, patch)
        else:
            rows, cols = PATCH
            self.dem[row : row + rows, col : col + cols] = patch
            width = self.cell_width_m
            part = update_cost(self.cost, self.dem, (row, col, rows, cols), self.cell_size_m, cell_width_m=width)
            row, col, rows, cols = part
            self.standing.update(row, col, self.cost[row : row + rows, col : col + cols])
        levels(self.standing)


def levels(planner: Planner) -> object:
    """The coarse levels as the map is now; older planners keep them themselves."""
    state: object = getattr(planner, "state", planner)
    return getattr(state, "pyramid")  # noqa: B009  # of either


def _bump(shape: tuple[int, ...]) -> np.ndarray:
    rows, cols = (np.hanning(side + 2)[1:-1] for side in shape)
    return np.outer(rows, cols).astype(np.float32)


def timed(call: Callable[[int], object], number: int) -> tuple[float, int]:
    """Seconds of a call, and pages that the system handed out meanwhile; what it returns is dropped afterwards."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    began = time.perf_counter()
    kept = call(number)
    seconds = time.perf_counter() - began
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
    del kept
    return seconds, faults


def main() -> None:
    """Answer until stdin ends."""
    if cores := json.loads(sys.argv[1]):
        os.sched_setaffinity(0, cores)
    tasks: dict[str, Callable[[int], object]] = {}
    gc.disable()
    for line in sys.stdin:
        asked = json.loads(line)
        if "map" in asked:
            tasks.clear()
            queries = [((a, b), (c, d)) for (a, b), (c, d) in asked["queries"]]
            stages = Stages(np.load(asked["map"]), asked["sides"], queries, asked["model"])
            tasks |= stages.tasks()
            for task in tasks.values():
                for number in range(2):
                    task(number)  # compiled, and memory touched
            gc.collect()
            answer: object = list(tasks)
        else:
            calls = PATCHES if asked["task"] == "patch" else 1
            times = [timed(tasks[asked["task"]], asked["number"]) for _ in range(calls)]
            answer = sorted(times)[calls // 2]
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
