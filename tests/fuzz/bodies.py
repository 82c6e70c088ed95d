"""Robots with a body on elevations that change: motions beside NumPy and dense sampling, plans
beside Dijkstra.
"""

import functools
import math
import random
from typing import Any

import numpy as np

from nnpp_edge.runtime import Planner, Status, Vehicle
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT, FAILS, MOST_CODE
from nnpp_edge.runtime.robots.body.poses import Poses, limits_of
from tests import pose_oracles
from tests.fuzz.cases import NOWHERE, Case, Place, Problem, problem_with_optimum
from tests.fuzz.elevations import draw_heights, draw_patch, draw_sizes, drive, sizes

METHODS = ("astar", "corridor", "auto", "dstar")
NEAR_A_LIMIT = 2e-5
"""Share of a limit by which a figure may miss it and still be on either side: heights are kept in
float32.
"""
T_ROUNDED = 2.0 / MOST_CODE
T_ALIKE = 5e-5
"""By how much T is rounded up at most, and how much it differs through float32 heights."""
SAMPLED = 12
"""Motions that are followed densely in a check."""


def generate(rng: random.Random, place: Place = NOWHERE, most_side: int = 22) -> Case:
    """A case of a few steps; the body measures one cell to seven, and fits on the map."""
    numbers = np.random.default_rng(rng.getrandbits(32))
    cell = rng.choice(((1.0, 1.0), (0.25, 0.25), (20.0, 20.0), (2.0, 1.7), (0.3, 0.5)))
    vehicle = draw_vehicle(rng, min(cell))
    least = math.ceil(max(vehicle.length_m, vehicle.width_m) / min(cell))
    rows, cols = (rng.randint(least, max(most_side, least)) for _ in range(2))
    if rng.random() < 0.8:
        rows = max(rows, most_side // 2)
        cols = max(cols, most_side // 2)
    dem = draw_heights(rng, numbers, rows, cols, vehicle.clearance_m)

    def step() -> tuple[str, Any]:
        if rng.random() < 0.4:
            return draw_patch(rng, numbers, dem, vehicle.clearance_m, most=10)
        ends = rng.random(), rng.random()
        return "plan", (
            rng.random() < 0.1,
            ends,
            rng.choice(METHODS[:3]),
            rng.choice((math.inf, 0.0, 0.05)),
        )

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
    clearance = cell * 10.0 ** rng.uniform(-0.8, 0.0)
    narrow = rng.random() < 0.6

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
        turn_cost_m_per_rad=rng.choice((None, None, 0.0, 0.3 * length, 20.0 * length)),
    )


def check(case: Case, place: Place = NOWHERE) -> Problem | None:
    """Do all steps with a planner that checks motions where it looks and with one that checks all;
    compare them.
    """
    with sizes(case):
        return _check(case, place)


def _check(case: Case, place: Place) -> Problem | None:
    settings: dict[str, Any] = {
        "omega": case.omega,
        "ask_from": 0,
        "warn": False,
        "vehicle": case.vehicle,
    }
    settings |= {"model": place.model, "cell_width_m": case.cell[1]}
    dem = case.dem.copy()
    lazy, dense = (
        Planner.of_elevation(dem.copy(), case.cell[0], lazy=lazy, **settings)
        for lazy in (True, False)
    )
    if problem := problem_with_motions(dense, dem, repr(case)):
        return problem

    def judged(anywhere: bool, ends: Any, method: str, epsilon: float, told: str) -> Problem | None:
        stands = (poses_of(dense).standing() < FAILS).any(0)
        cells = np.argwhere(stands | (anywhere or not stands.any()))
        start, goal = (tuple(cells[int(share * len(cells))].tolist()) for share in ends)
        plans = [each.plan(start, goal, method=method, epsilon=epsilon) for each in (lazy, dense)]
        if plans[0].status is not plans[1].status or not math.isclose(
            plans[0].cost, plans[1].cost, rel_tol=1e-6
        ):
            return Problem(f"lazy is not dense: {method}", f"{plans}\n{told}")
        given = (
            priced(dense, case.omega),
            stands,
            start,
            goal,
            method == "astar" or epsilon == 0.0,
            epsilon,
            told,
        )
        # their bounds may differ: a motion that is not checked yet counts as free
        return problem_with_plan(plans[0], *given) or problem_with_plan(plans[1], *given)

    if found := drive(case, dem, (lazy, dense), judged):
        return found
    fresh = Planner.of_elevation(dem.copy(), case.cell[0], lazy=False, **settings)
    ours = poses_of(lazy)
    alike = np.array_equal(poses_of(fresh).heights, poses_of(lazy).heights, equal_nan=True)
    ours.complete()
    kept = [poses_of(each).codes for each in (lazy, dense, fresh)]
    if not np.array_equal(kept[0], kept[1]) or (alike and not np.array_equal(kept[0], kept[2])):
        return Problem("after patches motions are others", repr(case))
    return problem_with_motions(dense, dem, repr(case))


def poses_of(planner: Planner) -> Poses:
    """A planner's; all checked."""
    planner.state.grid.robot.poses.complete()
    return planner.state.grid.robot.poses


def motions_on(poses: Poses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(8, H, W) each: codes of the legs along the axes, whether turns are possible, and codes of
    standing.
    """
    inside = np.s_[1:-1, 1:-1]
    rows, cols = poses.shape
    codes = poses.codes.reshape(rows + 2, cols + 2, -1)[inside].transpose(2, 0, 1)
    return codes[:AXIS_COUNT], codes[AXIS_COUNT : 2 * AXIS_COUNT] < FAILS, poses.standing()


def priced(planner: Planner, omega: float) -> pose_oracles.Motions:
    """A planner's motions as the oracle takes them."""
    poses = poses_of(planner)
    legs, turns, _ = motions_on(poses)
    weights = np.where(legs < FAILS, (legs - 1.0) / MOST_CODE, np.inf).transpose(1, 2, 0)
    return pose_oracles.priced(
        weights, turns.transpose(1, 2, 0), poses.vehicle, poses.sides_m, 255.0 * omega
    )


def problem_with_motions(planner: Planner, dem: np.ndarray, told: str = "") -> Problem | None:
    """What differs from the check in NumPy, but for what rounding decides; and where a motion
    breaks a limit.
    """
    poses = poses_of(planner)
    cells = np.argwhere(np.ones(poses.shape, bool))
    found = motions_on(poses)
    for motion in range(3 * AXIS_COUNT):
        kind, axis = divmod(motion, AXIS_COUNT)
        codes, t, near = codes_in_numpy(poses, motion, cells)
        ours = found[kind][axis].ravel()
        same = (
            np.where(codes >= FAILS, ours == codes, ours < FAILS)
            if kind != 1
            else ours == (codes < FAILS)
        )
        if (differ := ~same & ~near).any():
            at = int(np.argmax(differ))
            return Problem(
                f"a code of motions of kind {kind} is another",
                f"{motion} {cells[at]}: {ours[at]} for {codes[at]}\n{told}",
            )
        both = (codes < FAILS) & (ours < FAILS) if kind != 1 else np.zeros(len(codes), bool)
        more = (ours[both] - 1.0) / MOST_CODE - t[both]
        if both.any() and (
            more.min() < -T_ALIKE - T_ROUNDED * (t.max() > 0.999)
            or more.max() > T_ROUNDED + T_ALIKE
        ):
            return Problem(
                "T of a motion is another", f"{motion}: {more.min()} to {more.max()} more\n{told}"
            )
    rng = np.random.default_rng(len(told))
    passes = np.argwhere(np.concatenate((found[0] < FAILS, found[1])))
    for motion, row, col in rng.permutation(passes)[:SAMPLED].tolist():
        places, headings = dense_places(motion, (row, col), poses.sides_m)
        if (
            broken := pose_oracles.breaks_at(dem, poses.sides_m, poses.vehicle, places, headings)
        ) is not None:
            return Problem(
                f"a motion that passes breaks {broken.limit}",
                f"{motion} {(row, col)}: {broken}\n{told}",
            )
    return None


def dense_places(
    motion: int, cell: tuple[int, int], sides: tuple[float, float], count: int = 15
) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 2) and headings (N,) along a leg, or a turn to the next direction, from a cell."""
    shares = np.linspace(0.0, 1.0, count)[:, None]
    ways = [*pose_oracles.AXES, (-1, 0)]
    angles = [math.atan2(col * sides[1], row * sides[0]) for row, col in ways]
    kind, axis = divmod(motion, AXIS_COUNT)
    if kind == 0:
        return cell + shares * ways[axis], np.full(count, angles[axis])
    return cell + 0.0 * shares, (angles[axis] + shares * (angles[axis + 1] - angles[axis]))[:, 0]


def codes_in_numpy(
    poses: Poses, motion: int, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N,) code of the worst pose of a motion from each cell or 0, mean T, and whether rounding may
    decide.
    """
    limits = limits_of(poses.vehicle, poses.weights).astype(np.float64)[:, None]
    first, last = poses.motions.poses_of[motion : motion + 2]
    worst = np.zeros(len(cells), int)
    total = 0.0
    near = np.zeros(len(cells), bool)
    for pose in range(first, last):
        slope, *others = figures_in_numpy(poses, cells, pose)
        values = np.stack((np.arctan(slope), *others))
        unknown = ~np.isfinite(slope + values[3] + values[4])
        refused = np.concatenate((unknown[None], ~(values <= limits[1:6])))
        code = np.where(refused.any(0), FAILS + refused.argmax(0), 0)
        worst = np.maximum(worst, code)
        near |= (np.abs(values - limits[1:6]) <= NEAR_A_LIMIT * limits[1:6]).any(0) & ~unknown
        total = total + (limits[6:] * (values / limits[1:6])[[0, 4, 3]]).sum(0)
    return worst, total / (last - first), near


def figures_in_numpy(poses: Poses, cells: np.ndarray, pose: int) -> np.ndarray:
    """(5, N) bounds of slope, pitch, roll (as slopes), step, rise of a pose of N cells
    (docs/vehicle-check.md).
    """
    tables = poses.motions
    vehicle = poses.vehicle
    ground = poses.heights.astype(np.float64)
    margin = (poses.heights.shape[0] - poses.shape[0]) // 2
    base = cells + margin

    def at(offsets: np.ndarray) -> np.ndarray:
        row = np.clip(base[:, None, 0] + offsets[:, 0], 0, ground.shape[0] - 1)
        col = np.clip(base[:, None, 1] + offsets[:, 1], 0, ground.shape[1] - 1)
        heights: np.ndarray = ground[row, col]
        return heights

    with np.errstate(invalid="ignore"):
        fitted = slice(*tables.fit_of[pose : pose + 2])
        slopes = at(tables.fit_offsets[fitted]) @ tables.fit_shares[fitted].astype(np.float64)
        slopes = np.where(np.isfinite(slopes).all(1, keepdims=True), slopes, 0.0)
        wheels = len(vehicle.wheels_m)
        gradients = tables.gradients.astype(np.float64)
        ranges: list[tuple[np.ndarray, np.ndarray]] = []
        parts: list[tuple[np.ndarray, np.ndarray, slice]] = []
        for group in range(*tables.groups_of[pose : pose + 2]):
            first, fours, lines, end, cell = tables.groups[group].tolist()
            counts = np.repeat((4, 2, 1), (fours - first, lines - fours, end - lines))
            last = cell + counts.sum()
            heights = at(tables.offsets[cell:last]) * tables.shares[cell:last]
            heights = np.add.reduceat(heights, np.cumsum(counts) - counts, axis=1)
            samples = slice(first, end)
            places = np.stack((tables.ahead[samples], tables.left[samples]), 1).astype(np.float64)
            departs = heights - slopes @ places.T
            if len(ranges) < wheels:
                ranges.append((np.fmin.reduce(departs, 1), np.fmax.reduce(departs, 1)))
            else:
                parts.append((departs, places, slice(*tables.raised_of[group : group + 2])))
        low, high = np.array(ranges).transpose(1, 0, 2)
        if not vehicle.unknown_passes:
            high = np.where(np.isnan(high), np.inf, high)
        middle = 0.5 * (low + high)
        half = 0.5 * (high - low)
        along, across = gradients[1:3] @ middle
        more_along, more_across = gradients[3:5] @ half
        planes = []
        for departs, places, raised in parts:
            touched = low.copy()
            touched[tables.raised[raised]] = high[tables.raised[raised]]
            level, ahead, left = gradients[:3] @ touched
            plane = level[:, None] + np.outer(ahead, places[:, 0]) + np.outer(left, places[:, 1])
            planes.append(np.fmax.reduce(departs - plane, 1))
        rise = np.fmax.reduce(planes)
        carried = tables.carried.astype(np.float64)
        sway, aside, turn = tables.swept[pose].astype(np.float64)
        steep = np.stack((np.abs(along) + more_along, np.abs(across) + more_across))
        by = carried[:6].reshape(3, 2) @ steep
        steep = steep + by[:2]
        more_along = more_along + by[0]
        more_across = more_across + by[1]
        up = np.maximum(rise + by[2] + sway * steep[0] + aside * steep[1], 0.0)
        step = 2.0 * half.max(0) + carried[6:] @ steep
        most = np.stack(
            (np.abs(slopes[:, 0] + along) + more_along, np.abs(slopes[:, 1] + across) + more_across)
        )
        slope = np.hypot(*(most + turn * steep[::-1]))
        turned = most + turn * (np.abs(slopes.T[::-1]) + steep[::-1])
        pitch, roll = np.minimum(turned, slope)
        unknown = ~np.isfinite(slope + step + rise)
        figures = np.stack((slope, pitch, roll, step, up))
        return np.where(unknown & ~np.isfinite(figures), np.nan, figures)


def problem_with_plan(
    plan: Any,
    priced: pose_oracles.Motions,
    stands: np.ndarray,
    start: tuple[int, int],
    goal: tuple[int, int],
    exact: bool,
    epsilon: float = math.inf,
    told: str = "",
) -> Problem | None:
    """What is wrong with an answer where motions cost so much, and the body stands on cells
    `stands`.
    """
    if not (stands[start] and stands[goal]):
        blocked = Status.GOAL_BLOCKED if stands[start] else Status.START_BLOCKED
        allowed = {blocked, Status.NO_PATH, *([Status.OK] if start == goal else [])}
        return (
            None
            if plan.status in allowed
            else Problem(f"{plan.status} for {blocked}: {plan.planner}", told)
        )
    return problem_with_optimum(
        plan,
        float(pose_oracles.costs_to_cells(priced, start)[goal]),
        lambda path: problem_with_path(path, plan.headings_deg, priced, start, goal),
        functools.partial(pose_oracles.path_cost, priced),
        exact=exact,
        epsilon=epsilon,
        told=told,
    )


def problem_with_path(
    path: list[tuple[int, int]],
    headings_deg: np.ndarray,
    priced: pose_oracles.Motions,
    start: tuple[int, int],
    goal: tuple[int, int],
) -> str:
    """What is wrong with a path and its headings; empty if nothing is.

    Each cell's heading is that of the leg that leaves it, the last one's that of the leg that
    reaches it; degrees in [0, 360), clockwise from north, which is up the rows, as if cells were
    square; none for a single cell.
    """
    if not path or path[0] != tuple(start) or path[-1] != tuple(goal):
        return "a path with other ends"
    if not math.isfinite(pose_oracles.path_cost(priced, path)):
        return "a path with a leap, or through a motion that fails"
    if len(headings_deg) != (len(path) if len(path) > 1 else 0):
        return f"{len(headings_deg)} headings for {len(path)} cells"
    legs = pose_oracles.headings_of(path)
    wrong = len(path) > 1 and not np.allclose(headings_deg, [*legs, legs[-1]], atol=1e-3)
    return "headings that are not the legs'" if wrong else ""
