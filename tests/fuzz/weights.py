"""Maps with weights over the whole range of float32, planned on by every method and compared with Dijkstra."""

import math
import random
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.errors import InvalidMapError, NnppEdgeError, Status
from nnpp_edge.runtime.map.step_cost import LEAST_WEIGHT, MOST_WEIGHT
from tests import oracles, strategies
from tests.fuzz.commands import Problem

NAME = "weights"
EXACT, TOO_MUCH = 3e-5, 30
"""Share by which an exact path may cost more than Dijkstra's: g is kept in float32, and a path has hundreds of steps.
And expansions a cell that no search of a small map needs."""
FAR_APART = 1e9
"""Factor between weights from which on landmarks, which are kept in float32, make a search expand cells again."""
METHODS = ("astar", "corridor", "nnpp", "auto")


@dataclass(frozen=True)
class Case(strategies.Case):
    """A map, two cells of it, and how it is to be planned on."""

    omega: float
    method: str
    epsilon: float
    landmarks: int
    kind: str

    def __repr__(self) -> str:
        """All that is needed to make it again."""
        rows = np.array2string(np.ma.filled(self.cost, np.nan), threshold=2000, max_line_width=200)
        settings = {name: value for name, value in vars(self).items() if name != "cost"}
        return f"{settings}, {type(self.cost).__name__} {self.cost.dtype} {self.cost.shape}\n{rows}"


def generate(rng: random.Random, most_side: int = 40) -> Case:
    """A case; small ones are drawn as often as large ones."""
    rows, cols = (max(int(most_side ** rng.random()), 1) for _ in range(2))
    step_cost = rng.choice(("paper", "length"))
    numbers = np.random.default_rng(rng.getrandbits(32))
    kind, cost = _weights(rng, numbers, rows, cols) if step_cost == "length" else _costs(rng, numbers, rows, cols)
    blocked = numbers.random((rows, cols)) < rng.choice((0.0, 0.0, 0.1, 0.3, 0.5))
    with np.errstate(over="ignore", under="ignore"):
        cost = cost.astype(rng.choice((np.float32, np.float32, np.float64)))
    way = rng.choice(("inf", "nan", "masked"))
    if way == "masked":
        cost = np.ma.masked_array(cost, blocked)
    else:
        cost[blocked] = np.inf if way == "inf" else np.nan
    start, goal = ((rng.randrange(rows), rng.randrange(cols)) for _ in range(2))
    return Case(
        cost,
        start,
        goal,
        step_cost,
        rng.random() < 0.5,
        rng.choice((0.011, 0.011, 0.0, 1e-9, 1.0, 1e3)),
        rng.choice(METHODS),
        rng.choice((math.inf, math.inf, 0.0, 0.05)),
        rng.choice((0, 0, 0, 3)),
        kind,
    )


def _weights(rng: random.Random, numbers: np.random.Generator, rows: int, cols: int) -> tuple[str, np.ndarray]:
    """Weights above 0; one map in ten may hold some out of range."""
    share = numbers.random((rows, cols))
    kind = rng.choice(("all", "one size", "few dear", "few cheap", "tiny", "huge", "equal", "levels", "steps"))
    size = 10.0 ** rng.uniform(-40.0, 32.0)
    if kind == "all":
        cost = 10.0 ** (-37.9 + share * rng.choice((67.9, 50.0, 20.0)))
    elif kind == "one size":
        cost = size * (1.0 + share * rng.choice((1e-6, 0.1, 3.0, 1e3)))
    elif kind in ("few dear", "few cheap"):
        cost = size * (1.0 + 2.0 * share)
        factor = 10.0 ** rng.uniform(1.0, 30.0)
        for _ in range(rng.choice((1, 3, 5))):
            cost[rng.randrange(rows), rng.randrange(cols)] *= factor if kind == "few dear" else 1.0 / factor
    elif kind == "tiny":
        cost = 10.0 ** (-37.9 + 15.0 * share)
    elif kind == "huge":
        cost = MOST_WEIGHT * (0.1 + 0.9 * share)
    elif kind == "equal":
        cost = np.full((rows, cols), size)
    elif kind == "levels":
        cost = size * 10.0 ** np.round(3.0 * share)
    else:
        cost = size * (1 << (numbers.integers(0, 40, (rows, cols))))
    return kind, cost if rng.random() < 0.1 else np.clip(cost, LEAST_WEIGHT, MOST_WEIGHT)


def _costs(rng: random.Random, numbers: np.random.Generator, rows: int, cols: int) -> tuple[str, np.ndarray]:
    """Traversability costs in [0, 1), and some of 1 and more, which are impassable."""
    share = numbers.random((rows, cols))
    kind = rng.choice(("uniform", "tiny", "near 1", "zeros", "over 1", "equal"))
    if kind == "tiny":
        share = 10.0 ** (-45.0 * share)
    elif kind == "near 1":
        share = 1.0 - 10.0 ** (-1.0 - 8.0 * share)
    elif kind == "zeros":
        share[share < 0.7] = rng.choice((0.0, -0.0))
    elif kind == "over 1":
        share[share > 0.9] *= 10.0 ** rng.uniform(0.0, 37.0)
    elif kind == "equal":
        share[:] = share[0, 0]
    return kind, share


