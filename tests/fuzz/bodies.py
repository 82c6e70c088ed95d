"""Robots with a body on elevations that change: poses beside a naive check, plans beside Dijkstra over all poses."""

import math
import random
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nnpp_edge.runtime import Planner, Status, Vehicle, pose_costs
from tests import pose_oracles
from tests.fuzz.commands import Problem
from tests.fuzz.elevations import sizes
from tests.fuzz.weights import EXACT, small_model

NAME = "bodies"
METHODS = ("astar", "astar", "corridor", "nnpp", "auto")
NEAR_A_LIMIT = 2e-5
"""Share of a limit by which a figure may miss it and still be on either side: heights are kept in float32."""
T_ROUNDED, T_ALIKE = 2.0 / pose_oracles.CODES, 2e-5
"""By how much T is rounded up at most, and how much it differs through float32 heights."""
Step = tuple[str, Any]


@dataclass(frozen=True)
class Case:
    """A map, a vehicle, and what is done with them."""

    dem: np.ndarray
    cell: tuple[float, float]
    vehicle: Vehicle
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


def generate(rng: random.Random, most_side: int = 22) -> Case:
    """A case of a few steps; the body measures one cell to seven, and fits on the map."""
    numbers = np.random.default_rng(rng.getrandbits(32))
    cell = rng.choice(((1.0, 1.0), (0.25, 0.25), (20.0, 20.0), (2.0, 1.7), (0.3, 0.5)))
    vehicle = draw_vehicle(rng, min(cell))
    least = math.ceil(max(vehicle.length_m, vehicle.width_m) / min(cell))
    rows, cols = (rng.randint(least, max(most_side, least)) for _ in range(2))
    if rng.random() < 0.8:
        rows, cols = max(rows, most_side // 2), max(cols, most_side // 2)
    dem = draw_heights(rng, numbers, rows, cols, vehicle)
    tiles = rng.choice(((4, 4), (8, 16), (32, 64), (16, 4)))
    omega = rng.choice((0.011, 0.011, 0.1, 0.0))
    steps = [_step(rng, numbers, dem, vehicle) for _ in range(rng.choice((1, 2, 4, 8)))]
    return Case(dem, cell, vehicle, omega, *tiles, rng.choice((2, 4, 8)), rng.choice((1, 200_000)), tuple(steps))


def draw_vehicle(rng: random.Random, cell: float) -> Vehicle:
    """A body of one cell to seven, of odd sizes: no cell lies on an edge of it."""
    size = rng.choice(((0.8, 2.0), (1.0, 3.0), (1.5, 4.0), (3.0, 7.0)))
    length, width = (cell * rng.uniform(*size) for _ in range(2))
    long, wide = (side * rng.uniform(0.02, 0.3) for side in (length, width))
    narrow = rng.random() < 0.6

    def perhaps(value: float) -> float | None:
        return value if rng.random() < 0.5 else None

    clearance = cell * 10.0 ** rng.uniform(-0.8, 0.0)
    return Vehicle(
        length_m=length,
        width_m=width,
        clearance_m=clearance,
        max_tilt_deg=rng.uniform(10.0, 60.0),
        max_pitch_deg=perhaps(rng.uniform(10.0, 60.0)),
        max_roll_deg=perhaps(rng.uniform(10.0, 60.0)),
        max_step_m=perhaps(clearance * rng.uniform(0.5, 3.0)),
        axles=rng.choice((2, 2, 3, 4)),
        wheelbase_m=(length - long) * rng.uniform(0.4, 0.99) if narrow else None,
        track_m=(width - wide) * rng.uniform(0.4, 0.99) if narrow else None,
        wheel_length_m=long,
        wheel_width_m=wide,
        unknown_passes=rng.random() < 0.3,
    )


def draw_heights(
    rng: random.Random, numbers: np.random.Generator, rows: int, cols: int, vehicle: Vehicle
) -> np.ndarray:
    """Slopes and hills that the body can take or not, with rocks, walls, cliffs and unknown cells."""
    row, col = np.mgrid[:rows, :cols]
    size = vehicle.clearance_m
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


def _step(rng: random.Random, numbers: np.random.Generator, dem: np.ndarray, vehicle: Vehicle) -> Step:
    rows, cols = dem.shape
    if rng.random() < 0.4:
        height, width = (min(rng.choice((1, 1, 3, 10)), most) for most in (rows, cols))
        row, col = rng.randrange(rows - height + 1), rng.randrange(cols - width + 1)
        patch = dem[row : row + height, col : col + width].astype(np.float64)
        patch += vehicle.clearance_m * rng.choice((0.0, 0.1, 2.0)) * numbers.normal(size=(height, width))
        patch[numbers.random(patch.shape) < rng.choice((0.0, 0.0, 0.3))] = np.nan
        return "update", (row, col, patch.astype(rng.choice((np.float32, np.float64))))
    anywhere = rng.random() < 0.1
    ends = rng.random(), rng.random()
    return "plan", (anywhere, ends, rng.choice(METHODS), rng.choice((math.inf, 0.0, 0.05)))


def check(case: Case, samples: Path | None = None) -> Problem | None:
    """Do all steps with a planner that checks poses where it looks and with one that checks all; compare them."""
    with sizes(case):
        return _check(case, samples)


def _check(case: Case, folder: Path | None) -> Problem | None:
    settings: dict[str, Any] = {"omega": case.omega, "ask_from": 0, "warn": False, "vehicle": case.vehicle}
    settings |= {"model": small_model(folder), "cell_width_m": case.cell[1]}
    dem = case.dem.copy()
    lazy, dense = (Planner.of_elevation(dem.copy(), case.cell[0], lazy=lazy, **settings) for lazy in (True, False))
    if problem := problem_with_poses(dem, case.cell, case.vehicle, repr(case)):
        return problem
    for number, (kind, value) in enumerate(case.steps):
        told = f"step {number}\n{case!r}"
        if kind == "update":
            row, col, patch = value
            dem[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
            for planner in (lazy, dense):
                planner.update_elevation(*value)
            continue
        anywhere, ends, method, epsilon = value
        costs = pose_costs(dem, case.cell[0], case.vehicle, cell_width_m=case.cell[1])
        start, goal = (_cell_of(share, costs, anywhere) for share in ends)
        ours, theirs = (
            planner.plan(start, goal, method=method, price="eq1", epsilon=epsilon) for planner in (lazy, dense)
        )
        if ours.status is not theirs.status or not math.isclose(ours.cost, theirs.cost, rel_tol=1e-6):
            return Problem(f"lazy is not dense: {method}", f"{ours}\n{theirs}\n{told}")
        exact = method == "astar" or epsilon == 0.0
        for plan in (ours, theirs):  # their bounds may differ: a pose that is not checked yet counts as free
            if problem := problem_with_plan(plan, costs, start, goal, case.omega, exact, epsilon, told):
                return problem
    return problem_with_poses(dem, case.cell, case.vehicle, repr(case))


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
    if more.size and (
        more.min() < -T_ALIKE - T_ROUNDED * (found[both].max() > 0.999) or more.max() > T_ROUNDED + T_ALIKE
    ):
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
    scale = 255.0 * omega
    optimum = pose_oracles.dijkstra_over_poses(costs, start, goal, scale)
    name, facts = str(plan.planner), f"{plan}\noptimum {optimum!r}\n{told}"
    if not 0 <= plan.checks <= costs.size:
        return Problem(f"{plan.checks} of {costs.size} poses checked: {name}", facts)
    stands = [bool(np.isfinite(costs[:, row, col]).any()) for row, col in (start, goal)]
    if not all(stands):
        blocked = Status.GOAL_BLOCKED if stands[0] else Status.START_BLOCKED
        allowed = {blocked, Status.NO_PATH, *([Status.OK] if start == goal else [])}
        return None if plan.status in allowed else Problem(f"{plan.status} for {blocked}: {name}", facts)
    if not math.isfinite(optimum):
        return None if plan.status is Status.NO_PATH else Problem(f"{plan.status} without a path: {name}", facts)
    if plan.status is not Status.OK:
        return Problem(f"{plan.status} where there is a path: {name}", facts)
    if wrong := problem_with_path(plan, costs, start, goal, scale):
        return Problem(f"{wrong}: {name}", facts)
    if plan.cost < optimum * (1.0 - EXACT):
        return Problem(f"below the optimum: {name}", facts)
    if exact and plan.cost > optimum * (1.0 + EXACT):
        return Problem(f"not the optimum: {name}", facts)
    if plan.lower_bound > optimum * (1.0 + EXACT):
        return Problem(f"its lower bound is above the optimum: {name}", facts)
    if math.isfinite(epsilon) and plan.cost > (1.0 + epsilon) * optimum * (1.0 + EXACT):
        return Problem(f"more than 1 + epsilon times the optimum: {name}", facts)
    return None


def problem_with_path(
    plan: Any,
    costs: np.ndarray,
    start: tuple[int, int],
    goal: tuple[int, int],
    scale: float,
) -> str:
    """What is wrong with a path, its cost and its headings; empty if nothing is."""
    path = [(int(row), int(col)) for row, col in plan.path]
    if not path or path[0] != tuple(start) or path[-1] != tuple(goal):
        return "a path with other ends"
    if any(not (0 <= row < costs.shape[1] and 0 <= col < costs.shape[2]) for row, col in path):
        return "a path that leaves the map"
    if any(max(abs(r - i), abs(c - j)) != 1 for (r, c), (i, j) in zip(path[:-1], path[1:], strict=True)):
        return "a path with a leap"
    cost = pose_oracles.path_cost_over_poses(costs, path, scale)
    if not math.isfinite(cost):
        return "a path through a pose that fails"
    if abs(cost - plan.cost) > 1e-5 * max(cost, 1.0):
        return "its cost is not its path's"
    return problem_with_headings(plan.headings_deg, path)


def problem_with_headings(headings_deg: np.ndarray, path: list[tuple[int, int]]) -> str:
    """Each cell's heading is that of the step that leaves it, the last one's that of the step that reaches it.

    Degrees in [0, 360), clockwise from north, which is up the rows, as if cells were square; none for a single cell.
    """
    if len(path) < 2:
        return "a heading without a step" if len(headings_deg) else ""
    if len(headings_deg) != len(path):
        return f"{len(headings_deg)} headings for {len(path)} cells"
    steps = pose_oracles.headings_of(path)
    return "" if np.allclose(headings_deg, [*steps, steps[-1]], atol=1e-3) else "headings that are not the steps'"
