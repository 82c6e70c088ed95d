"""Robots with a body on elevations that change: poses beside a naive check, plans beside Dijkstra over all poses."""

import math
import random
from typing import Any

import numpy as np

from nnpp_edge.runtime import Planner, Status, Vehicle, pose_costs
from tests import pose_oracles
from tests.fuzz.cases import NOWHERE, Case, Place, Problem, problem_with_optimum
from tests.fuzz.elevations import draw_patch, draw_sizes, drive, sizes

METHODS = ("astar", "corridor", "auto")
NEAR_A_LIMIT = 2e-5
"""Share of a limit by which a figure may miss it and still be on either side: heights are kept in float32."""
T_ROUNDED, T_ALIKE = 2.0 / pose_oracles.CODES, 2e-5
"""By how much T is rounded up at most, and how much it differs through float32 heights."""


def generate(rng: random.Random, place: Place = NOWHERE, most_side: int = 22) -> Case:
    """A case of a few steps; the body measures one cell to seven, and fits on the map."""
    numbers = np.random.default_rng(rng.getrandbits(32))
    cell = rng.choice(((1.0, 1.0), (0.25, 0.25), (20.0, 20.0), (2.0, 1.7), (0.3, 0.5)))
    vehicle = draw_vehicle(rng, min(cell))
    least = math.ceil(max(vehicle.length_m, vehicle.width_m) / min(cell))
    rows, cols = (rng.randint(least, max(most_side, least)) for _ in range(2))
    if rng.random() < 0.8:
        rows, cols = max(rows, most_side // 2), max(cols, most_side // 2)
    dem = draw_heights(rng, numbers, rows, cols, vehicle.clearance_m)

    def step() -> tuple[str, Any]:
        if rng.random() < 0.4:
            return draw_patch(rng, numbers, dem, vehicle.clearance_m, most=10)
        ends = rng.random(), rng.random()
        return "plan", (rng.random() < 0.1, ends, rng.choice(METHODS), rng.choice((math.inf, 0.0, 0.05)))

    return Case(
        dem=dem,
        cell=cell,
        vehicle=vehicle,
        omega=rng.choice((0.011, 0.011, 0.1, 0.0)),
        sizes=draw_sizes(rng),
        steps=[step() for _ in range(rng.choice((1, 2, 4, 8)))],
    )


def draw_vehicle(rng: random.Random, cell: float) -> Vehicle:
    """A body of one cell to seven, of odd sizes: no cell lies on an edge of it."""
    size = rng.choice(((0.8, 2.0), (1.0, 3.0), (1.5, 4.0), (3.0, 7.0)))
    length, width = (cell * rng.uniform(*size) for _ in range(2))
    long, wide = (side * rng.uniform(0.02, 0.3) for side in (length, width))
    clearance, narrow = cell * 10.0 ** rng.uniform(-0.8, 0.0), rng.random() < 0.6

    def perhaps(least: float, most: float) -> float | None:
        return rng.uniform(least, most) if rng.random() < 0.5 else None

    return Vehicle(
        length_m=length,
        width_m=width,
        clearance_m=clearance,
        max_tilt_deg=rng.uniform(10.0, 60.0),
        max_pitch_deg=perhaps(10.0, 60.0),
        max_roll_deg=perhaps(10.0, 60.0),
        max_step_m=perhaps(0.5 * clearance, 3.0 * clearance),
        axles=rng.choice((2, 2, 3, 4)),
        wheelbase_m=(length - long) * rng.uniform(0.4, 0.99) if narrow else None,
        track_m=(width - wide) * rng.uniform(0.4, 0.99) if narrow else None,
        wheel_length_m=long,
        wheel_width_m=wide,
        unknown_passes=rng.random() < 0.3,
    )


def draw_heights(rng: random.Random, numbers: np.random.Generator, rows: int, cols: int, size: float) -> np.ndarray:
    """Slopes and hills that a body of so much clearance can take or not, with rocks, walls, cliffs and holes."""
    row, col = np.mgrid[:rows, :cols]
    waves = np.sin(row / rng.uniform(2, 9) + rng.random()) + np.cos(col / rng.uniform(2, 9) + rng.random())
    dem = size * rng.choice((0.0, 0.1, 0.3, 1.0)) * waves
    dem += size * (rng.choice((0.0, 0.0, 0.1)) * row + rng.choice((0.0, 0.0, 0.1)) * col)
    dem += size * rng.choice((0.0, 0.01, 0.05)) * numbers.normal(size=(rows, cols))
    rocks = numbers.random((rows, cols)) < rng.choice((0.0, 0.01, 0.04))
    dem[rocks] += size * rng.choice((0.6, 1.0, 2.0)) * numbers.random(int(rocks.sum()))
    kind = rng.choice(("whole", "whole", "whole", "holes", "stripe", "wall", "cliff"))
    if kind == "holes":
        dem[numbers.random((rows, cols)) < rng.choice((0.005, 0.02))] = rng.choice((np.nan, np.inf, -np.inf))
    elif kind == "stripe":
        dem[: rng.randint(0, rows), cols // 2] = np.nan
    elif kind == "wall":
        dem[rows // 2, rng.choice((0, cols // 3, cols // 2)) :] += 10.0 * size
    elif kind == "cliff":
        dem[:, cols // 2 :] += size * rng.choice((0.5, 5.0))
    dem += rng.choice((0.0, 0.0, -40.0 * size, 100.0 * size))
    return dem.astype(rng.choice((np.float32, np.float32, np.float64)))


def check(case: Case, place: Place = NOWHERE) -> Problem | None:
    """Do all steps with a planner that checks poses where it looks and with one that checks all; compare them."""
    with sizes(case):
        return _check(case, place)


def _check(case: Case, place: Place) -> Problem | None:
    settings: dict[str, Any] = {"omega": case.omega, "ask_from": 0, "warn": False, "vehicle": case.vehicle}
    settings |= {"model": place.model, "cell_width_m": case.cell[1]}
    dem = case.dem.copy()
    lazy, dense = (Planner.of_elevation(dem.copy(), case.cell[0], lazy=lazy, **settings) for lazy in (True, False))
    if problem := problem_with_poses(dem, case.cell, case.vehicle, repr(case)):
        return problem

    def judged(anywhere: bool, ends: Any, method: str, epsilon: float, told: str) -> Problem | None:
        costs = pose_costs(dem, case.cell[0], case.vehicle, cell_width_m=case.cell[1])
        start, goal = (_cell_of(share, costs, anywhere) for share in ends)
        plans = [each.plan(start, goal, method=method, epsilon=epsilon) for each in (lazy, dense)]
        if plans[0].status is not plans[1].status or not math.isclose(plans[0].cost, plans[1].cost, rel_tol=1e-6):
            return Problem(f"lazy is not dense: {method}", f"{plans}\n{told}")
        given = costs, start, goal, case.omega, method == "astar" or epsilon == 0.0, epsilon, told
        # their bounds may differ: a pose that is not checked yet counts as free
        return problem_with_plan(plans[0], *given) or problem_with_plan(plans[1], *given)

    found = drive(case, dem, (lazy, dense), judged)
    return found or problem_with_poses(dem, case.cell, case.vehicle, repr(case))


def _cell_of(share: float, costs: np.ndarray, anywhere: bool) -> tuple[int, int]:
    """The cell so far through the map, or through those where the body may stand."""
    stands = np.isfinite(costs).any(0)
    cells = np.argwhere(stands | (anywhere or not stands.any()))
    row, col = cells[int(share * len(cells))]
    return int(row), int(col)


def problem_with_poses(
    dem: np.ndarray, cell: tuple[float, float], vehicle: Vehicle, told: str = ""
) -> Problem | None:
    """What differs between the dense poses and the naive ones; poses that rounding decides may do either."""
    found = pose_costs(dem, cell[0], vehicle, cell_width_m=cell[1])
    wanted, margins = pose_oracles.naive_pose_checks(dem, cell[0], vehicle, cell[1])
    if found.shape != wanted.shape or found.dtype != np.float32:
        return Problem("poses of another shape", f"{found.shape} {found.dtype}\n{told}")
    passes = np.isfinite(found)
    differ = (passes != np.isfinite(wanted)) & (margins > NEAR_A_LIMIT)
    if differ.any():
        at = tuple(np.argwhere(differ)[0])
        kind = "a pose passes that must fail" if passes[at] else "a pose fails that must pass"
        return Problem(kind, f"{int(differ.sum())} of them, first {at}: {found[at]} for {wanted[at]}\n{told}")
    both = passes & np.isfinite(wanted)
    if not ((found[both] >= 0.0) & (found[both] < 1.0)).all():
        return Problem("T is not in [0, 1)", told)
    more = found[both].astype(np.float64) - wanted[both]
    less = T_ALIKE + T_ROUNDED * (found[both].max(initial=0.0) > 0.999)
    if more.size and (more.min() < -less or more.max() > T_ROUNDED + T_ALIKE):
        return Problem("T of a pose is another", f"{more.min()} to {more.max()} more\n{told}")
    return None


def problem_with_plan(
    plan: Any,
    costs: np.ndarray,
    start: tuple[int, int],
    goal: tuple[int, int],
    omega: float,
    exact: bool,
    epsilon: float = math.inf,
    told: str = "",
) -> Problem | None:
    """What is wrong with an answer where the poses' T are `costs`, (4, H, W)."""
    if not 0 <= plan.checks <= costs.size:
        return Problem(f"{plan.checks} of {costs.size} poses checked: {plan.planner}", f"{plan}\n{told}")
    stands = [bool(np.isfinite(costs[:, row, col]).any()) for row, col in (start, goal)]
    if not all(stands):
        blocked = Status.GOAL_BLOCKED if stands[0] else Status.START_BLOCKED
        allowed = {blocked, Status.NO_PATH, *([Status.OK] if start == goal else [])}
        return None if plan.status in allowed else Problem(f"{plan.status} for {blocked}: {plan.planner}", told)
    scale = 255.0 * omega
    return problem_with_optimum(
        plan,
        pose_oracles.dijkstra_over_poses(costs, start, goal, scale),
        lambda path: problem_with_path(path, plan.headings_deg, costs, start, goal),
        lambda path: pose_oracles.path_cost_over_poses(costs, path, scale),
        exact=exact,
        epsilon=epsilon,
        told=told,
    )


def problem_with_path(
    path: list[tuple[int, int]],
    headings_deg: np.ndarray,
    costs: np.ndarray,
    start: tuple[int, int],
    goal: tuple[int, int],
) -> str:
    """What is wrong with a path and its headings; empty if nothing is.

    Each cell's heading is that of the step that leaves it, the last one's that of the step that reaches it; degrees
    in [0, 360), clockwise from north, which is up the rows, as if cells were square; none for a single cell.
    """
    if not path or path[0] != tuple(start) or path[-1] != tuple(goal):
        return "a path with other ends"
    if any(not (0 <= row < costs.shape[1] and 0 <= col < costs.shape[2]) for row, col in path):
        return "a path that leaves the map"
    if any(max(abs(r - i), abs(c - j)) != 1 for (r, c), (i, j) in zip(path[:-1], path[1:], strict=True)):
        return "a path with a leap"
    if not math.isfinite(pose_oracles.path_cost_over_poses(costs, path, 1.0)):
        return "a path through a pose that fails"
    if len(headings_deg) != (len(path) if len(path) > 1 else 0):
        return f"{len(headings_deg)} headings for {len(path)} cells"
    steps = pose_oracles.headings_of(path)
    wrong = len(path) > 1 and not np.allclose(headings_deg, [*steps, steps[-1]], atol=1e-3)
    return "headings that are not the steps'" if wrong else ""
