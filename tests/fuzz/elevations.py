"""Maps of elevations that change: a planner that computes costs where it looks, beside one that computes them all."""

import contextlib
import math
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from nnpp_edge.runtime import Planner, Traversability, traversability_cost
from tests.fuzz.commands import Problem
from tests.fuzz.weights import METHODS, problem_with_plan, seen_by_planner, small_model

NAME = "elevations"
_PATCHED = {
    "nnpp_edge.runtime.map.tiles.TILE_ROWS": "tile_rows",
    "nnpp_edge.runtime.map.tiles.TILE_COLS": "tile_cols",
    "nnpp_edge.runtime.map.pyramid.ANOTHER_LEVEL_FROM": "another_level_from",
    "nnpp_edge.runtime.planners.learned.REFINE_FROM": "another_level_from",
    "nnpp_edge.runtime.bands.THREADS_FROM": "threads_from",
}
"""Sizes, made smaller so that small maps have many tiles and several coarse levels."""
Step = tuple[str, Any]


@dataclass(frozen=True)
class Case:
    """A map, how it becomes costs, and what is done with it."""

    dem: np.ndarray
    cell: tuple[float, float]
    limits: Traversability
    corner_cutting: bool
    omega: float
    tile_rows: int
    tile_cols: int
    another_level_from: int
    threads_from: int
    steps: tuple[Step, ...]

    def __repr__(self) -> str:
        """Long patches cut."""
        facts = {name: value for name, value in vars(self).items() if name not in ("steps", "dem")}
        with np.printoptions(threshold=60, linewidth=200):
            return "\n".join([f"{facts} {self.dem.dtype} {self.dem.shape}", *(f"  {step}" for step in self.steps)])


