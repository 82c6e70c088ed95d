"""Robots with a body on odd ground: their motions beside NumPy and dense sampling."""

import math
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime import Vehicle
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT, FAILS, MOST_CODE
from tests import pose_oracles
from tests.fuzz.cases import Finding
from tests.strategies import odd_heights

NEAR_A_LIMIT = 2e-5
"""Share of a limit by which a figure may miss it and still be on either side: heights are kept in
float32.
"""
T_ROUNDED = 2.0 / MOST_CODE
T_ALIKE = 5e-5
"""By how much T is rounded up at most, and how much it differs through float32 heights."""
SAMPLED = 12
"""Motions that are followed densely in a check."""


class Body(NamedTuple):
    """A vehicle, heights and the sides of a cell."""

    dem: np.ndarray
    cell: tuple[float, float]
    vehicle: Vehicle


def generate(rng, most_side=22):
    """A body of one cell to seven, which fits on its map."""
    cell = rng.choice(((1.0, 1.0), (0.25, 0.25), (20.0, 20.0), (2.0, 1.7), (0.3, 0.5)))
    vehicle = draw_vehicle(rng, min(cell))
    least = math.ceil(max(vehicle.length_m, vehicle.width_m) / min(cell))
    least = rng.choice((least, *[max(least, most_side // 2)] * 4))
    shape = tuple(rng.randint(least, max(most_side, least)) for _ in range(2))
    numbers = np.random.default_rng(rng.getrandbits(32))
    few = (0.005, 0.02, 0.05)
    return Body(odd_heights(numbers, shape, vehicle.clearance_m, few), cell, vehicle)


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
            return Finding("a code of a motion is another", f"{where}\n{told}")
        both = passes & (codes < FAILS) & (not is_turn)
        more = (ours[both] - 1.0) / MOST_CODE - t[both]
        least = -T_ALIKE - T_ROUNDED * (t.max() > 0.999)
        if not ((least <= more) & (more <= T_ROUNDED + T_ALIKE)).all():
            where = f"{motion}: {more.min()} to {more.max()} more"
            return Finding("T of a motion is another", f"{where}\n{told}")
    rng = np.random.default_rng(len(told))
    passes = np.argwhere(found[: 2 * AXIS_COUNT] < FAILS)
    for motion, row, col in rng.permutation(passes)[:SAMPLED].tolist():
        places = dense_places(motion, (row, col), poses.sides_m)
        if broken := pose_oracles.breaks_at(dem, poses.sides_m, poses.vehicle, *places):
            where = f"{motion} {(row, col)}: {broken}"
            return Finding(f"a motion that passes breaks {broken.limit}", f"{where}\n{told}")
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
    limits = poses.limits.astype(np.float64)[:, None]
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
