"""Slow and obvious answers about a robot with a body: its poses, the cheapest path over them, and the drive itself.

Of the code that is judged only the dataclass `Vehicle` is used. Points are (row, col) in metres, from the middle of
cell (0, 0); a body's own coordinates are metres ahead of its middle and to the right of it.
"""

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tests import oracles
from tests.oracles import HEADINGS

CODES = 65533
"""Steps that T in [0, 1] is rounded up to."""
SHRUNK = 1.0 - 1e-9
"""A cell whose middle lies just a cell away has no weight."""
JUST_BELOW_1 = 1.0 - 1e-9


# --- which cells count


def cells_near(middle, ahead, half, dy, dx):
    """Set of (row, col): cells with weight somewhere in a rectangle, by clipping the rectangle to each cell's reach.

    The height of bilinear ground at a point depends on the cells that lie less than a cell from it along rows and
    along columns. The rectangle lies along `ahead`, `half` as long and as wide to each side of its `middle`.
    """
    ahead, right, middle = np.asarray(ahead), right_of(ahead), np.asarray(middle)
    corners = [
        tuple(middle + a * half[0] * ahead + b * half[1] * right) for a, b in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]
    most = 2 + int(max(abs(value) for corner in corners for value in corner) / min(dy, dx))
    found = set()
    for row, col in itertools.product(range(-most, most + 1), repeat=2):
        part = corners
        for axis, at, reach in ((0, row * dy, dy), (1, col * dx, dx)):
            part = _clipped(part, axis, 1.0, at + reach * SHRUNK)
            part = _clipped(part, axis, -1.0, -(at - reach * SHRUNK))
        if part:
            found.add((row, col))
    return found


def right_of(ahead):
    """Direction to the right of one that lies along (row, col), rows going south."""
    return np.array((ahead[1], -ahead[0]))


def _clipped(corners, axis, sign, limit):
    """The part of a convex polygon where `sign` times a coordinate is at most `limit` (Sutherland and Hodgman)."""
    kept = []
    for one, other in zip(corners, corners[1:] + corners[:1], strict=True):
        a, b = sign * one[axis] - limit, sign * other[axis] - limit
        if a <= 0.0:
            kept.append(one)
        if (a < 0.0 < b) or (b < 0.0 < a):
            share = a / (a - b)
            kept.append(tuple(p + share * (q - p) for p, q in zip(one, other, strict=True)))
    return kept


@dataclass(frozen=True)
class Body:
    """A vehicle in one heading: cells that matter, as (row, col) from the pose's own, and where they lie."""

    wheels: list
    belly: np.ndarray
    places: np.ndarray
    half_step: float
    margin: float
    design: np.ndarray
    """(W, 3) of 1, ahead, right: the plane through the wheels' contacts is fitted to these."""

    @classmethod
    def of(cls, vehicle, heading, dy, dx):
        """By clipping polygons."""
        row, col = HEADINGS[heading]
        half_step = 0.5 * math.hypot(row * dy, col * dx)
        ahead = np.array((row * dy, col * dx)) / (2.0 * half_step)
        right, (long, wide) = right_of(ahead), vehicle.contact_m
        swept = half_step if row and col else 0.0
        wheels = [
            np.array(sorted(cells_near(x * ahead + y * right, ahead, (0.5 * long + swept, 0.5 * wide), dy, dx)))
            for x, y in vehicle.wheels_m
        ]
        half = 0.5 * vehicle.length_m + half_step, 0.5 * vehicle.width_m
        belly = np.array(sorted(cells_near((0.0, 0.0), ahead, half, dy, dx)))
        metres = belly * (dy, dx)
        places = np.stack((metres @ ahead, metres @ right), 1)
        design = np.column_stack((np.ones(len(vehicle.wheels_m)), vehicle.wheels_m))
        steepest = math.tan(math.radians(min(vehicle.tilts_deg[0], vehicle.tilts_deg[2])))
        margin = 0.0 if row and col else 2.0 * half_step * steepest / 16.0
        return cls(wheels, belly, places, half_step, margin, design)


# --- the pose check


def naive_pose_costs(*given, **options):
    """The first of what `naive_pose_checks` finds."""
    return naive_pose_checks(*given, **options)[0]


def naive_pose_checks(dem, cell_size_m, vehicle, cell_width_m=None, weights=(0.6, 0.2, 0.2)):
    """T of every pose by enumeration, and how near the nearest limit was.

    Returns
    -------
    (4, H, W) float64
        T in [0, 1); inf where the pose fails.
    (4, H, W) float64
        Least difference of a figure from its limit, as a share of the limit: where this is tiny, rounding decides
        whether the pose passes. inf where the pose fails for unknown ground.
    """
    heights = np.asarray(dem, np.float64)
    heights = np.pad(np.where(np.isfinite(heights), heights, np.nan), 1, constant_values=np.nan)
    rows, cols = np.shape(dem)
    costs, margins = np.full((2, 4, rows, cols), np.inf)
    for heading in range(4):
        body = Body.of(vehicle, heading, cell_size_m, cell_width_m or cell_size_m)
        for cell in np.ndindex(rows, cols):
            figures = _figures(heights, cell, body, vehicle.unknown_passes)
            if figures is None:
                continue
            pitch, roll, tilt, step, rise = figures
            limits = (*np.radians(vehicle.tilts_deg), vehicle.step_m, vehicle.clearance_m - body.margin)
            shares = np.array(figures) / limits
            margins[heading][cell] = np.abs(shares - 1.0).min()
            if (shares <= 1.0).all():
                terms = tilt / limits[2], rise / vehicle.clearance_m, step / vehicle.step_m
                costs[heading][cell] = min(np.dot(weights, terms), JUST_BELOW_1)
    return costs, margins


