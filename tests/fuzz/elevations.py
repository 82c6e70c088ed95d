"""Maps of elevations that change: a planner that computes costs where it looks, beside one that
computes them all.
"""

import contextlib
import math
from unittest import mock

import numpy as np

from nnpp_edge.runtime import Planner, Traversability, traversability_cost
from tests.fuzz.cases import NOWHERE, Case, Problem, put
from tests.fuzz.sequences import METHODS, problem_with_plan, seen_by_planner

LIMITS = (
    Traversability(),
    Traversability.safe(),
    Traversability(slope_limit_deg=15, hard_slope_deg=15),
    Traversability(step_limit_m=5, roughness_limit_m=8, hard_step_m=4),
)


def generate(rng, place=NOWHERE, most_side=90):
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
        vehicle=None,
        limits=rng.choice(LIMITS),
        corner_cutting=rng.random() < 0.5,
        omega=rng.choice((0.011, 0.1, 0.0)),
        sizes=draw_sizes(rng),
        steps=draw_steps(rng, numbers, dem, cell[0], (1, 3, 6, 12), METHODS),
    )


def draw_steps(rng, numbers, dem, size, counts, methods):
    """Patches, and plans with the ends as shares of the cells that one can stand on."""
    return [
        draw_patch(rng, numbers, dem, size)
        if rng.random() < 0.45
        else (
            "plan",
            (
                (rng.random(), rng.random()),
                rng.choice(methods),
                rng.choice((math.inf, math.inf, 0.0, 0.05)),
            ),
        )
        for _ in range(rng.choice(counts))
    ]


def draw_sizes(rng):
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


def draw_heights(rng, numbers, rows, cols, size):
    """Slopes and hills, with rocks of about this size, walls, cliffs, holes and islands, of several
    dtypes.
    """
    row, col = np.mgrid[:rows, :cols]
    waves = np.sin(row / rng.uniform(2, 9)) + np.cos(col / rng.uniform(2, 9))
    dem = size * rng.choice((0.0, 0.1, 0.3, 1.0)) * waves
    dem += size * rng.choice((0.0, 0.0, 0.1)) * (row + rng.choice((0.0, 1.0)) * col)
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


def draw_patch(rng, numbers, dem, size, most=40):
    """An update of a part by other heights, some of them unknown."""
    rows, cols = dem.shape
    height, width = (min(rng.choice((1, 1, 3, 10, most)), side) for side in dem.shape)
    row = rng.randrange(rows - height + 1)
    col = rng.randrange(cols - width + 1)
    noise = size * rng.choice((0.0, 0.1, 2.0)) * numbers.normal(size=(height, width))
    patch = dem[row : row + height, col : col + width] + noise
    patch[numbers.random(patch.shape) < rng.choice((0.0, 0.0, 0.3, 1.0))] = np.nan
    return "update", (row, col, patch.astype(rng.choice((np.float32, np.float64))))


def check(case, place=NOWHERE):
    """Do all steps with both planners, and compare them with each other and with Dijkstra."""
    return drive(case, place, _judged, _compare_maps)


def drive(case, place, judged, compared):
    """Do a case's steps with a planner that computes where it looks and one that computes all:
    what is wrong with a plan by `judged`, and with their maps in the end, beside those of a planner
    made afresh, by `compared`.
    """
    settings = {"omega": case.omega, "vehicle": case.vehicle, "model": place.model, "ask_from": 0}
    settings |= {"corner_cutting": case.corner_cutting, "cell_width_m": case.cell[1], "warn": False}
    dem = case.dem.copy()

    def planner(lazy):
        return Planner.of_elevation(dem.copy(), case.cell[0], case.limits, lazy=lazy, **settings)

    with contextlib.ExitStack() as stack:
        for target, value in case.sizes.items():
            stack.enter_context(mock.patch(f"nnpp_edge.runtime.{target}", value))
        planners = planner(True), planner(False)
        for number, (kind, value) in enumerate(case.steps):
            told = f"step {number}\n{case!r}"
            if kind == "plan" and (problem := judged(case, dem, planners, *value, told)):
                return problem
            if kind == "update":
                put(dem, *value)
                for each in planners:
                    each.update_elevation(*value)
        return compared(case, dem, *planners, planner(False))


def _judged(case, dem, planners, ends, method, epsilon, told):
    start, goal = (tuple(int(share * n) for n in dem.shape) for share in ends)
    ours, theirs = (each.plan(start, goal, method=method, epsilon=epsilon) for each in planners)
    for name in ("status", "cost", "lower_bound", "expansions", "threshold", "source", "path"):
        both = [np.asarray(getattr(each, name)) for each in (ours, theirs)]
        if not np.array_equal(*both, equal_nan=both[0].dtype.kind == "f"):
            return Problem(f"lazy is not eager: {name} of {method}", f"{both}\n{told}")
    width = {"cell_width_m": case.cell[1], "warn": False}
    cost = traversability_cost(dem, case.cell[0], case.limits, **width)
    return problem_with_plan(
        ours,
        seen_by_planner(cost, "paper"),
        start,
        goal,
        omega=case.omega,
        corner_cutting=case.corner_cutting,
        exact=method == "astar" or epsilon == 0.0,
        epsilon=epsilon,
        told=told,
    )


def _compare_maps(case, dem, lazy, eager, fresh):
    """All weights, and all coarse levels, are those of a planner made afresh."""
    # other heights are kept relative to one that may have changed
    fresh = fresh if case.dem.dtype == np.float32 else eager
    every = [each.state for each in (lazy, eager, fresh)]
    maps = [state.grid.map().copy() for state in every]
    pyramids = [state.pyramid for state in every]
    for state in every:
        state.grid.complete()
    for one, other, third in zip(*(pyramid.levels[1:] for pyramid in pyramids), strict=True):
        pairs = [(one.pieces, other.pieces), (one.links, other.links), (other.links, third.links)]
        pairs.append((one.grid.weights, other.grid.weights))
        if not all(np.array_equal(*pair) for pair in pairs):
            return Problem("lazy is not eager: a coarse level", repr(case))
    alike = np.array_equal(maps[0], maps[1]) and np.array_equal(maps[1], maps[2])
    return None if alike else Problem("the maps are not alike", repr(case))
