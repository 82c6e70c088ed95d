"""Time limits of 1 to 100 ms, for every method, on maps of several sizes: answers come when they were asked for."""

import random
import time

import numpy as np

from nnpp_edge.runtime import DynamicPlanner, Ground, Planner, Vehicle
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method
from nnpp_edge.terrain.synthetic import fractal
from tests.fuzz.cases import NOWHERE, Case, Place, Problem

SIDES = (256, 256, 512, 512, 1024, 1024, 2048, 4096)
LATE_S, LATE_SHARE = 5e-3, 0.1
"""An answer may be so late, or so much of the limit, whichever is more."""
TRIES = 5  # how often a case is done before it counts: another program may have held up all but one
VEHICLES = {
    "point": None,
    "disc": Vehicle(radius_m=1.3),
    "body": Vehicle(length_m=3.0, width_m=2.4, clearance_m=0.6),
}
_WARM: set[str] = set()


def generate(rng: random.Random, place: Place = NOWHERE, most_side: int = 4096) -> Case:
    """A map, who drives on it, and how much time there is for each of some queries.

    Large maps come without what would not fit into the memory that a case has.
    """
    side = rng.choice([each for each in SIDES if each <= most_side])
    vehicle = rng.choice(list(VEHICLES)) if side <= 1024 else rng.choice(("point", "disc"))
    costs = side > 2048 or (vehicle in ("point", "disc") and rng.random() < 0.5)
    step_cost = rng.choice(("paper", "paper", "paper", "tobler"))
    cells = 4 + np.array(((rng.uniform(0.02, 0.3), rng.random()), (rng.uniform(0.7, 0.98), rng.random()))) * (
        side - 8
    )
    return Case(
        side=side,
        seed=rng.getrandbits(16),
        rough=rng.choice((0.2, 0.5, 1.0)),
        vehicle=vehicle,
        costs=costs,
        step_cost="paper" if costs or side > 1024 else step_cost,
        method=rng.choice([*Method, *DynamicMethod] if side <= 1024 else [*Method]),
        ends=[tuple(cell) for cell in cells.astype(int).tolist()],
        limits_ms=[rng.choice((1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)) for _ in range(rng.choice((1, 2, 4)))],
        patch=rng.choice((0, 0, 3, 40, side // 2)),
    )


def check(case: Case, place: Place = NOWHERE) -> Problem | None:
    """Do it until no answer was late, a few times at the most; what was late in every try is a finding."""
    name = f"{case.method} {case.vehicle} {case.costs} {case.step_cost}"
    if name not in _WARM:  # load what a process loads once: the network, and the kernels for such a case
        _WARM.add(name)
        ends = [(20, 20), (230, 230)]
        _late(case.but(side=256, ends=ends, limits_ms=(60_000.0, 60_000.0), patch=3))
    tries = [_late(case)]
    while tries[-1] and len(tries) < TRIES:
        tries.append(_late(case))
    return Problem("late answer", f"{tries[-1]}\n{case}") if tries[-1] else None


def _late(case: Case) -> str | None:
    """Which answer came late, and how, or says what cannot be."""
    heights = _heights(case)
    planner, (start, goal) = _planner(case, heights), case.ends
    for number, limit_ms in enumerate(case.limits_ms):
        if number and case.patch:
            _change(case, planner, heights, number)
        began, used = time.perf_counter(), time.process_time()
        if isinstance(planner, DynamicPlanner):
            plan = planner.replan(time_limit_s=1e-3 * limit_ms)
        else:
            plan = planner.plan(start, goal, method=case.method, time_limit_s=1e-3 * limit_ms)
        # what others hold up takes time and no processor; what several threads do takes more processor than time
        took = min(time.perf_counter() - began, time.process_time() - used)
        if took - 1e-3 * limit_ms > max(LATE_S, LATE_SHARE * 1e-3 * limit_ms):
            return f"query {number} of {limit_ms} ms took {1e3 * took:.1f} ms: {plan.status} {plan.timings_ms}"
    return None


def _heights(case: Case) -> np.ndarray:
    tile = fractal(np.random.default_rng(case.seed), 256, 1.0, 10.0 * case.rough)
    both = np.block([[tile, tile[:, ::-1]], [tile[::-1], tile[::-1, ::-1]]])
    return np.tile(both, (max(case.side // 512, 1),) * 2)[: case.side, : case.side].astype(np.float32)


def _planner(case: Case, heights: np.ndarray) -> Planner | DynamicPlanner:
    vehicle, start, goal = VEHICLES[case.vehicle], *case.ends
    if case.costs:
        cost = np.clip(np.abs(heights) / np.abs(heights).max() * 1.2, 0.0, 1.0)
        ground = Ground(cost, vehicle=vehicle, cell_size_m=None if vehicle is None else 1.0)
    else:
        ground = Ground.of_elevation(heights, 1.0, vehicle=vehicle, step_cost=case.step_cost)
    if not isinstance(case.method, DynamicMethod):
        return Planner(ground)
    planner = DynamicPlanner(ground, goal, case.method)
    planner.move(start)
    return planner


def _change(case: Case, planner: Planner | DynamicPlanner, heights: np.ndarray, number: int) -> None:
    at = (case.seed * number) % (case.side - case.patch + 1)
    part = heights[at : at + case.patch, at : at + case.patch] + np.float32(0.1 * number)
    if case.costs:
        planner.update(at, at, np.full(part.shape, 0.3 + 0.1 * number, np.float32))
    else:
        planner.update_elevation(at, at, part)