def _figures(padded, cell, body, unknown_passes):
    """Worst pitch, roll, tilt (radians), step and rise (metres) of a pose; None where the ground is unknown."""
    ranges = []
    for cells in body.wheels:
        found = _at(padded, cells + cell)
        known = found[np.isfinite(found)]
        if not known.size or (known.size < found.size and not unknown_passes):
            return None
        ranges.append((known.min(), known.max()))
    ground = _at(padded, body.belly + cell)
    under = np.isfinite(ground)
    if not (under.all() or unknown_passes):
        return None
    contacts = np.array(list(itertools.product(*ranges))).T  # (W, 2^W): every combination of extreme heights
    planes = np.linalg.lstsq(body.design, contacts, rcond=None)[0]
    gx, gy = np.abs(planes[1]).max(), np.abs(planes[2]).max()
    step = max(high - low for low, high in ranges)
    lowest = (np.column_stack((np.ones(len(body.places)), body.places)) @ planes).min(1) - body.half_step * gx
    rise = max((ground - lowest)[under].max(initial=0.0), 0.0)
    return math.atan(gx), math.atan(gy), math.atan(math.hypot(gx, gy)), step, rise


def _at(padded, cells):
    """Heights of cells of a map that has one unknown cell around it; NaN beyond."""
    rows, cols = np.clip(cells.T, -1, np.array(padded.shape)[:, None] - 2) + 1
    return padded[rows, cols]


def coded(costs):
    """T as it is kept: rounded up to one of 65,534 levels; inf stays inf."""
    return np.ceil(np.asarray(costs, np.float64) * CODES) / CODES


# --- paths over poses


def dijkstra_over_poses(costs, start, goal, scale):
    """Cost of the cheapest path between two cells; inf where there is none.

    A step from i to j along heading k costs its length in cells + scale · (T_i^k + T_j^k); costs is (4, H, W).
    """
    return float(oracles.costs_from(steps_over_poses(costs, scale), costs.shape[1:], start)[tuple(goal)])


def steps_over_poses(costs, scale):
    """`oracles.steps` over poses."""
    planes = np.asarray(costs, np.float64).reshape(4, -1)

    def price(heading, step, one, other):
        return math.hypot(*step) + scale * (planes[heading][one] + planes[heading][other])

    return oracles.steps(np.isfinite(costs), price)


def path_cost_over_poses(costs, path, scale):
    """Sum of the path's steps; inf if one of its poses fails."""
    total = 0.0
    for one, other in itertools.pairwise([(int(r), int(c)) for r, c in path]):
        step = other[0] - one[0], other[1] - one[1]
        assert max(map(abs, step)) == 1, "steps go to one of eight neighbours"
        plane = costs[HEADINGS.index(step if step in HEADINGS else (-step[0], -step[1]))]
        total += math.hypot(*step) + scale * (float(plane[one]) + float(plane[other]))
    return total


def headings_of(path):
    """(N - 1,) degrees of the steps of square cells, clockwise from north, which is up the rows; 90 is east."""
    steps = np.diff(np.asarray(path, np.int64), axis=0)
    return np.degrees(np.arctan2(steps[:, 1], -steps[:, 0])) % 360.0


# --- the drive


class Break(NamedTuple):
    """One of `LIMITS` that is broken on the way; radians or metres, NaN for ``unknown``."""

    limit: str
    value: float


PER_CELL = 8
"""Samples of the edges."""
LIMITS = ("unknown", "step", "pitch", "roll", "tilt", "clearance")


def drive_breaks(dem, cell_size_m, vehicle, path, *, positions=10, margin_m=0.0):
    """The first limit that the body breaks as it drives along a path; None if there is none.

    The body stands at `positions` + 1 places along each step, in the step's heading, on bilinear ground. Heights are
    taken along the edges of each contact patch and of the body, eight to a cell, and at every cell's middle inside
    them. All combinations of extreme contact heights are tried, each with its own plane; heights between the
    extremes give a plane between theirs. Margins are allowed beyond the limits. Where unknown ground passes, it is
    left out.
    """
    ground, shares = _Ground(dem, cell_size_m, vehicle.unknown_passes), np.linspace(0.0, 1.0, positions + 1)
    tilts = np.radians(vehicle.tilts_deg)
    allowed = np.array((0.5, vehicle.step_m + margin_m, *tilts, vehicle.clearance_m + margin_m))
    for begin, end in itertools.pairwise(np.asarray(path, np.int64)):
        middles = (begin + shares[:, None] * (end - begin)) * ground.side
        found = _worst_along(ground, vehicle, middles, end - begin)
        for at, which in np.argwhere(found > allowed + 1e-9).tolist():
            return Break(LIMITS[which], math.nan if which == 0 else float(found[at, which]))
    return None


