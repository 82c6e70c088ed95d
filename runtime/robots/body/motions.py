"""The poses that a motion of a vehicle's body is checked by, and the tables by which the check
samples the ground.

A motion is a straight leg from a cell to another, a turn on the spot, or an arc
(`robots.body.primitives`). Each of its poses stands for the body's places up to `sweep_m` before
and behind it, and for headings up to `turn_rad` to both sides: together they leave nothing out. The
ground is sampled at the corners of the boxes that parts of a rectangle fit into
(docs/vehicle-check.md).
"""

import functools
import itertools
import math
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Floats, Int64
from nnpp_edge.runtime.cells import Sides
from nnpp_edge.runtime.kernels.lattice import LEG_COLS, LEG_ROWS
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT
from nnpp_edge.runtime.kernels.records import PoseTables
from nnpp_edge.runtime.robots.body.primitives import curve, heading_rad, turn_rad
from nnpp_edge.runtime.terrain.vehicle import Vehicle

LEGS = tuple(zip(LEG_ROWS, LEG_COLS, strict=True))
"""(row, col) of the legs, by rising angle from (1, 0) towards (0, 1)."""
AXIS_LEGS = LEGS[:AXIS_COUNT]
"""Directions 8 to 15 are their reverses."""
LEG_SPACING = 0.095, 0.19
"""Of the body's length: from one pose of a leg to the next, at most, on cells of a third of the
body and of a sixth. Twice as much takes 0.6 of the checks, but paths among rocks cost 1.1 % more
(docs/decisions/bodies.md)."""
TURN_POSES = 2
"""Of a turn from one direction to the next."""
SNAPPED = 0.02
"""Boxes are widened to the next row or column of middles where it lies nearer than this share of
the body's length: where cells are small beside the body, nearly all samples are cells, which are
read faster than means of four."""
_ROUNDING = 1e-9
_CORNERS = np.array(((-1, -1), (-1, 1), (1, 1), (1, -1)))
"""(ahead, left) of a rectangle about a middle, in times of its half sides."""


class MotionPose(NamedTuple):
    """A pose of a motion, and what it stands for."""

    row: float
    col: float
    """Of the body's middle, in cells from the cell at which the motion begins."""
    down: float
    right: float
    """Its heading, of length 1."""
    sweep_m: float = 0.0
    turn_rad: float = 0.0


def leg_poses(direction: int, sides_m: Sides, length_m: float) -> list[MotionPose]:
    """Of a leg from a cell along an axis, or its reverse, of a body of this length."""
    row, col = LEGS[direction]
    down = row * sides_m[0]
    right = col * sides_m[1]
    metres = math.hypot(down, right)
    count = _poses_in(metres, sides_m, length_m)
    shares = ((2 * k + 1) / (2 * count) for k in range(count))
    sweep_m = metres / (2 * count)
    return [
        MotionPose(share * row, share * col, down / metres, right / metres, sweep_m)
        for share in shares
    ]


def _poses_in(metres: float, sides_m: Sides, length_m: float) -> int:
    """Number of poses on so long a leg or arc, by `LEG_SPACING`."""
    share = float(np.clip(length_m / (32.0 * max(sides_m)), *LEG_SPACING))
    return math.ceil(metres / (share * length_m))


def turn_poses(direction: int, sides_m: Sides) -> list[MotionPose]:
    """Of a turn on the spot from one direction to the next."""
    first = heading_rad(direction, sides_m)
    half = turn_rad(direction, sides_m) / (2 * TURN_POSES)
    middles = (first + (2 * k + 1) * half for k in range(TURN_POSES))
    return [MotionPose(0.0, 0.0, math.cos(at), math.sin(at), 0.0, half) for at in middles]


def arc_poses(direction: int, sides_m: Sides, radius_m: float, length_m: float) -> list[MotionPose]:
    """Of an arc from a direction to the next, of a body of this length."""
    first = heading_rad(direction, sides_m)
    down = math.cos(first)
    right = math.sin(first)
    bend = curve(direction, sides_m, radius_m)
    count = _poses_in(bend.length_m, sides_m, length_m)
    half = bend.length_m / (2 * count)
    poses = []
    for n in range(count):
        at = (2 * n + 1) * half
        ahead, left, turned = bend.at(at)
        row = (down * ahead - right * left) / sides_m[0]
        col = (right * ahead + down * left) / sides_m[1]
        heading = first + turned
        bent = bend.before_m < at + half and at - half < bend.length_m - bend.after_m
        turn = half / bend.radius_m if bent else 0.0
        poses.append(MotionPose(row, col, math.cos(heading), math.sin(heading), half, turn))
    return poses


