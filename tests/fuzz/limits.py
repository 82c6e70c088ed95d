"""Time limits of 1 to 100 ms, for every method, on maps of several sizes: answers come when they were asked for."""

import random
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nnpp_edge.runtime import DynamicPlanner, Plan, Planner, Status, Vehicle
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method
from nnpp_edge.terrain.synthetic import fractal
from tests.fuzz.commands import Problem

NAME = "limits"
SIDES = (256, 256, 512, 512, 1024, 1024, 2048, 4096)
LATE_S, LATE_SHARE = 5e-3, 0.1
"""An answer may be so late, or so much of the limit, whichever is more."""
TRIES = 5
"""How often a case is done before it counts: another program may have held up all but one."""
VEHICLES = {
    "point": None,
    "disc": Vehicle(radius_m=1.3),
    "body": Vehicle(length_m=3.0, width_m=2.4, clearance_m=0.6),
    "large body": Vehicle(length_m=8.0, width_m=5.0, clearance_m=1.5),
}
STEP_COSTS = ("paper", "paper", "paper", "tobler")
SHARED: dict[str, object] = {}


@dataclass(frozen=True)
class Case:
    """A map, who drives on it, and how much time there is for each of some queries."""

    side: int
    seed: int
    rough: float
    vehicle: str
    costs: bool
    """Whether the map is of costs, not of elevations."""
    step_cost: str
    method: Method | DynamicMethod
    ends: tuple[tuple[float, float], tuple[float, float]]
    """Shares of the map's side."""
    limits_ms: tuple[float, ...]
    patch: int
    """Side of the rectangle that changes before each query but the first; 0 for none."""


def generate(rng: random.Random, most_side: int = 4096) -> Case:
    """A case; large maps without what would not fit into the memory that a case has."""
    side = rng.choice([each for each in SIDES if each <= most_side])
    vehicle = rng.choice(list(VEHICLES)) if side <= 1024 else rng.choice(("point", "disc"))
    costs = side > 2048 or (vehicle in ("point", "disc") and rng.random() < 0.5)
    methods = [*Method, *DynamicMethod] if side <= 1024 else [*Method]
    ends = (rng.uniform(0.02, 0.3), rng.random()), (rng.uniform(0.7, 0.98), rng.random())
    return Case(
        side,
        rng.getrandbits(16),
        rng.choice((0.2, 0.5, 1.0)),
        vehicle,
        costs,
        "paper" if costs or side > 1024 else rng.choice(STEP_COSTS),
        rng.choice(methods),
        ends,
        tuple(rng.choice((1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)) for _ in range(rng.choice((1, 2, 4)))),
        rng.choice((0, 0, 3, 40, side // 2)),
    )


def check(case: Case, samples: Path | None = None) -> Problem | None:
    """Do it until no answer was late, a few times at the most; what was late in every try is a finding."""
    _warm(case)
    for _ in range(TRIES):
        late = _late(case)
        if late is None:
            return None
    return Problem("late answer", f"{late}\n{case}")


def _late(case: Case) -> str | None:
    """Of what answer came late, and how."""
    heights = _heights(case)
    planner, dynamic = _planner(case, heights), isinstance(case.method, DynamicMethod)
    start, goal = _ends(case)
    if dynamic:
        planner.move(start)
    for number, limit_ms in enumerate(case.limits_ms):
        if number and case.patch:
            _change(case, planner, heights, number)
        began, used = time.perf_counter(), time.process_time()
        if dynamic:
            plan = planner.replan(time_limit_s=1e-3 * limit_ms)
        else:
            plan = planner.plan(start, goal, method=case.method, time_limit_s=1e-3 * limit_ms)
        # what others hold up takes time and no processor; what several threads do takes more processor than time
        took = min(time.perf_counter() - began, time.process_time() - used)
        if took - 1e-3 * limit_ms > max(LATE_S, LATE_SHARE * 1e-3 * limit_ms):
            return f"query {number} of {limit_ms} ms took {1e3 * took:.1f} ms: {plan.status} {plan.timings_ms}"
        if problem := _wrong(plan):
            return problem
    return None


def _wrong(plan: Plan) -> str | None:
    """What a plan says that cannot be."""
    if plan.ok == bool(plan.reason) or (plan.status is Status.TIMEOUT and plan.ok):
        return f"{plan.status} with the reason {plan.reason!r}"
    return None


def _heights(case: Case) -> np.ndarray:
    tile = fractal(np.random.default_rng(case.seed), 256, 1.0, 10.0 * case.rough)
    both = np.block([[tile, tile[:, ::-1]], [tile[::-1], tile[::-1, ::-1]]])
    return np.tile(both, (max(case.side // 512, 1),) * 2)[: case.side, : case.side].astype(np.float32)


def _planner(case: Case, heights: np.ndarray) -> Planner | DynamicPlanner:
    vehicle, dynamic = VEHICLES[case.vehicle], isinstance(case.method, DynamicMethod)
    given = {"vehicle": vehicle}
    if case.costs:
        cost = np.clip(np.abs(heights) / np.abs(heights).max() * 1.2, 0.0, 1.0)
        sized = given | {"cell_size_m": None if vehicle is None else 1.0}
        return DynamicPlanner(cost, _ends(case)[1], case.method, **sized) if dynamic else Planner(cost, **sized)
    given |= {"step_cost": case.step_cost}
    if dynamic:
        return DynamicPlanner.of_elevation(heights, 1.0, _ends(case)[1], method=case.method, **given)
    return Planner.of_elevation(heights, 1.0, warn=False, **given)


def _ends(case: Case) -> tuple[tuple[int, int], tuple[int, int]]:
    (a, b), (c, d) = case.ends
    most = case.side - 8
    return (4 + int(a * most), 4 + int(b * most)), (4 + int(c * most), 4 + int(d * most))


def _change(case: Case, planner: Planner | DynamicPlanner, heights: np.ndarray, number: int) -> None:
    at = (case.seed * number) % (case.side - case.patch + 1)
    part = heights[at : at + case.patch, at : at + case.patch] + np.float32(0.1 * number)
    if case.costs:
        planner.update(at, at, np.full(part.shape, 0.3 + 0.1 * number, np.float32))
    else:
        planner.update_elevation(at, at, part)


def _warm(case: Case) -> None:
    """Load what a process loads once: the network, and the kernels for such a case."""
    name = f"{case.method} {case.vehicle} {case.costs} {case.step_cost}"
    if name not in SHARED:
        small = Case(**(vars(case) | {"side": 256, "limits_ms": (60_000.0, 60_000.0), "patch": 3}))
        SHARED[name] = _late(small)
