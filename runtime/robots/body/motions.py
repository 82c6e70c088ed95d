"""The poses that a motion of a vehicle's body is checked by, and the tables by which the check
samples the ground.

A motion is a straight leg from a cell to another, a turn on the spot, or an arc
(`robots.body.primitives`). Each of its poses stands for the body's places up to `sweep_m` before
and behind it, and for headings up to `turn_rad` to both sides: together they leave nothing out. The
ground is sampled at the corners of the boxes that parts of a rectangle fit into
(docs/vehicle-check.md).
"""

import functools
import math
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Bools, Float32s, Floats, Int64s
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


class Pose(NamedTuple):
    """A pose of a motion, and what it stands for."""

    row: float
    col: float
    """Of the body's middle, in cells from the cell at which the motion begins."""
    heading: tuple[float, float]
    """(down, right) of length 1, in metres."""
    sweep_m: float = 0.0
    turn_rad: float = 0.0


def leg_poses(direction: int, sides_m: tuple[float, float], length_m: float) -> list[Pose]:
    """Of a leg from a cell along an axis, or its reverse, of a body of this length."""
    row, col = LEGS[direction]
    down = row * sides_m[0]
    right = col * sides_m[1]
    metres = math.hypot(down, right)
    count = _poses_in(metres, sides_m, length_m)
    shares = ((2 * k + 1) / (2 * count) for k in range(count))
    ahead = down / metres, right / metres
    return [Pose(share * row, share * col, ahead, metres / (2 * count)) for share in shares]


def _poses_in(metres: float, sides_m: tuple[float, float], length_m: float) -> int:
    """Number of poses on so long a leg or arc, by `LEG_SPACING`."""
    share = float(np.clip(length_m / (32.0 * max(sides_m)), *LEG_SPACING))
    return math.ceil(metres / (share * length_m))


def turn_poses(direction: int, sides_m: tuple[float, float]) -> list[Pose]:
    """Of a turn on the spot from one direction to the next."""
    first = heading_rad(direction, sides_m)
    angle = turn_rad(direction, sides_m)
    middles = (first + (2 * k + 1) / (2 * TURN_POSES) * angle for k in range(TURN_POSES))
    return [
        Pose(0.0, 0.0, (math.cos(at), math.sin(at)), 0.0, angle / (2 * TURN_POSES))
        for at in middles
    ]


def arc_poses(
    direction: int, sides_m: tuple[float, float], radius_m: float, length_m: float
) -> list[Pose]:
    """Of an arc from a direction to the next, of a body of this length."""
    first = heading_rad(direction, sides_m)
    bend = curve(direction, sides_m, radius_m)
    count = _poses_in(bend.length_m, sides_m, length_m)
    half = bend.length_m / (2 * count)
    poses = []
    for n in range(count):
        at = (2 * n + 1) * half
        ahead, left, turned = bend.at(at)
        place = (math.cos(first) * ahead - math.sin(first) * left) / sides_m[0]
        heading = math.cos(first + turned), math.sin(first + turned)
        bent = bend.before_m < at + half and at - half < bend.length_m - bend.after_m
        aside = (math.sin(first) * ahead + math.cos(first) * left) / sides_m[1]
        poses.append(Pose(place, aside, heading, half, half / bend.radius_m if bent else 0.0))
    return poses


