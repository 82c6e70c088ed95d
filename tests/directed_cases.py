"""Random maps of heights for directed steps, and scipy's Dijkstra on the directed graph as their
oracle.
"""

import math

import numpy as np

from nnpp_edge.runtime import Traversability, traversability_cost
from nnpp_edge.runtime.robots.slope.cost import (
    SLOPE_COSTS,
    EnergyCost,
    Mobility,
    TimeCost,
)
from tests import oracles
from tests.strategies import odd_heights

MOBILITY = Mobility(
    time=TimeCost((-20.0, -5.0, 0.0, 12.0, 25.0), (0.3, 0.9, 0.8, 0.3, 0.1)),
    energy=EnergyCost(40.0, 0.12, efficiency=0.6, recovery=0.5),
)
MODELS = tuple(SLOPE_COSTS)


SIDES_M = ((1.0, 1.0), (1.0, 0.7), (1.0, 2.5), (20.0, 20.0))
LIMITS = (
    Traversability(),
    Traversability.safe(),
    Traversability(hard_slope_deg=25.0),
    Traversability(hard_slope_deg=40.0),
    Traversability(step_limit_m=5, roughness_limit_m=8, hard_step_m=4),
)


def hills(rng, most_side=24):
    """Heights on maps of every shape, the sides of a cell, and limits by which some are
    impassable.
    """
    shape = rng.integers(1, most_side + 1, 2)
    sides = SIDES_M[rng.integers(len(SIDES_M))]
    limits = LIMITS[rng.integers(len(LIMITS))]
    dem = odd_heights(rng, shape, sides[0])
    cost = traversability_cost(dem, sides[0], limits, cell_width_m=sides[1], warn=False)
    return (dem, sides, limits) if (cost < 1.0).any() else hills(rng, most_side)


def dijkstra(case, model, start):
    """(H, W) cost of the cheapest path from `start` to each cell, by scipy; inf where there is
    none.
    """
    heights = np.where(np.isfinite(case.dem), case.dem, 0.0).astype(np.float64)
    ground = ground_of(case, model).ravel()

    def price(step, one, other):
        rise = heights.flat[other] - heights.flat[one]
        cost = model.cost(math.hypot(step[0] * case.sides[0], step[1] * case.sides[1]), rise)
        return cost * (ground[one] + ground[other]) / 2 - model.height_price * rise

    ways = oracles.steps(case.passable, price, case.corner_cutting)
    found = oracles.costs_from(ways, case.dem.shape, start)
    return found + model.height_price * (heights - heights[start])


def ground_of(case, model):
    """(H, W) how many times as dear a metre is on each cell."""
    ground = model.ground(case.dem, case.sides)
    return ground.astype(np.float64) if ground.size else np.ones(case.dem.shape)


def path_cost(path, case, model):
    """Sum of what the steps of a path cost by the model itself."""
    cells = tuple(path.T)
    ground = ground_of(case, model)[cells]
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