class _Ground:
    """Bilinear ground between the cells' middles."""

    def __init__(self, dem, side, unknown_passes):
        heights = np.asarray(dem, np.float64)
        self.padded = np.pad(np.where(np.isfinite(heights), heights, np.nan), 2, constant_values=np.nan)
        self.side, self.unknown_passes = side, unknown_passes

    def at(self, points):
        """Heights of (..., 2) points; NaN where a cell with weight is unknown (where all are, if unknown passes)."""
        most = np.array(self.padded.shape) - 2.0
        place = np.clip(np.round(points / self.side, 9) + 2.0, 0.0, most)  # beyond the map lie two unknown rings
        first = np.floor(place).astype(np.int64)
        share, total, weight = place - first, 0.0, 0.0
        for row, col in itertools.product((0, 1), repeat=2):
            part = np.abs(1 - row - share[..., 0]) * np.abs(1 - col - share[..., 1])
            height = self.padded[first[..., 0] + row, first[..., 1] + col]
            counts = (part > 0.0) & (np.isfinite(height) | (not self.unknown_passes))
            total, weight = total + np.where(counts, part * height, 0.0), weight + np.where(counts, part, 0.0)
        with np.errstate(invalid="ignore"):
            return total / weight

    def samples(self, middles, ahead, half):
        """(N, M, 2) points of rectangles around (N, 2) middles: their edges, and all cells' middles inside.

        Between the middles of four cells a bilinear height is linear along rows and along columns, and the least of
        several planes is concave: the ground rises highest above them at these points, and the edges are sampled.
        """
        right = right_of(ahead)
        counts = [2 + int(2.0 * side * PER_CELL / self.side) for side in half]
        along, across = (np.linspace(-side, side, count) for side, count in zip(half, counts, strict=True))
        ends = [
            [(x, y) for x in along for y in (-half[1], half[1])],
            [(x, y) for x in (-half[0], half[0]) for y in across],
        ]
        edges = np.array(ends[0] + ends[1]) @ np.stack((ahead, right))
        reach = math.ceil(math.hypot(*half) / self.side) + 1
        window = np.array(list(itertools.product(range(-reach, reach + 1), repeat=2)))
        near = (np.round(middles / self.side)[:, None] + window) * self.side
        apart = near - middles[:, None]
        inside = (np.abs(apart @ ahead) <= half[0]) & (np.abs(apart @ right) <= half[1])
        peaks = np.where(inside[..., None], near, middles[:, None])
        return np.concatenate((middles[:, None] + edges, peaks[:, inside.any(0)]), 1)


def _worst_along(ground, vehicle, middles, step):
    """(N, 6) worst figures, in the order of `LIMITS`, of the body at each of (N, 2) middles; unknown is 0 or 1."""
    ahead = step / math.hypot(*step)
    right, (long, wide) = right_of(ahead), vehicle.contact_m
    ranges, out = [], np.zeros((len(middles), len(LIMITS)))
    for x, y in vehicle.wheels_m:
        places = ground.samples(middles + x * ahead + y * right, ahead, (0.5 * long, 0.5 * wide))
        heights = ground.at(places)
        unknown = np.isnan(heights).all(1) if vehicle.unknown_passes else np.isnan(heights).any(1)
        out[:, 0] = np.maximum(out[:, 0], unknown & (not vehicle.unknown_passes))
        heights[unknown] = np.nan
        ranges.append((np.fmin.reduce(heights, 1), np.fmax.reduce(heights, 1)))  # unknown ones left out
    lows, highs = (np.stack(each, 1) for each in zip(*ranges, strict=True))
    corners = np.array(list(itertools.product((False, True), repeat=lows.shape[1])))
    contacts = np.where(corners, highs[:, None], lows[:, None])
    fit = np.linalg.pinv(np.column_stack((np.ones(lows.shape[1]), vehicle.wheels_m)))
    planes = contacts @ fit.T  # (N, 2^W, 3)
    half = 0.5 * vehicle.length_m, 0.5 * vehicle.width_m
    places = ground.samples(middles, ahead, half)
    heights, apart = ground.at(places), places - middles[:, None]
    design = np.stack((np.ones(heights.shape), apart @ ahead, apart @ right), 1)  # (N, 3, M)
    rises = heights - (planes @ design).min(1)
    if not vehicle.unknown_passes:
        out[:, 0] = np.maximum(out[:, 0], np.isnan(heights).any(1))
    out[:, 1] = (highs - lows).max(1)
    out[:, 2:4] = np.arctan(np.abs(planes[..., 1:]).max(1))
    out[:, 4] = np.arctan(np.hypot(planes[..., 1], planes[..., 2]).max(1))
    out[:, 5] = np.fmax.reduce(rises, 1)
    return out
