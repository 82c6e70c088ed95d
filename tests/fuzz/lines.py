"""Lines off the grid, of points and discs: their distance to obstacles, cost and turns."""

import math
import random

import numpy as np

from nnpp_edge.runtime import Ground, Planner, Vehicle
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.turns import curvatures
from tests import oracles
from tests.fuzz.cases import NOWHERE, Case, Place, Problem

SAMPLES = 16  # places a cell's length at which a line is checked


def generate(rng: random.Random, place: Place = NOWHERE) -> Case:
    """A map of 20 to 60 cells a side, with obstacles, a vehicle, and ends of lines."""
    numbers = np.random.default_rng(rng.getrandbits(32))
    kind = rng.choice(("point", "disc", "disc"))
    rows, cols = numbers.integers(20, 60, 2).tolist()
    size = rng.choice((0.5, 1.0))
    cost = numbers.random((rows, cols)).astype(np.float32) * rng.choice((0.9, 0.2))
    for _ in range(rng.randrange(2, 16)):
        row, col = numbers.integers(0, (rows, cols)).tolist()
        high, wide = numbers.integers(1, 4, 2).tolist()
        cost[row : row + high, col : col + wide] = np.inf
    vehicle = Vehicle(radius_m=size * rng.uniform(0.3, 2.2)) if kind == "disc" else None
    return Case(
        kind=kind,
        cost=cost,
        sides=rng.choice(((size, size), (size, size), (size, 0.8 * size))),
        vehicle=vehicle,
        turning_m=size * rng.uniform(1.0, 12.0) if vehicle and rng.random() < 0.4 else None,
        ends=[
            (int(row), int(col)) for row, col in numbers.integers(3, (rows - 3, cols - 3), (16, 2))
        ],
    )


def check(case: Case, place: Place = NOWHERE) -> Problem | None:
    """What is wrong with the lines between the ends of a case."""
    sides = {"cell_size_m": case.sides[0], "cell_width_m": case.sides[1]}
    planner = Planner(Ground(case.cost, **sides, vehicle=case.vehicle))
    for start, goal in zip(case.ends[::2], case.ends[1::2], strict=True):
        plan = planner.plan(start, goal, refine="any-angle", turning_radius_m=case.turning_m)
        if not plan.ok or plan.waypoints is None or len(plan.waypoints) < 2:
            continue
        if problem := _turns(plan, case) or _OF_KIND[case.kind](plan, case):
            return Problem(problem, f"{start} to {goal}\n{case!r}\n{plan.waypoints.tolist()}")
    return None


def _dense(points: np.ndarray) -> np.ndarray:
    """Places along way points."""
    legs = []
    for begin, end in zip(points[:-1], points[1:], strict=True):
        count = max(int(SAMPLES * math.hypot(*(end - begin))), 1)
        legs.append(begin + (np.arange(count) / count)[:, None] * (end - begin))
    return np.concatenate([*legs, points[-1:]])


def _distance_m(places: np.ndarray, blocked: np.ndarray, sides: tuple[float, float]) -> float:
    """From the nearest of places to a blocked cell's square, or to what lies off the map."""
    rows, cols = np.nonzero(np.pad(blocked, 1, constant_values=True))
    down = np.maximum(np.abs(places[:, :1] - (rows - 1)) - 0.5, 0.0) * sides[0]
    along = np.maximum(np.abs(places[:, 1:] - (cols - 1)) - 0.5, 0.0) * sides[1]
    return float(np.hypot(down, along).min())


def _turns(plan: Plan, case: Case) -> str:
    if case.turning_m is None:
        return ""
    sharpest = float(curvatures(plan.waypoints * case.sides).max(initial=0.0))
    return f"turns sharper than {case.turning_m}" if sharpest * case.turning_m > 1.0 + 1e-6 else ""


def _of_point(plan: Plan, case: Case) -> str:
    """Its cost, by very many samples of the bilinear density."""
    total = oracles.line_cost(plan.waypoints, case.cost, per_cell=2000)
    return (
        ""
        if abs(total - plan.line_cost) <= 2e-3 * total
        else f"costs {plan.line_cost}, and by samples {total}"
    )


def _of_disc(plan: Plan, case: Case) -> str:
    radius = case.vehicle.radius_m
    near = _distance_m(_dense(plan.waypoints), ~(case.cost < 1.0), case.sides)
    return f"a disc of {radius} comes within {near}" if near < radius * 0.99999 else ""


_OF_KIND = {"point": _of_point, "disc": _of_disc}