@functools.lru_cache(maxsize=16)
def all_motions(vehicle: Vehicle, sides_m: Sides) -> PoseTables:
    """Tables of the legs along the axes, the turns from one direction to the next, the arcs from
    each direction, if the vehicle drives any, and of standing along each axis.
    """
    axes = range(AXIS_COUNT)
    legs = [leg_poses(k, sides_m, vehicle.length_m) for k in axes]
    turns = [turn_poses(k, sides_m) for k in axes]
    arcs = []
    if (radius := vehicle.turning_radius_m) is not None:
        arcs = [arc_poses(k, sides_m, radius, vehicle.length_m) for k in range(len(LEGS))]
    angles = [heading_rad(k, sides_m) for k in axes]
    standing = [[MotionPose(0.0, 0.0, math.cos(angle), math.sin(angle))] for angle in angles]
    return motions_of(vehicle, sides_m, legs + turns + arcs + standing)


def motions_of(vehicle: Vehicle, sides_m: Sides, motions: list[list[MotionPose]]) -> PoseTables:
    """Tables of motions of a vehicle on cells of these sides, whose `offsets` and `fit_offsets` are
    still (row, col) from the motion's cell, see `by_offsets`.

    Each motion has poses, each pose groups of samples, each sample cells. A group is what lies
    under a wheel, or under a part of the belly over which the same wheels' heights lower the plane.
    Its samples stand in the order of how many cells each is a mean of: four, two, one.
    """
    wheels = vehicle.wheels_m
    contact = 0.5 * np.array(vehicle.contact_m)
    body = 0.5 * np.array((vehicle.length_m, vehicle.width_m))
    # by which the wheels' heights make the plane's height at the middle, and its slopes
    fit: Floats = np.linalg.pinv(np.column_stack((np.ones(len(wheels)), wheels)))
    poses = np.concatenate([np.reshape(each, (-1, len(MotionPose._fields))) for each in motions])
    offsets = poses[:, :2]
    down, right = poses[:, 2:4].T
    # (P, 2, 2) what a metre ahead, and one to the left, lead down and right; rows go down
    frames = np.stack((down, right, -right, down), 1).reshape(-1, 2, 2)
    sweep, turn = poses[:, 4:].T
    snapped = math.inf if vehicle.unknown_passes else SNAPPED * vehicle.length_m

    def swept(far: Floats) -> Floats:
        """(P, 2) by how much points so far from a body's middle (ahead, aside) lie elsewhere."""
        ahead = sweep + far[1] * turn + 0.5 * far[0] * turn**2
        by_sweep = 0.5 * sweep * turn
        aside = by_sweep + far[0] * turn + 0.5 * far[1] * turn**2
        return np.stack((ahead, aside), 1)

    under = []
    for middle, half in (*((wheel, contact) for wheel in wheels), (np.zeros(2), body)):
        areas = half + swept(np.abs(middle) + half)
        under.append(_samples(middle, areas, frames, offsets, sides_m, snapped))
    groups: list[GroundSamples] = []
    groups_of = [0]
    raised: list[Int64] = []
    for *under_wheels, belly in zip(*under, strict=True):
        groups += under_wheels
        raised += [np.empty(0, np.int64)] * len(under_wheels)
        weights = np.column_stack((np.ones(len(belly.places)), belly.places)) @ fit
        lowers = weights < -_ROUNDING
        for pattern in np.unique(lowers, axis=0):
            groups.append(belly.of((lowers == pattern).all(1)))
            raised.append(np.flatnonzero(pattern))
        groups_of.append(len(groups))
    sizes = np.array([[(group.counts == many).sum() for many in (4, 2, 1)] for group in groups])
    ends = np.cumsum(sizes).reshape(-1, 3)
    begins = ends[:, :1] - sizes[:, :1]
    samples = np.column_stack((begins, ends))
    cells_in = np.cumsum([0, *(sizes @ (4, 2, 1))])
    cells = np.concatenate([group.cells for group in groups])
    places = np.concatenate([group.places for group in groups])
    ahead, left = places.T.astype(np.float32, "C")
    fitted = [
        _fit_cells(wheels @ frame / sides_m + offset, fit)
        for frame, offset in zip(frames, offsets, strict=True)
    ]
    fit_cells = np.concatenate(fitted)
    absolute = np.abs(fit)
    corners = np.column_stack((np.ones(4), _CORNERS * body))
    outermost = np.abs(corners @ fit).sum(1).max()
    by_slope = np.outer((absolute[1].sum(), absolute[2].sum(), outermost), contact).reshape(-1)
    return PoseTables(
        poses_of=np.cumsum([0, *map(len, motions)]),
        groups_of=np.array(groups_of),
        groups=np.column_stack((np.pad(samples, ((0, 1), (0, 0))), cells_in)),
        ahead=ahead,
        left=left,
        offsets=cells[:, :2].astype(np.int64),
        shares=cells[:, 2].astype(np.float32),
        fit_of=np.cumsum([0, *map(len, fitted)]),
        fit_offsets=fit_cells[:, :2].astype(np.int64),
        fit_shares=np.ascontiguousarray(fit_cells[:, 2:], np.float32),
        raised_of=np.cumsum([0, *map(len, raised)]),
        raised=np.concatenate(raised),
        swept=np.column_stack((swept(body), turn)).astype(np.float32),
        gradients=np.ascontiguousarray(np.concatenate((fit, absolute[1:])), np.float32),
        carried=np.concatenate((by_slope, 2.0 * contact)).astype(np.float32),
    )


