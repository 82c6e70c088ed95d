"""Maps of elevations that change: a planner that computes costs where it looks, beside one that
computes them all.
"""

import contextlib
import math
import random
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import numpy as np

from nnpp_edge.runtime import Planner, Traversability, traversability_cost
from nnpp_edge.runtime.cells import Cell
from tests.fuzz.cases import NOWHERE, Case, Place, Problem
from tests.fuzz.weights import METHODS, problem_with_plan, seen_by_planner

LIMITS = (
    Traversability(),
    Traversability.safe(),
    Traversability(slope_limit_deg=15, hard_slope_deg=15),
    Traversability(step_limit_m=5, roughness_limit_m=8, hard_step_m=4),
)


def generate(rng: random.Random, place: Place = NOWHERE, most_side: int = 90) -> Case:
    """A case of a few steps."""
    rows, cols = (max(int(most_side ** rng.random()), 1) for _ in range(2))
    if rng.random() < 0.7:
        rows = max(rows, most_side // 3)
        cols = max(cols, most_side // 3)
    numbers = np.random.default_rng(rng.getrandbits(32))
    cell = rng.choice(((1.0, 1.0), (20.0, 20.0), (2.0, 1.7)))
    dem = draw_heights(rng, numbers, rows, cols, cell[0])
    return Case(
        dem=dem,
        cell=cell,
        limits=rng.choice(LIMITS),
        corner_cutting=rng.random() < 0.5,
        omega=rng.choice((0.011, 0.011, 0.1)),
        sizes=draw_sizes(rng),
        steps=[_step(rng, numbers, dem, cell[0]) for _ in range(rng.choice((1, 3, 6, 12)))],
    )


def draw_sizes(rng: random.Random) -> dict[str, int]:
    """Sizes that the code sees, made smaller so that small maps have many tiles and several coarse
    levels.
    """
    rows, cols = rng.choice(((4, 4), (8, 16), (32, 64), (16, 4)))
    level = rng.choice((2, 4, 8, 16))
    threads = rng.choice((1, 200_000))
    return {
        "map.tiles.TILE_ROWS": rows,
        "map.tiles.TILE_COLS": cols,
        "map.pyramid.ANOTHER_LEVEL_FROM": level,
        "planners.methods.REFINE_FROM": level,
        "bands.THREADS_FROM": threads,
    }


@contextlib.contextmanager
def sizes(case: Case) -> Iterator[None]:
    """The sizes of a case, for as long."""
    with contextlib.ExitStack() as stack:
        for target, value in case.sizes.items():
            stack.enter_context(mock.patch(f"nnpp_edge.runtime.{target}", value))
        yield


def draw_heights(
    rng: random.Random, numbers: np.random.Generator, rows: int, cols: int, size: float
) -> np.ndarray:
    """Slopes and hills, with rocks of about this size, walls, cliffs, holes and islands, of several
    dtypes.
    """
    row, col = np.mgrid[:rows, :cols]
    waves = np.sin(row / rng.uniform(2, 9) + rng.random()) + np.cos(
        col / rng.uniform(2, 9) + rng.random()
    )
    dem = size * rng.choice((0.0, 0.1, 0.3, 1.0)) * waves
    dem += size * (rng.choice((0.0, 0.0, 0.1)) * row + rng.choice((0.0, 0.0, 0.1)) * col)
    dem += size * rng.choice((0.0, 0.01, 0.05)) * numbers.normal(size=(rows, cols))
    rocks = numbers.random((rows, cols)) < rng.choice((0.0, 0.01, 0.04))
    dem[rocks] += size * rng.choice((0.6, 1.0, 2.0)) * numbers.random(int(rocks.sum()))
    kind = rng.choice(("whole", "whole", "whole", "holes", "stripe", "wall", "cliff"))
    if kind == "holes":
        dem[numbers.random((rows, cols)) < rng.choice((0.005, 0.02, 0.05, 0.7))] = rng.choice(
            (np.nan, np.inf, -np.inf)
        )
    elif kind == "stripe":
        dem[: rng.randint(0, rows), cols // 2 :][:, : rng.choice((1, 1, 2, 9))] = np.nan
    elif kind == "wall":
        dem[rows // 2, rng.choice((0, cols // 3, cols // 2)) :] += 10.0 * size
    elif kind == "cliff":
        dem[:, cols // 2 :] += size * rng.choice((0.5, 5.0))
    dem += rng.choice((0.0, 0.0, -40.0 * size, 8000.0))
    return dem.astype(rng.choice((np.float32, np.float32, np.float64)))


def draw_patch(
    rng: random.Random, numbers: np.random.Generator, dem: np.ndarray, size: float, most: int = 40
) -> tuple[str, Any]:
    """An update of a part by other heights, some of them unknown."""
    rows, cols = dem.shape
    height, width = (min(rng.choice((1, 1, 3, 10, most)), side) for side in dem.shape)
    row = rng.randrange(rows - height + 1)
    col = rng.randrange(cols - width + 1)
    noise = size * rng.choice((0.0, 0.1, 2.0)) * numbers.normal(size=(height, width))
    patch = dem[row : row + height, col : col + width] + noise
    patch[numbers.random(patch.shape) < rng.choice((0.0, 0.0, 0.3, 1.0))] = np.nan
    return "update", (row, col, patch.astype(rng.choice((np.float32, np.float64))))


def _step(
    rng: random.Random, numbers: np.random.Generator, dem: np.ndarray, size: float
) -> tuple[str, Any]:
    if rng.random() < 0.45:
        return draw_patch(rng, numbers, dem, size)
    ends = [(rng.randrange(dem.shape[0]), rng.randrange(dem.shape[1])) for _ in range(2)]
    return "plan", (*ends, rng.choice(METHODS), rng.choice((math.inf, math.inf, 0.0, 0.05)))


def put(dem: np.ndarray, row: int, col: int, patch: np.ndarray) -> None:
    """Write a patch into a map."""
    dem[row : row + patch.shape[0], col : col + patch.shape[1]] = patch


def check(case: Case, place: Place = NOWHERE) -> Problem | None:
    """Do all steps with both planners, and compare them with each other and with Dijkstra."""
    with sizes(case):
        return _check(case, place)


def _check(case: Case, place: Place) -> Problem | None:
    settings: dict[str, Any] = {"omega": case.omega, "corner_cutting": case.corner_cutting}

    def planner(dem: np.ndarray, lazy: bool) -> Planner:
        more = settings | {
            "ask_from": 0,
            "model": place.model,
            "cell_width_m": case.cell[1],
            "warn": False,
        }
        return Planner.of_elevation(dem, case.cell[0], case.limits, lazy=lazy, **more)

    dem = case.dem.copy()
    lazy = planner(dem, True)
    eager = planner(dem, False)
    if lazy.state.costs_computed != 0.0 or eager.state.costs_computed != 1.0:
        return Problem("computed at once or not", repr(case))

    def judged(start: Cell, goal: Cell, method: str, epsilon: float, told: str) -> Problem | None:
        ours, theirs = (
            each.plan(start, goal, method=method, epsilon=epsilon) for each in (lazy, eager)
        )
        for name in ("status", "cost", "lower_bound", "expansions", "threshold", "source", "path"):
            one = getattr(ours, name)
            other = getattr(theirs, name)
            if not (np.array_equal(one, other) or (one != one and other != other)):
                return Problem(f"lazy is not eager: {name} of {method}", f"{one} {other}\n{told}")
        cost = traversability_cost(
            dem, case.cell[0], case.limits, cell_width_m=case.cell[1], warn=False
        )
        exact = {"exact": method == "astar" or epsilon == 0.0, "epsilon": epsilon, "told": told}
        return problem_with_plan(
            ours, seen_by_planner(cost, "paper"), start, goal, **settings, **exact
        )

    if problem := drive(case, dem, (lazy, eager), judged):
        return problem
    rounded_alike = (
        case.dem.dtype == np.float32
    )  # others are relative to a height, which may have changed
    return _compare_maps(lazy, eager, planner(dem, False) if rounded_alike else eager, repr(case))


def drive(
    case: Case,
    dem: np.ndarray,
    planners: tuple[Planner, Planner],
    judged: Callable[..., Problem | None],
) -> Problem | None:
    """Do a case's steps with two planners; what is wrong by `judged`, which is given what a
    ``plan`` step holds.
    """
    for number, (kind, value) in enumerate(case.steps):
        if kind == "plan":
            if problem := judged(*value, f"step {number}\n{case!r}"):
                return problem
            continue
        put(dem, *value)
        for planner in planners:
            planner.update_elevation(*value)
    return None


def _compare_maps(lazy: Planner, eager: Planner, fresh: Planner, told: str) -> Problem | None:
    """All weights, and all coarse levels, are those of a planner made afresh."""
    every = [each.state for each in (lazy, eager, fresh)]
    maps = [state.grid.map().copy() for state in every]
    pyramids = [state.pyramid for state in every]
    for state in every:
        state.grid.complete()
    for one, other, third in zip(*(pyramid.levels[1:] for pyramid in pyramids), strict=True):
        same = all(
            np.array_equal(getattr(one, name), getattr(other, name)) for name in ("pieces", "links")
        )
        same &= np.array_equal(one.grid.weights, other.grid.weights) and np.array_equal(
            other.links, third.links
        )
        if not same:
            return Problem("lazy is not eager: a coarse level", told)
    alike = np.array_equal(maps[0], maps[1]) and np.array_equal(maps[1], maps[2])
    return None if alike else Problem("the maps are not alike", told)
