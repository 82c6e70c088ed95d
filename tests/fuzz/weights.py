"""Maps with weights over the whole range of float32, planned on by every method and compared with
Dijkstra.
"""

import math
import random
from typing import Any

import numpy as np

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.errors import InvalidMapError, NnppEdgeError, Status
from nnpp_edge.runtime.terrain.step_cost import LEAST_WEIGHT, MOST_WEIGHT
from tests import oracles
from tests.fuzz.cases import NOWHERE, Case, Place, Problem, problem_with_optimum

TOO_MUCH = 30
FAR_APART = 1e9
"""Expansions a cell that no search of a small map needs, a hundred times as many where weights
lie so far apart that landmarks, which are kept in float32, make a search expand cells again."""
METHODS = ("astar", "corridor", "nnpp", "auto")


def generate(rng: random.Random, place: Place = NOWHERE, most_side: int = 40) -> Case:
    """A map, two cells of it, and how it is to be planned on; small maps are drawn as often as
    large ones.
    """
    rows, cols = (max(int(most_side ** rng.random()), 1) for _ in range(2))
    step_cost = rng.choice(("paper", "length"))
    numbers = np.random.default_rng(rng.getrandbits(32))
    cost = (_weights if step_cost == "length" else _costs)(rng, numbers, rows, cols)
    blocked = numbers.random((rows, cols)) < rng.choice((0.0, 0.0, 0.1, 0.3, 0.5))
    with np.errstate(over="ignore", under="ignore"):
        cost = cost.astype(rng.choice((np.float32, np.float32, np.float64)))
    way = rng.choice(("inf", "nan", "masked"))
    if way == "masked":
        cost = np.ma.masked_array(cost, blocked)
    else:
        cost[blocked] = float(way)
    return Case(
        cost=cost,
        start=(rng.randrange(rows), rng.randrange(cols)),
        goal=(rng.randrange(rows), rng.randrange(cols)),
        step_cost=step_cost,
        corner_cutting=rng.random() < 0.5,
        omega=rng.choice((0.011, 0.011, 0.0, 1e-9, 1.0, 1e3)),
        method=rng.choice(METHODS),
        epsilon=rng.choice((math.inf, math.inf, 0.0, 0.05)),
        landmarks=rng.choice((0, 0, 0, 3)),
    )


def _weights(rng: random.Random, numbers: np.random.Generator, rows: int, cols: int) -> np.ndarray:
    """Weights of one size or of up to 68 decades, a few of them far from the others; seldom out of
    range.
    """
    share = numbers.random((rows, cols))
    share = (
        share if rng.random() < 0.7 else np.round(rng.choice((0, 3, 40)) * share) / 40.0
    )  # equal, or in levels
    spread = rng.choice((1e-6, 0.1, 0.5, 3.0, 12.0, 20.0, 50.0, 68.0))
    values = 10.0 ** (rng.uniform(-40.0, 32.0 - 0.9 * spread) + spread * share)
    for _ in range(rng.choice((0, 0, 1, 3, 5))):
        values[rng.randrange(rows), rng.randrange(cols)] *= 10.0 ** rng.uniform(-30.0, 30.0)
    return values if rng.random() < 0.1 else np.clip(values, LEAST_WEIGHT, MOST_WEIGHT)


def _costs(rng: random.Random, numbers: np.random.Generator, rows: int, cols: int) -> np.ndarray:
    """Traversability costs in [0, 1), and some of 1 and more, which are impassable."""
    share = numbers.random((rows, cols))
    return rng.choice(
        (
            share,
            10.0 ** (-45.0 * share),
            1.0 - 10.0 ** (-1.0 - 8.0 * share),
            np.where(share < 0.7, rng.choice((0.0, -0.0)), share),
            np.where(share > 0.9, share * 10.0 ** rng.uniform(0.0, 37.0), share),
            np.full((rows, cols), share[0, 0]),
        )
    )


def check(case: Case, place: Place = NOWHERE, planner_type: type = Planner) -> Problem | None:
    """Plan, and compare with Dijkstra in float64."""
    seen = seen_by_planner(case.cost, case.step_cost)
    given = np.ma.filled(
        np.ma.asarray(case.cost, np.float64), np.inf
    )  # some are beyond what a float32 holds
    given = given[np.isfinite(given)]
    lengths = case.step_cost == "length"
    most = np.float64(np.float32(MOST_WEIGHT)) if lengths else np.finfo(np.float32).max
    out_of_range = bool((given > most).any() or (lengths and (given < LEAST_WEIGHT).any()))
    settings = {name: getattr(case, name) for name in ("step_cost", "omega", "corner_cutting")}
    try:
        planner = planner_type(case.cost, **settings, model=place.model, ask_from=0)
        if case.landmarks:
            planner.prepare(landmarks=case.landmarks)
        plan = planner.plan(case.start, case.goal, method=case.method, epsilon=case.epsilon)
    except NnppEdgeError as error:
        refused_rightly = out_of_range and isinstance(error, InvalidMapError)
        return (
            None
            if refused_rightly
            else Problem(f"refused: {type(error).__name__}", f"{error}\n{case!r}")
        )
    if out_of_range:
        return Problem("weights out of range are taken", repr(case))
    return problem_with_plan(
        plan,
        seen,
        case.start,
        case.goal,
        **settings,
        exact=case.method == "astar" or case.epsilon == 0.0,
        epsilon=case.epsilon,
        most_expansions=100 * TOO_MUCH if case.landmarks and apart(seen) > FAR_APART else TOO_MUCH,
        told=repr(case),
    )


def apart(seen: np.ndarray) -> float:
    """The greatest weight over the least above 0."""
    weights = seen[np.isfinite(seen) & (seen > 0.0)]
    return float(weights.max() / weights.min()) if weights.size else 1.0


def seen_by_planner(cost: np.ndarray, step_cost: str) -> np.ndarray:
    """The costs in float64 as the planner must take them: rounded to float32, impassable as inf."""
    with np.errstate(over="ignore", under="ignore"):
        seen = (
            np.ma.filled(np.ma.asarray(cost, np.float64), np.inf)
            .astype(np.float32)
            .astype(np.float64)
        )
    return np.where(
        ~np.isfinite(seen) | ((seen >= 1.0) if step_cost == "paper" else False), np.inf, seen
    )


def problem_with_plan(
    plan: Any,
    seen: np.ndarray,
    start: tuple[int, int],
    goal: tuple[int, int],
    *,
    step_cost: str = "paper",
    corner_cutting: bool = True,
    omega: float = 0.011,
    exact: bool,
    epsilon: float = math.inf,
    most_expansions: float = TOO_MUCH,
    told: str = "",
) -> Problem | None:
    """What is wrong with an answer on a map whose costs are `seen`."""
    passable = np.isfinite(seen)
    blocked = (
        Status.START_BLOCKED
        if not passable[start]
        else None
        if passable[goal]
        else Status.GOAL_BLOCKED
    )
    if blocked is not None:
        return None if plan.status is blocked else Problem(f"{plan.status} for {blocked}", told)
    if plan.expansions > most_expansions * seen.size + 1000:
        return Problem(
            f"{plan.expansions / seen.size:.0f} expansions a cell: {plan.planner}",
            f"{plan}\n{told}",
        )
    return problem_with_optimum(
        plan,
        oracles.cheapest(seen, start, goal, step_cost, corner_cutting, omega),
        lambda path: oracles.path_problem(path, seen, start, goal, corner_cutting),
        lambda path: oracles.path_cost(path, seen, step_cost, omega),
        exact=exact,
        epsilon=epsilon,
        told=told,
    )