def by_offsets(tables: PoseTables, width: int) -> PoseTables:
    """Tables as kernels take them, for heights that lie so many to a row."""
    place = (width, 1)
    offsets = tables.offsets @ place
    return tables._replace(offsets=offsets, fit_offsets=tables.fit_offsets @ place)


class GroundSamples(NamedTuple):
    """Samples of the ground under a rectangle."""

    places: Floats
    """(S, 2) metres ahead of the body's middle and to the left of it."""
    counts: Int64
    """(S,) cells that each is a mean of: four, two, one, in that order."""
    cells: Floats
    """(C, 3) row and column from the motion's cell, and share, of each sample's cells."""

    def of(self, chosen: Bool) -> "GroundSamples":
        """Some of them."""
        cells = self.cells[np.repeat(chosen, self.counts)]
        return GroundSamples(self.places[chosen], self.counts[chosen], cells)


def _fit_cells(middles: Floats, fit: Floats) -> Floats:
    """(D, 4) row and column of the cells under the wheels' middles (W, 2), and what each adds to
    the plane's slopes.
    """
    counts, cells = _cells_of(middles)
    shares = cells[:, 2:] * np.repeat(fit[1:].T, counts, axis=0)
    found, at = np.unique(cells[:, :2], axis=0, return_inverse=True)
    total = np.zeros((len(found), 2))
    np.add.at(total, at.reshape(-1), shares)
    return np.column_stack((found, total))


def _samples(
    middle: Floats,
    areas: Floats,
    frames: Floats,
    offsets: Floats,
    sides: Sides,
    snapped: float,
) -> list[GroundSamples]:
    """Samples of rectangles about the same `middle` (ahead, left) of bodies with frames (N, 2, 2)
    at offsets (N, 2).

    Rectangles reach `areas` (N, 2) metres ahead and to the left of their middles, and as far back
    and to the right. Their boxes are widened to lines of middles nearer than `snapped` metres.
    """
    ends = middle + _CORNERS * areas[:, None]  # (N, 4, 2) ahead, left
    corners = ends @ frames / sides + offsets[:, None]
    columns = _extents(corners)
    rows = _extents(corners[..., ::-1])
    near = (snapped / np.array(sides) + _ROUNDING)[:, None, None]
    found = []
    for n, frame in enumerate(frames):
        points = _corners_of(columns[n], rows[n], near)
        metres = (points - offsets[n]) * sides
        found.append(GroundSamples(metres @ frame.T, *_cells_of(points)))
    return found