def check(case: Case, samples: Path | None = None, planner_type: type = Planner) -> Problem | None:
    """Plan, and compare with Dijkstra in float64."""
    seen = seen_by_planner(case.cost, case.step_cost)
    given = np.ma.filled(np.ma.asarray(case.cost, np.float64), np.inf)  # some are beyond what a float32 holds
    given = given[np.isfinite(given)]
    lengths = case.step_cost == "length"
    most = np.float64(np.float32(MOST_WEIGHT)) if lengths else np.finfo(np.float32).max
    out_of_range = bool((given > most).any() or (lengths and (given < LEAST_WEIGHT).any()))
    try:
        planner = planner_type(
            case.cost,
            step_cost=case.step_cost,
            omega=case.omega,
            corner_cutting=case.corner_cutting,
            model=small_model(samples),
            ask_from=0,
        )
        if case.landmarks:
            planner.prepare(landmarks=case.landmarks)
        plan = planner.plan(case.start, case.goal, method=case.method, epsilon=case.epsilon)
    except NnppEdgeError as error:
        if out_of_range and isinstance(error, InvalidMapError):
            return None
        return Problem(f"refused: {type(error).__name__}", f"{error}\n{case!r}")
    if out_of_range:
        return Problem("weights out of range are taken", repr(case))
    return problem_with_plan(
        plan,
        seen,
        case.start,
        case.goal,
        step_cost=case.step_cost,
        corner_cutting=case.corner_cutting,
        omega=case.omega,
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
        seen = np.ma.filled(np.ma.asarray(cost, np.float64), np.inf).astype(np.float32).astype(np.float64)
    impassable = ~np.isfinite(seen) | ((seen >= 1.0) if step_cost == "paper" else False)
    return np.where(impassable, np.inf, seen)


def problem_with_plan(
    plan: object,
    seen: np.ndarray,
    start: tuple[int, int],
    goal: tuple[int, int],
    *,
    step_cost: str,
    corner_cutting: bool,
    omega: float = 0.011,
    exact: bool,
    epsilon: float = math.inf,
    most_expansions: float = TOO_MUCH,
    told: str = "",
) -> Problem | None:
    """What is wrong with an answer on a map whose costs are `seen`."""
    found: oracles.Answer = plan  # type: ignore[assignment]
    passable = np.isfinite(seen)
    blocked = Status.START_BLOCKED if not passable[start] else None if passable[goal] else Status.GOAL_BLOCKED
    if blocked is not None:
        return None if found.status is blocked else Problem(f"{found.status} for {blocked}", told)
    optimum = oracles.cheapest(seen, start, goal, step_cost, corner_cutting, omega)
    name, facts = str(getattr(found, "planner", "")), f"{found}\noptimum {optimum!r}\n{told}"
    if not math.isfinite(optimum):
        return (
            None
            if found.status is Status.NO_PATH
            else Problem(f"{found.status} where there is no path: {name}", facts)
        )
    if found.status is not Status.OK:
        return Problem(f"{found.status} where there is a path: {name}", facts)
    path = [tuple(map(int, cell)) for cell in found.path]
    if wrong := oracles.path_problem(path, seen, start, goal, corner_cutting):
        return Problem(f"{wrong}: {name}", facts)
    cost = oracles.path_cost(path, seen, step_cost, omega)
    if abs(cost - found.cost) > 1e-5 * cost:
        return Problem(f"its cost is not its path's: {name}", f"{cost!r}, {facts}")
    if exact and cost > optimum * (1.0 + EXACT):
        return Problem(f"not the optimum: {name}", facts)
    if found.lower_bound > optimum * (1.0 + EXACT):
        return Problem(f"its lower bound is above the optimum: {name}", facts)
    if math.isfinite(epsilon) and cost > (1.0 + epsilon) * optimum * (1.0 + EXACT):
        return Problem(f"more than 1 + epsilon times the optimum: {name}", facts)
    if found.expansions > most_expansions * seen.size + 1000:
        return Problem(f"{found.expansions / seen.size:.0f} expansions a cell: {name}", facts)
    return None


_MODELS: dict[Path, object] = {}


def small_model(folder: Path | None) -> object:
    """The smallest network, loaded once in a process; its file lies in `folder`."""
    if folder is None:
        return "edge"
    from nnpp_edge.runtime import NetworkModel

    if folder not in _MODELS:
        _MODELS[folder] = NetworkModel(folder / "tiny.onnx", threads=1)
    return _MODELS[folder]