class Motions(NamedTuple):
    """Tables of motions, one after another; each has poses, each pose groups of samples, each
    sample cells.

    A group is what lies under a wheel, or under a part of the belly over which the same wheels'
    heights lower the plane. Its samples stand in the order of how many cells each is a mean of:
    four, two, one.
    """

    poses_of: Int64s
    """(M + 1,) where each motion's poses begin."""
    groups_of: Int64s
    """(P + 1,) where the groups of each pose begin: of its wheels, then of its belly's parts."""
    groups: Int64s
    """(G, 5) of each group: first sample, first that is a mean of two cells, first that is one,
    end; first cell.
    """
    places: Float32s
    """(S, 2) metres of each sample ahead of the pose's middle and to the left of it."""
    cells: Int64s
    shares: Float32s
    """(C, 2) row and column of samples' cells, from the motion's cell; (C,) shares of their
    heights.
    """
    slopes_of: Int64s
    """(P + 1,) where the cells begin by which each pose's plane is fitted."""
    slope_cells: Int64s
    slope_shares: Float32s
    """(D, 2) row and column of these; (D, 2) what each height adds to the plane's slope ahead, and
    to the left.
    """
    raised_of: Int64s
    raised: Int64s
    """Wheels whose greatest heights make the plane lowest in each group; (G + 1,) where each
    group's begin.
    """
    swept: Float32s
    """(P, 3) metres by which a point under the body may lie elsewhere ahead and to the left, and
    the turn in rad.
    """
    gradients: Float32s
    """(5, W) what a wheel's height adds to the plane at the body's middle, to its slopes ahead
    and to the left, and to these two without sign."""
    carried: Float32s
    """(8,) what each unit of slope ahead, and to the left, by which contacts depart from the
    plane may add to the slopes ahead (2) and to the left (2), to how low the belly comes (2) and
    to the step (2), as a wheel may touch anywhere in its patch."""

    def by_offsets(self, width: int) -> PoseTables:
        """As kernels take them, for heights that lie so many to a row."""
        place = np.array((width, 1))
        ahead, left = np.ascontiguousarray(self.places.T)
        return PoseTables(
            self.poses_of,
            self.groups_of,
            self.groups,
            ahead,
            left,
            self.cells @ place,
            self.shares,
            self.slopes_of,
            self.slope_cells @ place,
            self.slope_shares,
            self.raised_of,
            self.raised,
            self.swept,
            self.gradients,
            self.carried,
        )


@functools.lru_cache(maxsize=16)
def all_motions(vehicle: Vehicle, sides_m: tuple[float, float]) -> Motions:
    """Tables of the legs along the axes, the turns from one direction to the next, the arcs from
    each direction, if the vehicle drives any, and of standing along each axis.
    """
    axes = range(len(AXIS_LEGS))
    radius = vehicle.turning_radius_m
    legs = [leg_poses(k, sides_m, vehicle.length_m) for k in axes]
    angles = [heading_rad(k, sides_m) for k in axes]
    standing = [[Pose(0.0, 0.0, (math.cos(angle), math.sin(angle)))] for angle in angles]
    turns = [turn_poses(k, sides_m) for k in axes]
    bent = range(0 if radius is None else len(LEGS))
    arcs = [arc_poses(k, sides_m, radius or 0.0, vehicle.length_m) for k in bent]
    return motions_of(vehicle, sides_m, legs + turns + arcs + standing)