def _extents(corners: Floats) -> list[Floats]:
    """Of convex polygons (N, 4, 2): (K, 3) each strip from one line to the next that they meet, and
    their extent.

    A strip holds second coordinates from a whole number to the next; the extent is of the first
    coordinate.
    """
    first = np.floor(corners[..., 1].min(1) + _ROUNDING)
    last = np.ceil(corners[..., 1].max(1) - _ROUNDING)
    counts = (last - first).astype(int)
    lines = first[:, None] + np.arange(counts.max() + 1)  # (N, K + 1)
    x = corners[:, None, :, 0]  # (N, 1, 4)
    y = corners[:, None, :, 1]
    along_x = np.roll(x, -1, axis=2) - x
    along_y = np.roll(y, -1, axis=2) - y
    # where each side crosses each line
    level = np.abs(along_y) <= _ROUNDING
    share = (lines[..., None] - y) / np.where(level, 1.0, along_y)
    crossed = (share >= 0.0) & (share <= 1.0) & ~level
    at = x + share * along_x  # (N, K + 1, 4)
    # which corners lie in each strip
    inside = y >= lines[:, :-1, None] - _ROUNDING
    inside &= y <= lines[:, 1:, None] + _ROUNDING
    on_lines = np.where(crossed, at, np.nan)
    within = np.where(inside, x, np.nan)
    met = np.concatenate((on_lines[:, :-1], on_lines[:, 1:], within), 2)
    extents = np.fmin.reduce(met, 2), np.fmax.reduce(met, 2)
    found = np.stack((lines[:, :-1], *extents), 2)
    return [each[:strips] for each, strips in zip(found, counts, strict=True)]


def _corners_of(columns: Floats, rows: Floats, near: Floats) -> Floats:
    """(S, 2) corners of the boxes that a convex polygon's parts between four middles fit into;
    last those on one line through middles, and on two.

    `columns` are the strips of columns with their extents of rows, `rows` likewise (`_extents`). A
    part's extent is that of the strip, cut off at the square, and widened to lines nearer than
    `near` (2, 1, 1) cells. Of the corners on one line between two middles the outer ones stay.
    """
    # by axis of the square, (2, rows, columns)
    begin = np.stack(np.broadcast_arrays(rows[:, None, 0], columns[:, 0]))
    bounds = ((columns[:, k], rows[:, None, k]) for k in (1, 2))
    least, most = (np.stack(np.broadcast_arrays(*pair)) for pair in bounds)
    end = begin + 1.0
    low = np.maximum(least, begin)
    high = np.minimum(most, end)
    there = (high - low > _ROUNDING).all(0)
    low = np.where(low - begin <= near, begin, low)
    high = np.where(end - high <= near, end, high)
    lines = itertools.product((low[0], high[0]), (low[1], high[1]))
    corners = [np.stack((down[there], across[there]), 1) for down, across in lines]
    points = np.unique(np.round(np.concatenate(corners), 9), axis=0)
    cell = np.floor(points)
    whole = points == cell
    middles = set(map(tuple, points[whole.all(1)].tolist()))
    kept = whole.all(1) | ~whole.any(1)
    for axis in (0, 1):
        # along each line between two middles the outer points, unless the middle there is one;
        # points are sorted by row and column
        on = np.flatnonzero(whole[:, axis] & ~whole[:, 1 - axis])
        on = on[np.argsort(points[on, axis], kind="stable")]
        begins = np.diff(cell[on], axis=0, prepend=np.nan).any(1)
        ends = np.append(begins, True)[1:]
        for outer, step in ((begins, 0.0), (ends, 1.0)):
            nearest = cell[on]
            nearest[:, 1 - axis] += step
            alone = [tuple(middle) not in middles for middle in nearest.tolist()]
            kept[on] |= outer & np.array(alone, np.bool_)
    order = np.argsort(whole[kept].sum(1), kind="stable")
    found: Floats = points[kept][order]
    return found


def _cells_of(points: Floats) -> tuple[Int64, Floats]:
    """Of points (S, 2): how many cells each height is a mean of, and these, (C, 3) row, column and
    share.
    """
    first = np.floor(points + _ROUNDING)
    # of the lines before and behind each point, by axis, so that none is a mean of three
    shares = np.stack((first + 1.0 - points, points - first), 1)  # (S, 2, 2)
    corner = np.array(((0, 0), (0, 1), (1, 0), (1, 1)))
    of_axes = shares[:, corner, [0, 1]]  # (S, 4, 2)
    there = (of_axes > _ROUNDING).all(2)
    cells = np.concatenate((first[:, None] + corner, of_axes.prod(2, keepdims=True)), 2)
    return there.sum(1), cells[there]
