"""Robots with a body on elevations that change: motions beside NumPy and dense sampling, plans
beside Dijkstra.
"""

import functools
import math

import numpy as np

from nnpp_edge.runtime import Status, Vehicle
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT, FAILS, MOST_CODE
from nnpp_edge.runtime.robots.body.poses import limits_of
from tests import pose_oracles
from tests.fuzz import cases
from tests.fuzz.cases import NOWHERE, Case, Problem
from tests.fuzz.elevations import draw_heights, draw_sizes, draw_steps, drive

NEAR_A_LIMIT = 2e-5
"""Share of a limit by which a figure may miss it and still be on either side: heights are kept in
float32.
"""
T_ROUNDED = 2.0 / MOST_CODE
T_ALIKE = 5e-5
"""By how much T is rounded up at most, and how much it differs through float32 heights."""
SAMPLED = 12
"""Motions that are followed densely in a check."""


def generate(rng, place=NOWHERE, most_side=22):
    """A case of a few steps; the body measures one cell to seven, and fits on the map."""
    numbers = np.random.default_rng(rng.getrandbits(32))
    cell = rng.choice(((1.0, 1.0), (0.25, 0.25), (20.0, 20.0), (2.0, 1.7), (0.3, 0.5)))
    vehicle = draw_vehicle(rng, min(cell))
    least = math.ceil(max(vehicle.length_m, vehicle.width_m) / min(cell))
    least = rng.choice((least, *[max(least, most_side // 2)] * 4))
    rows, cols = (rng.randint(least, max(most_side, least)) for _ in range(2))
    dem = draw_heights(rng, numbers, rows, cols, vehicle.clearance_m)
    size = vehicle.clearance_m
    return Case(
        dem=dem,
        cell=cell,
        vehicle=vehicle,
        limits=None,
        corner_cutting=True,
        omega=rng.choice((0.011, 0.011, 0.1, 0.0)),
        sizes=draw_sizes(rng),
        steps=draw_steps(rng, numbers, dem, size, (1, 2, 4, 8), ("astar", "corridor", "auto")),
    )


def draw_vehicle(rng, cell):
    """A body of one cell to seven, of odd sizes: no cell lies on an edge of it."""
    size = rng.choice(((0.8, 2.0), (1.0, 3.0), (1.5, 4.0), (3.0, 7.0)))
    length, width = (cell * rng.uniform(*size) for _ in range(2))
    long, wide = (side * rng.uniform(0.02, 0.3) for side in (length, width))
    clearance = cell * 10.0 ** rng.uniform(-0.8, 0.0)
    narrow = rng.random() < 0.6

    def perhaps(least, most):
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


def check(case, place=NOWHERE):
    """Do all steps with a planner that checks motions where it looks and with one that checks all;
    compare them.
    """
    return drive(case, place, _judged, _compared)


def _judged(case, dem, planners, ends, method, epsilon, told):
    stands = (poses_of(planners[1]).standing() < FAILS).any(0)
    anywhere = ends[0] < 0.1 or not stands.any()
    cells = np.argwhere(stands | anywhere)
    start, goal = (tuple(cells[int(share * len(cells))].tolist()) for share in ends)
    plans = [each.plan(start, goal, method=method, epsilon=epsilon) for each in planners]
    alike = math.isclose(plans[0].cost, plans[1].cost, rel_tol=1e-6)
    if plans[0].status is not plans[1].status or not alike:
        return Problem(f"lazy is not dense: {method}", f"{plans}\n{told}")
    motions = priced(planners[1], case.omega)
    exact = method == "astar" or epsilon == 0.0
    given = motions, stands, start, goal, exact, epsilon, told
    # their bounds may differ: a motion that is not checked yet counts as free
    return problem_with_plan(plans[0], *given) or problem_with_plan(plans[1], *given)


def _compared(case, dem, lazy, dense, fresh):
    like_fresh = np.array_equal(poses_of(fresh).heights, poses_of(dense).heights, equal_nan=True)
    others = [lazy, fresh] if like_fresh else [lazy]
    codes = poses_of(dense).codes
    if not all(np.array_equal(poses_of(each).codes, codes) for each in others):
        return Problem("after patches motions are others", repr(case))
    return problem_with_motions(dense, dem, repr(case))


def poses_of(planner):
    """A planner's; all checked."""
    planner.state.grid.robot.moves.poses.complete()
    return planner.state.grid.robot.moves.poses


def motions_on(poses):
    """(24, H, W) codes of the legs along the axes, of the turns from each to the next, of which
    only counts whether they pass, and of standing.
    """
    rows, cols = poses.shape
    codes = poses.codes.reshape(rows + 2, cols + 2, -1)[1:-1, 1:-1].transpose(2, 0, 1)
    return np.concatenate((codes[: 2 * AXIS_COUNT], poses.standing()))


def priced(planner, omega):
    """A planner's motions as the oracle takes them."""
    poses = poses_of(planner)
    legs, turns, _ = np.split(motions_on(poses).transpose(1, 2, 0), 3, axis=2)
    weights = np.where(legs < FAILS, (legs - 1.0) / MOST_CODE, np.inf)
    scale = 255.0 * omega
    return pose_oracles.priced(weights, turns < FAILS, poses.vehicle, poses.sides_m, scale)


def problem_with_motions(planner, dem, told=""):
    """What differs from the check in NumPy, but for what rounding decides; and where a motion
    breaks a limit.
    """
    poses = poses_of(planner)
    found = motions_on(poses)
    for motion, ours in enumerate(found.reshape(len(found), -1)):
        codes, t, near = codes_in_numpy(poses, motion)
        is_turn = motion // AXIS_COUNT == 1
        passes = ours < FAILS
        differ = (passes != (codes < FAILS)) | ~(passes | is_turn | (ours == codes))
        if (differ & ~near).any():
            at = int(np.argmax(differ & ~near))
            where = f"{motion} at {at}: {ours[at]} for {codes[at]}"
            return Problem("a code of a motion is another", f"{where}\n{told}")
        both = passes & (codes < FAILS) & (not is_turn)
        more = (ours[both] - 1.0) / MOST_CODE - t[both]
        least = -T_ALIKE - T_ROUNDED * (t.max() > 0.999)
        if not ((least <= more) & (more <= T_ROUNDED + T_ALIKE)).all():
            where = f"{motion}: {more.min()} to {more.max()} more"
            return Problem("T of a motion is another", f"{where}\n{told}")
    rng = np.random.default_rng(len(told))
    passes = np.argwhere(found[: 2 * AXIS_COUNT] < FAILS)
    for motion, row, col in rng.permutation(passes)[:SAMPLED].tolist():
        places = dense_places(motion, (row, col), poses.sides_m)
        if broken := pose_oracles.breaks_at(dem, poses.sides_m, poses.vehicle, *places):
            where = f"{motion} {(row, col)}: {broken}"
            return Problem(f"a motion that passes breaks {broken.limit}", f"{where}\n{told}")
    return None


def dense_places(motion, cell, sides, count=15):
    """Places (N, 2) and headings (N,) along a leg, or a turn to the next direction, from a cell."""
    shares = np.linspace(0.0, 1.0, count)[:, None]
    ways = np.array((*pose_oracles.AXES, (-1, 0)))
    angles = np.arctan2(ways[:, 1] * sides[1], ways[:, 0] * sides[0])
    kind, axis = divmod(motion, AXIS_COUNT)
    turn = kind * (angles[axis + 1] - angles[axis])
    return cell + shares * ways[axis] * (1 - kind), angles[axis] + shares[:, 0] * turn


def codes_in_numpy(poses, motion):
    """(N,) code of the worst pose of a motion from each cell or 0, mean T, and whether rounding may
    decide.
    """
    limits = limits_of(poses.vehicle, poses.weights).astype(np.float64)[:, None]
    worst = 0
    total = 0.0
    near = False
    all_poses = range(*poses.motions.poses_of[motion : motion + 2])
    for pose in all_poses:
        slope, *others = figures_in_numpy(poses, pose)
        values = np.stack((np.arctan(slope), *others))
        unknown = ~np.isfinite(slope + values[3] + values[4])
        refused = np.concatenate((unknown[None], ~(values <= limits[1:6])))
        worst = np.maximum(worst, np.where(refused.any(0), FAILS + refused.argmax(0), 0))
        near |= (np.abs(values - limits[1:6]) <= NEAR_A_LIMIT * limits[1:6]).any(0) & ~unknown
        total = total + (limits[6:] * (values / limits[1:6])[[0, 4, 3]]).sum(0)
    return worst, total / len(all_poses), near


def figures_in_numpy(poses, pose):
    """(5, N) bounds of slope, pitch, roll (as slopes), step, rise of a pose of all N cells
    (docs/vehicle-check.md).
    """
    tables = poses.motions
    vehicle = poses.vehicle
    ground = poses.heights.astype(np.float64)
    margin = (poses.heights.shape[0] - poses.shape[0]) // 2
    base = np.argwhere(np.ones(poses.shape, bool)) + margin

    def at(offsets):
        cells = np.clip(base[:, None] + offsets[:, :2], 0, np.array(ground.shape) - 1)
        return ground[cells[..., 0], cells[..., 1]]

    with np.errstate(invalid="ignore"):
        fitted = slice(*tables.fit_of[pose : pose + 2])
        slopes = at(tables.fit_offsets[fitted]) @ tables.fit_shares[fitted].astype(np.float64)
        slopes = np.where(np.isfinite(slopes).all(1, keepdims=True), slopes, 0.0)
        ranges = []
        parts = []
        for group in range(*tables.groups_of[pose : pose + 2]):
            first, fours, lines, end, cell = tables.groups[group].tolist()
            counts = np.repeat((4, 2, 1), (fours - first, lines - fours, end - lines))
            last = cell + counts.sum()
            heights = at(tables.offsets[cell:last]) * tables.shares[cell:last]
            heights = np.add.reduceat(heights, np.cumsum(counts) - counts, axis=1)
            samples = slice(first, end)
            places = np.stack((tables.ahead[samples], tables.left[samples]), 1).astype(np.float64)
            departs = heights - slopes @ places.T
            if len(ranges) < len(vehicle.wheels_m):
                ranges.append((np.fmin.reduce(departs, 1), np.fmax.reduce(departs, 1)))
            else:
                parts.append((departs, places, slice(*tables.raised_of[group : group + 2])))
        low, high = np.array(ranges).transpose(1, 0, 2)
        if not vehicle.unknown_passes:
            high = np.where(np.isnan(high), np.inf, high)
        half = 0.5 * (high - low)
        gradients = tables.gradients.astype(np.float64)
        tilts = gradients[1:3] @ (0.5 * (low + high))  # along and across
        more = gradients[3:5] @ half
        planes = []
        for departs, places, raised in parts:
            touched = low.copy()
            touched[tables.raised[raised]] = high[tables.raised[raised]]
            level, *tilted = gradients[:3] @ touched
            plane = level[:, None] + np.transpose(tilted) @ places.T
            planes.append(np.fmax.reduce(departs - plane, 1))
        carried = tables.carried.astype(np.float64)
        sway, aside, turn = tables.swept[pose].astype(np.float64)
        steep = np.abs(tilts) + more
        by = carried[:6].reshape(3, 2) @ steep
        steep = steep + by[:2]
        up = np.fmax.reduce(planes) + by[2] + sway * steep[0] + aside * steep[1]
        step = 2.0 * half.max(0) + carried[6:] @ steep
        most = np.abs(slopes.T + tilts) + more + by[:2]
        slope = np.hypot(*(most + turn * steep[::-1]))
        turned = most + turn * (np.abs(slopes.T[::-1]) + steep[::-1])
        figures = np.stack((slope, *np.minimum(turned, slope), step, np.maximum(up, 0.0)))
        unknown = ~np.isfinite(slope + step + up)
        return np.where(unknown & ~np.isfinite(figures), np.nan, figures)


def problem_with_plan(plan, priced, stands, start, goal, exact, epsilon=math.inf, told=""):
    """What is wrong with an answer where motions cost so much, and the body stands on cells
    `stands`.
    """
    return cases.problem_with_plan(
        plan,
        stands,
        (start, goal),
        lambda start, goal: pose_oracles.costs_to_cells(priced, start)[goal],
        lambda path: problem_with_path(path, plan.headings_deg, priced, start, goal),
        functools.partial(pose_oracles.path_cost, priced),
        exact=exact,
        epsilon=epsilon,
        told=told,
        also=[Status.NO_PATH, *[Status.OK] * (start == goal)],
    )


def problem_with_path(
    path,
    headings_deg,
    priced,
    start,
    goal,
):
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