def motions_of(
    vehicle: Vehicle, sides_m: tuple[float, float], motions: list[list[Pose]]
) -> Motions:
    """Tables of motions of a vehicle on cells of these sides."""
    wheels = vehicle.wheels_m
    contact = 0.5 * np.array(vehicle.contact_m)
    body = 0.5 * np.array((vehicle.length_m, vehicle.width_m))
    fit: Floats = np.linalg.pinv(np.column_stack((np.ones(len(wheels)), wheels)))
    poses = [pose for motion in motions for pose in motion]
    offsets = np.array([pose[:2] for pose in poses])
    headings = np.array([pose.heading for pose in poses])
    sweep, turn = (
        np.array([getattr(pose, name) for pose in poses]) for name in ("sweep_m", "turn_rad")
    )
    snapped = math.inf if vehicle.unknown_passes else SNAPPED * vehicle.length_m

    def swept(far: Floats) -> Floats:
        """(P, 2) by how much points so far from a body's middle (ahead, aside) lie elsewhere."""
        ahead = sweep + far[1] * turn + 0.5 * far[0] * turn**2
        return np.stack((ahead, 0.5 * sweep * turn + far[0] * turn + 0.5 * far[1] * turn**2), 1)

    groups: list[list[Samples]] = [[] for _ in poses]
    for middle, half in (*((wheel, contact) for wheel in wheels), (np.zeros(2), body)):
        areas = half + swept(np.abs(middle) + half)
        for group, found in zip(
            groups, _samples(middle, areas, headings, offsets, sides_m, snapped), strict=True
        ):
            group.append(found)
    raised: list[list[int]] = []
    for group in groups:
        belly = group.pop()
        count = len(group)
        lowers = np.column_stack((np.ones(len(belly.places)), belly.places)) @ fit < -_ROUNDING
        for pattern in np.unique(lowers, axis=0):
            group.append(belly.of((lowers == pattern).all(1)))
            raised.append(np.nonzero(pattern)[0].tolist())
        raised[len(raised) - len(group) + count : len(raised) - len(group) + count] = [[]] * count
    samples = [each for group in groups for each in group]
    first = np.cumsum([0, *map(len, groups)])
    sizes = np.array([[(each.counts == many).sum() for many in (4, 2, 1)] for each in samples])
    cells = np.concatenate([each.cells for each in samples])
    begins = np.cumsum(np.concatenate(([0], sizes.sum(1))))
    bounds = begins[:-1, None] + np.cumsum(np.pad(sizes, ((0, 0), (1, 0))), 1)
    first_cells = np.cumsum(np.concatenate(([0], sizes @ (4, 2, 1))))[:-1]
    fitted = [
        _slope_cells(wheels, fit, heading, offset, sides_m)
        for heading, offset in zip(headings, offsets, strict=True)
    ]
    slopes = np.concatenate(fitted)
    absolute = np.abs(fit)
    corners = np.array([(1.0, x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]) * (1.0, *body)
    outermost = np.abs(corners @ fit).sum(1).max()
    by_slope = np.outer((absolute[1].sum(), absolute[2].sum(), outermost), contact).reshape(-1)
    return Motions(
        np.cumsum([0, *map(len, motions)]),
        first,
        np.column_stack((bounds, first_cells)),
        np.concatenate([each.places for each in samples]).astype(np.float32),
        cells[:, :2].astype(np.int64),
        cells[:, 2].astype(np.float32),
        np.cumsum([0, *map(len, fitted)]),
        slopes[:, :2].astype(np.int64),
        np.ascontiguousarray(slopes[:, 2:], np.float32),
        np.cumsum([0, *map(len, raised)]),
        np.array([w for each in raised for w in each], np.int64),
        np.column_stack((swept(body), turn)).astype(np.float32),
        np.ascontiguousarray(np.concatenate((fit, absolute[1:])), np.float32),
        np.concatenate((by_slope, 2.0 * contact)).astype(np.float32),
    )


class Samples(NamedTuple):
    """Samples of the ground under a rectangle."""

    places: Floats
    """(S, 2) metres ahead of the body's middle and to the left of it."""
    counts: Int64s
    """(S,) cells that each is a mean of: four, two, one, in that order."""
    cells: Floats
    """(C, 3) row and column from the motion's cell, and share, of each sample's cells."""

    def of(self, chosen: Bools) -> "Samples":
        """Some of them."""
        return Samples(
            self.places[chosen], self.counts[chosen], self.cells[np.repeat(chosen, self.counts)]
        )


def _slope_cells(
    wheels: Floats, fit: Floats, heading: Floats, offset: Floats, sides: tuple[float, float]
) -> Floats:
    """(D, 4) row and column of the cells under the wheels' middles, and what each adds to the
    plane's slopes.
    """
    frame = np.array((heading, (-heading[1], heading[0])))  # rows go down
    counts, cells = _cells_of(wheels @ frame / sides + offset)
    shares = cells[:, 2:] * np.repeat(fit[1:].T, counts, axis=0)
    found, at = np.unique(cells[:, :2], axis=0, return_inverse=True)
    total = np.zeros((len(found), 2))
    np.add.at(total, at.reshape(-1), shares)
    return np.column_stack((found, total))


def _samples(
    middle: Floats,
    areas: Floats,
    headings: Floats,
    offsets: Floats,
    sides: tuple[float, float],
    snapped: float,
) -> list[Samples]:
    """Samples of rectangles about the same `middle` (ahead, left) of bodies with headings (N, 2) at
    offsets (N, 2).

    Rectangles reach `areas` (N, 2) metres ahead and to the left of their middles, and as far back
    and to the right. Their boxes are widened to lines of middles nearer than `snapped` metres.
    """
    left = np.stack((-headings[:, 1], headings[:, 0]), 1)
    signs = np.array(((-1, -1), (-1, 1), (1, 1), (1, -1)))
    ends = middle + signs * areas[:, None]  # (N, 4, 2) ahead, left
    corners = (ends[..., :1] * headings[:, None] + ends[..., 1:] * left[:, None]) / sides + offsets[
        :, None
    ]
    bounds = [_extents(corners if axis else corners[..., ::-1]) for axis in (1, 0)]
    found = []
    for n, heading in enumerate(headings):
        points = _corners_of(bounds[0][n], bounds[1][n], snapped / np.array(sides) + _ROUNDING)
        counts, cells = _cells_of(points)
        order = np.argsort(-counts, kind="stable")
        metres = (points[order] - offsets[n]) * sides
        starts = np.cumsum(counts) - counts
        at = np.concatenate([np.arange(starts[k], starts[k] + counts[k]) for k in order])
        found.append(
            Samples(np.stack((metres @ heading, metres @ left[n]), 1), counts[order], cells[at])
        )
    return found


def _extents(corners: Floats) -> list[Floats]:
    """Of convex polygons (N, 4, 2): (K, 3) each strip from one line to the next that they meet, and
    their extent.

    A strip holds second coordinates from a whole number to the next; the extent is of the first
    coordinate.
    """
    first = np.floor(corners[..., 1].min(1) + _ROUNDING)
    last = np.ceil(corners[..., 1].max(1) - _ROUNDING)
    count = int((last - first).max())
    lines = first[:, None] + np.arange(count + 1)  # (N, K + 1)
    ends = np.roll(corners, -1, axis=1)
    along = ends - corners
    level = np.abs(along[..., 1]) <= _ROUNDING
    share = (lines[..., None] - corners[:, None, :, 1]) / np.where(level, 1.0, along[..., 1])[
        :, None
    ]
    crossed = (share >= 0.0) & (share <= 1.0) & ~level[:, None]
    at = corners[:, None, :, 0] + share * along[:, None, :, 0]  # (N, K + 1, 4)
    inside = corners[:, None, :, 1] >= lines[:, :-1, None] - _ROUNDING
    inside &= corners[:, None, :, 1] <= lines[:, 1:, None] + _ROUNDING
    extents = []
    for sign in (-1.0, 1.0):
        on_lines = np.where(crossed, sign * at, -np.inf).max(-1)
        within = np.where(inside, sign * corners[:, None, :, 0], -np.inf).max(-1)
        extents.append(sign * np.maximum.reduce((on_lines[:, :-1], on_lines[:, 1:], within)))
    found = np.stack((lines[:, :-1], *extents), -1)
    return [each[: int(b - a)] for each, a, b in zip(found, first, last, strict=True)]


def _corners_of(columns: Floats, rows: Floats, near: Floats) -> Floats:
    """(S, 2) corners of the boxes that a convex polygon's parts between four middles fit into.

    `columns` are the strips of columns with their extents of rows, `rows` likewise (`_extents`). A
    part's extent is that of the strip, cut off at the square. Of the corners on one line between
    two middles the outer ones stay.
    """
    row = rows[:, None, 0]
    col = columns[None, :, 0]
    low = [np.maximum(columns[None, :, 1], row), np.maximum(rows[:, None, 1], col)]
    high = [np.minimum(columns[None, :, 2], row + 1.0), np.minimum(rows[:, None, 2], col + 1.0)]
    there = (high[0] - low[0] > _ROUNDING) & (high[1] - low[1] > _ROUNDING)
    for axis, begin in enumerate((row, col)):
        low[axis] = np.where(low[axis] - begin <= near[axis], begin, low[axis])
        high[axis] = np.where(begin + 1.0 - high[axis] <= near[axis], begin + 1.0, high[axis])
    corners = [
        np.stack((r[there], c[there]), 1) for r in (low[0], high[0]) for c in (low[1], high[1])
    ]
    points = np.unique(np.round(np.concatenate(corners), 9), axis=0)
    cell = np.floor(points)
    whole = points == cell
    nodes = set(map(tuple, points[whole.all(1)].tolist()))
    kept = whole.all(1) | ~whole.any(1)
    for axis in (0, 1):
        on = np.nonzero(whole[:, axis] & ~whole[:, 1 - axis])[0]
        keys = [(points[k, axis], cell[k, 1 - axis]) for k in on]
        for key in dict.fromkeys(keys):
            some = [k for k, each in zip(on, keys, strict=True) if each == key]
            some.sort(key=lambda k: points[k, 1 - axis])
            for k, end in ((some[0], key[1]), (some[-1], key[1] + 1.0)):
                kept[k] |= ((key[0], end) if axis == 0 else (end, key[0])) not in nodes
    found: Floats = points[kept]
    return found


def _cells_of(points: Floats) -> tuple[Int64s, Floats]:
    """Of points (S, 2): how many cells each height is a mean of, and these, (C, 3) row, column and
    share.
    """
    first = np.floor(points + _ROUNDING)
    shares = np.stack(
        (first + 1.0 - points, points - first), 1
    )  # (S, 2, 2) of both lines, along rows and columns
    there = shares > _ROUNDING  # by axis, so that none is a mean of three
    corner = np.array(((0, 0), (0, 1), (1, 0), (1, 1)))
    cells = first[:, None] + corner
    parts = shares[:, corner[:, 0], 0] * shares[:, corner[:, 1], 1]
    some = there[:, corner[:, 0], 0] & there[:, corner[:, 1], 1]
    return some.sum(1), np.concatenate((cells, parts[..., None]), 2)[some]
