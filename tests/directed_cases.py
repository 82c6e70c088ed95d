"""Random maps of heights for directed steps, and scipy's Dijkstra on the directed graph as their
oracle.
"""

import math
from dataclasses import dataclass

import numpy as np

from nnpp_edge.runtime import Traversability, traversability_cost
from nnpp_edge.runtime.robots.slope.cost import (
    SLOPE_COSTS,
    EnergyCost,
    Mobility,
    TimeCost,
)
from tests import oracles

MOBILITY = Mobility(
    time=TimeCost((-20.0, -5.0, 0.0, 12.0, 25.0), (0.3, 0.9, 0.8, 0.3, 0.1)),
    energy=EnergyCost(40.0, 0.12, efficiency=0.6, recovery=0.5),
)
MODELS = tuple(SLOPE_COSTS)


@dataclass(frozen=True)
class Hills:
    """Heights, what is impassable on them, and two passable cells."""

    dem: np.ndarray
    sides: tuple[float, float]
    limits: Traversability
    passable: np.ndarray
    start: tuple[int, int]
    goal: tuple[int, int]
    corner_cutting: bool


def hills(rng, most_side=24, least_side=1):
    """Slopes, ridges, steps and holes in maps of every shape; steep cells of some are
    impassable.
    """
    rows, cols = rng.integers(least_side, most_side + 1, 2)
    sides = 1.0, float(rng.choice([1.0, 1.0, 0.7, 2.5]))
    dem = rng.normal(0.0, rng.choice([0.0, 0.05, 0.2]), (rows, cols)).cumsum(int(rng.integers(2)))
    dem += rng.uniform(-0.4, 0.4) * np.arange(rows)[:, None] + rng.uniform(-0.4, 0.4) * np.arange(
        cols
    )
    dem = (dem + rng.choice([0.0, 2000.0])).astype(np.float32)
    dem[rng.random((rows, cols)) < rng.choice([0.0, 0.0, 0.15, 0.35])] = np.nan
    if not np.isfinite(dem).any():
        dem[0, 0] = 0.0
    limits = Traversability(hard_slope_deg=float(rng.choice([25.0, 40.0, math.inf])))
    cost = traversability_cost(dem, 1.0, limits, cell_width_m=sides[1], warn=False)
    passable = cost < 1.0
    if not passable.any():
        return hills(rng, most_side, least_side)
    cells = np.argwhere(passable)
    start, goal = (tuple(int(x) for x in cells[rng.integers(len(cells))]) for _ in range(2))
    return Hills(dem, sides, limits, passable, start, goal, bool(rng.integers(2)))


def dijkstra(case, model, start, dem=None):
    """(H, W) cost of the cheapest path from `start` to each cell, by scipy; inf where there is
    none.
    """
    dem = case.dem if dem is None else dem
    heights = np.where(np.isfinite(dem), dem, 0.0).astype(np.float64)
    ground = ground_of(dem, case, model).ravel()

    def price(step, one, other):
        rise = heights.flat[other] - heights.flat[one]
        cost = model.cost(math.hypot(step[0] * case.sides[0], step[1] * case.sides[1]), rise)
        return cost * (ground[one] + ground[other]) / 2 - model.height_price * rise

    found = oracles.costs_from(
        oracles.steps(case.passable, price, case.corner_cutting), dem.shape, start
    )
    return found + model.height_price * (heights - heights[start])


def ground_of(dem, case, model):
    """(H, W) how many times as dear a metre is on each cell."""
    ground = model.ground(dem, case.sides)
    return ground.astype(np.float64) if ground.size else np.ones(dem.shape)


def path_cost(path, case, model):
    """Sum of what the steps of a path cost by the model itself."""
    cells = tuple(path.T)
    ground = ground_of(case.dem, case, model)[cells]
    lengths = np.hypot(*(np.diff(path, axis=0) * case.sides).T)
    costs = model.cost(lengths, np.diff(case.dem[cells].astype(np.float64)))
    return float((costs * (ground[:-1] + ground[1:])).sum() / 2)


def tolerance(case, model):
    """By how much a cost may be off: what float32 loses of the sum of steps, whose height is priced
    apart.
    """
    heights = case.dem[case.passable].astype(np.float64)
    return 1e-5 * (
        sum(case.dem.shape) * model.least_per_m + model.height_price * float(np.ptp(heights))
    )