def generate(rng: random.Random, most_side: int = 90) -> Case:
    """A case of a few steps."""
    rows, cols = (max(int(most_side ** rng.random()), 1) for _ in range(2))
    if rng.random() < 0.7:
        rows, cols = max(rows, most_side // 3), max(cols, most_side // 3)
    numbers = np.random.default_rng(rng.getrandbits(32))
    cell = rng.choice(((1.0, 1.0), (20.0, 20.0), (2.0, 1.7)))
    limits = rng.choice(
        (
            Traversability(),
            Traversability(slope_limit_deg=15, hard_slope_deg=15),
            Traversability(step_limit_m=5, roughness_limit_m=8, hard_step_m=4),
        )
    )
    dem = _heights(rng, numbers, rows, cols, cell[0])
    tiles = rng.choice(((4, 4), (8, 16), (32, 64), (16, 4)))
    steps = tuple(_step(rng, numbers, dem, cell[0]) for _ in range(rng.choice((1, 3, 6, 12))))
    return Case(
        dem,
        cell,
        limits,
        rng.random() < 0.6,
        rng.choice((0.011, 0.011, 0.1, 0.0)),
        *tiles,
        rng.choice((2, 8, 16, 256)),
        rng.choice((1, 200_000)),
        steps,
    )


def _heights(rng: random.Random, numbers: np.random.Generator, rows: int, cols: int, size: float) -> np.ndarray:
    """Hills, plains or noise, with holes, islands and stripes of unknown cells, of several dtypes."""
    row, col = np.mgrid[:rows, :cols]
    steep = size * rng.choice((0.0, 0.05, 0.3, 1.0))
    dem = steep * (3.0 * np.sin(row / rng.uniform(2, 15)) + 4.0 * np.cos(col / rng.uniform(2, 15)))
    dem += size * rng.choice((0.0, 0.01, 0.2)) * numbers.normal(size=(rows, cols))
    dem += rng.choice((0.0, 0.0, -4000.0, 8000.0))
    kind = rng.choice(("whole", "whole", "holes", "islands", "stripe", "wall"))
    if kind in ("holes", "islands"):
        dem[numbers.random((rows, cols)) < (0.05 if kind == "holes" else 0.7)] = rng.choice((np.nan, np.inf, -np.inf))
    elif kind == "stripe":
        dem[:, cols // 2 : cols // 2 + rng.choice((1, 2, 9))] = np.nan
    elif kind == "wall":
        dem[rows // 2, rng.choice((0, 1)) : cols - rng.choice((0, 1))] += 100.0 * size
    return dem.astype(rng.choice((np.float32, np.float32, np.float64)))


def _step(rng: random.Random, numbers: np.random.Generator, dem: np.ndarray, size: float) -> Step:
    rows, cols = dem.shape
    if rng.random() < 0.45:
        height, width = (min(rng.choice((1, 1, 3, 10, 40)), most) for most in (rows, cols))
        row, col = rng.randrange(rows - height + 1), rng.randrange(cols - width + 1)
        patch = dem[row : row + height, col : col + width] + size * rng.choice((0.0, 0.1, 2.0)) * numbers.normal(
            size=(height, width)
        )
        patch[numbers.random(patch.shape) < rng.choice((0.0, 0.0, 0.3, 1.0))] = np.nan
        return "update", (row, col, patch.astype(rng.choice((np.float32, np.float64))))
    ends = [(rng.randrange(rows), rng.randrange(cols)) for _ in range(2)]
    return "plan", (*ends, rng.choice(METHODS), rng.choice((math.inf, math.inf, 0.0, 0.05)))


@contextlib.contextmanager
def sizes(case: Case) -> Iterator[None]:
    """The sizes of a case, for as long."""
    with contextlib.ExitStack() as stack:
        for target, name in _PATCHED.items():
            stack.enter_context(mock.patch(target, getattr(case, name)))
        yield


def check(case: Case, samples: Path | None = None) -> Problem | None:
    """Do all steps with both planners, and compare them with each other and with Dijkstra."""
    with sizes(case):
        return _check(case, samples)


def _check(case: Case, folder: Path | None) -> Problem | None:
    settings: dict[str, Any] = {"omega": case.omega, "corner_cutting": case.corner_cutting, "ask_from": 0}
    settings |= {"model": small_model(folder), "cell_width_m": case.cell[1], "warn": False}

    def planner(dem: np.ndarray, lazy: bool) -> Planner:
        return Planner.of_elevation(dem, case.cell[0], case.limits, lazy=lazy, **settings)

    dem = case.dem.copy()
    lazy, eager = planner(dem, True), planner(dem, False)
    if lazy.state.costs_computed != 0.0 or eager.state.costs_computed != 1.0:
        return Problem("computed at once or not", repr(case))
    for number, (kind, value) in enumerate(case.steps):
        told = f"step {number}\n{case!r}"
        if kind == "update":
            row, col, patch = value
            dem[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
            lazy.update_elevation(*value)
            eager.update_elevation(*value)
            continue
        start, goal, method, epsilon = value
        ours, theirs = (each.plan(start, goal, method=method, epsilon=epsilon) for each in (lazy, eager))
        for name in ("status", "cost", "lower_bound", "expansions", "threshold", "source"):
            one, other = getattr(ours, name), getattr(theirs, name)
            if one != other and not (one != one and other != other):
                return Problem(f"lazy is not eager: {name} of {method}", f"{one} {other}\n{told}")
        if not np.array_equal(ours.path, theirs.path):
            return Problem(f"lazy is not eager: path of {method}", told)
        cost = traversability_cost(dem, case.cell[0], case.limits, cell_width_m=case.cell[1], warn=False)
        exact = method == "astar" or epsilon == 0.0
        options: dict[str, Any] = {"step_cost": "paper", "omega": case.omega, "corner_cutting": case.corner_cutting}
        seen = seen_by_planner(cost, "paper")
        if problem := problem_with_plan(ours, seen, start, goal, exact=exact, epsilon=epsilon, told=told, **options):
            return problem
    rounded_alike = case.dem.dtype == np.float32  # others are relative to a height, which may have changed
    return _compare_maps(lazy, eager, planner(dem, False) if rounded_alike else eager, repr(case))


def _compare_maps(lazy: Planner, eager: Planner, fresh: Planner, told: str) -> Problem | None:
    """All weights, and all coarse levels, are those of a planner made afresh."""
    maps = [each.state.grid.map().copy() for each in (lazy, eager, fresh)]
    if not (np.array_equal(maps[0], maps[1]) and np.array_equal(maps[1], maps[2])):
        return Problem("the maps are not alike", told)
    pyramids = [each.state.pyramid for each in (lazy, eager, fresh)]
    for each in (lazy, eager, fresh):
        each.state.grid.complete()
    for number in range(1, len(pyramids[0].levels)):
        one, other, third = (pyramid.levels[number] for pyramid in pyramids)
        for name in ("pieces", "links"):
            if not np.array_equal(getattr(one, name), getattr(other, name)):
                return Problem(f"lazy is not eager: {name} of level {number}", told)
        if not np.array_equal(one.grid.weights, other.grid.weights):
            return Problem(f"lazy is not eager: weights of level {number}", told)
        if not np.array_equal(other.links, third.links):
            return Problem(f"links of level {number} are not those of a fresh map", told)
    return None
