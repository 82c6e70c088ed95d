"""Slow and obvious answers about a robot with a body: the cheapest path over its states, and which
limit a pose breaks.

Of the code that is judged only the dataclass `Vehicle` is used, and what the check says of legs and
turns. Points are (row, col) in metres, from the middle of cell (0, 0); a body's own coordinates are
metres ahead of its middle and to the right of it.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

from nnpp_edge.runtime.kernels.poses import FAILS, MOST_CODE
from tests import oracles

AXES = ((1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1))
DIRECTIONS = AXES + tuple((-row, -col) for row, col in AXES)


# --- ground


def rocks(seed, rows=44, cols=52, share=0.02):
    """Gentle hills with rocks of half a clearance to two."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:rows, :cols]
    dem = 0.15 * np.sin(row / 9.0 + seed) + 0.2 * np.cos(col / 11.0)
    dem[rng.random(dem.shape) < share] += rng.uniform(0.15, 0.6)
    return dem.astype(np.float32)


# --- paths over states


class Motions(NamedTuple):
    """What a body can do on a map, and for how much; inf where it cannot."""

    legs: np.ndarray
    """(H, W, 16) of the leg that leaves a cell in each direction."""
    turns: np.ndarray
    """(H, W, 8) of the turn on it from each direction to the next, and from the reverse to the next
    one's.
    """


def priced(weights, turns, vehicle, sides, scale):
    """`Motions` where legs along the axes have T of (H, W, 8), and turns (H, W, 8) bool are
    possible.

    A leg costs its length in cells · (1 + 2 · scale · T), a turn its angle by the vehicle's price.
    """
    legs = np.full((*weights.shape[:2], 16), np.inf)
    for k, (row, col) in enumerate(AXES):
        t = weights[..., k]
        ahead = math.hypot(row, col) * np.where(
            np.isfinite(t), 1.0 + 2.0 * scale * np.minimum(t, 1.0), np.inf
        )
        here, there = between(ahead.shape, (row, col))
        legs[(*here, k)] = legs[(*there, k + 8)] = ahead[here]
    angles = np.array([math.atan2(col * sides[1], row * sides[0]) for row, col in (*AXES, (-1, 0))])
    return Motions(
        legs,
        np.where(
            turns, vehicle.turn_m_per_rad / sides[0] * (np.diff(angles) % (2.0 * math.pi)), np.inf
        ),
    )


def between(shape, step):
    """Slices of the cells that a step stays on the map from, and of those that it leads to."""
    ends = [
        (slice(max(-by, 0), side - max(by, 0)), slice(max(by, 0), side + min(by, 0)))
        for by, side in zip(step, shape, strict=True)
    ]
    return tuple(zip(*ends, strict=True))


def graph_of_states(motions):
    """The ways between states (H, W, 16) of cells and directions, for `oracles.costs_from`."""
    states = np.arange(motions.legs.size).reshape(motions.legs.shape)
    turns = np.tile(motions.turns, 2)
    onward = states + 16 * (DIRECTIONS @ np.array((states.shape[1], 1)))
    turned = np.roll(states, -1, axis=2)
    ways = (states, onward, motions.legs), (states, turned, turns), (turned, states, turns)
    return oracles.graph_of(oracles.possible(ways), states.shape)


def costs_to_cells(motions, start, graph=None):
    """(H, W) cost of the cheapest way from a cell to every other, whatever the directions
    at both; the graph of the motions is made unless it is given.
    """
    graph = graph_of_states(motions) if graph is None else graph
    starts = [(*start, k) for k in range(16)]
    return oracles.costs_from(graph, motions.legs.shape, *starts).min(2)


def path_cost(motions, path):
    """Cost of a path of cells, turned at each the cheaper way that is possible; inf where it fails,
    or leaps.
    """
    total = 0.0
    before = None
    for (row, col), there in itertools.pairwise(path):
        step = int(there[0] - row), int(there[1] - col)
        if step not in DIRECTIONS:
            return math.inf
        k = DIRECTIONS.index(step)
        turns = np.tile(motions.turns[row, col], 2)
        if before is not None:
            first, last = sorted((before, k))
            total += min(turns[first:last].sum(), turns[last:].sum() + turns[:first].sum())
        total = total + motions.legs[row, col, k]
        before = k
    return total


def headings_of(path):
    """(N - 1,) degrees of the legs on square cells, clockwise from north, which is up the rows; 90
    is east.
    """
    legs = np.diff(np.asarray(path, np.int64), axis=0)
    return np.degrees(np.arctan2(legs[:, 1], -legs[:, 0])) % 360.0


# --- arcs, by geometry of its own: one touches the lines of two directions, which cross at a point


def angle_of(k, sides):
    return math.atan2(DIRECTIONS[k][1] * sides[1], DIRECTIONS[k][0] * sides[0])


def turn_of(k, sides):
    """Radians from a direction to the next."""
    return (angle_of((k + 1) % 16, sides) - angle_of(k, sides)) % (2.0 * math.pi)


def bend(k, sides, radius):
    """(row, col) to which the shortest arc to the left from a direction leads, and its metres."""
    after = (k + 1) % 16
    turn = turn_of(k, sides)
    units = [
        math.hypot(DIRECTIONS[at][0] * sides[0], DIRECTIONS[at][1] * sides[1]) for at in (k, after)
    ]
    wanted = radius * math.tan(turn / 2.0)
    a, b = (next(n for n in itertools.count(1) if n * unit >= wanted - 1e-9) for unit in units)
    touch = min(a * units[0], b * units[1])
    place = tuple(a * DIRECTIONS[k][axis] + b * DIRECTIONS[after][axis] for axis in (0, 1))
    return place, a * units[0] + b * units[1] - 2.0 * touch + touch / math.tan(turn / 2.0) * turn


def ways_from(k, vehicle, sides):
    """From a heading: (row, col, heading, gear, motion, whether that begins where it leads to,
    cells, metres).
    """
    for gear in (1,) if vehicle.reverse_cost is None else (1, -1):
        ahead = (k if gear > 0 else k + 8) % 16
        length = math.hypot(*DIRECTIONS[k])
        yield *DIRECTIONS[ahead], k, gear, k % 8, ahead >= 8, length, 0.0
        for side in (1, -1):
            # rightwards is the arc that comes from where this one leads to, the other way round
            arc = ahead if side > 0 else (ahead + 7) % 16
            (down, right), metres = bend(arc, sides, vehicle.turning_radius_m)
            cells = metres / min(sides)
            yield side * down, side * right, (k + side) % 16, gear, 16 + arc, side < 0, cells, 0.0
    if vehicle.turns_on_spot:
        for side in (1, -1):
            first = k if side > 0 else (k - 1) % 16
            metres = turn_of(first, sides) * vehicle.turn_m_per_rad
            yield 0, 0, (k + side) % 16, 0, 8 + first % 8, False, 0.0, metres


def graph_of_arcs(codes, vehicle, sides, scale):
    """The ways between states (H, W, 16, 3), of which the last index is the gear that one was come
    to in, as a graph for `oracles.costs_from`.
    """
    shape = (*codes.shape[:2], 16, 3)
    states = np.arange(math.prod(shape)).reshape(shape)
    found = []
    for k in range(16):
        for way in ways_from(k, vehicle, sides):
            down, right, to, gear, motion, begins_there, cells, metres = way
            ends = between(shape[:2], (down, right))
            code = codes[(*ends[begins_there], motion)]
            fare = cells * (vehicle.reverse_cost if gear < 0 else 1.0)
            price = fare * (1.0 + 2.0 * scale * (code - 1.0) / MOST_CODE) + metres / sides[0]
            price[code >= FAILS] = math.inf
            for before in (1, -1):
                after = gear or before
                change = vehicle.gear_change_m / sides[0] if after != before else 0.0
                one, other = states[(*ends[0], k, before)], states[(*ends[1], to, after)]
                found.append((one, other, price + change))
    return oracles.graph_of(oracles.possible(found), shape)


# --- poses


class Break(NamedTuple):
    """One of `LIMITS` that is broken on the way; radians or metres, NaN for ``unknown``."""

    limit: str
    value: float
    place: tuple


PER_CELL = 8
"""Samples of the edges."""
LIMITS = ("unknown", "step", "pitch", "roll", "tilt", "belly")


def breaks_at(dem, cell_size_m, vehicle, places, headings):
    """The first of some poses, places (N, 2) in cells and headings (N,) from down the rows, that
    breaks a limit.
    """
    found = worst_figures(dem, cell_size_m, vehicle, places, headings)
    for at, which in np.argwhere(found > allowances(vehicle)).tolist():
        value = math.nan if which == 0 else float(found[at, which])
        return Break(LIMITS[which], value, (*map(float, places[at]), math.degrees(headings[at])))
    return None


def allowances(vehicle):
    """(6,) what figures may be at most, in the order of `LIMITS`."""
    tilts = np.radians(vehicle.tilts_deg)
    return np.array((0.5, vehicle.step_m, *tilts, vehicle.clearance_m)) + 1e-9


def worst_figures(dem, cell_size_m, vehicle, places, headings):
    """(N, 6) worst figures, in the order of `LIMITS`, of a body at places (N, 2) in cells; unknown
    is 0 or 1.

    The body's plane is that of least squares through the ground under its wheels' middles. Each
    wheel touches somewhere in its patch, and raises or lowers its corner of the plane by what the
    ground departs from it there: all combinations of the least and the greatest departures are
    tried, each with its own plane; those between give a plane between theirs. Heights are taken
    along the edges of each patch and of the body, eight to a cell, and at every cell's middle
    inside them.
    """
    sides = np.broadcast_to(cell_size_m, 2)
    ground = _Ground(dem, sides, vehicle.unknown_passes)
    middles = np.asarray(places) * sides
    long, wide = vehicle.contact_m
    ahead = np.stack((np.cos(headings), np.sin(headings)), 1)
    right = np.stack((ahead[:, 1], -ahead[:, 0]), 1)
    fit = np.linalg.pinv(np.column_stack((np.ones(len(vehicle.wheels_m)), vehicle.wheels_m)))
    stands = [middles + x * ahead + y * right for x, y in vehicle.wheels_m]
    plane = np.stack([ground.at(place) for place in stands], 1) @ fit.T  # (N, 3)
    if vehicle.unknown_passes:
        plane = np.where(np.isfinite(plane).all(1, keepdims=True), plane, 0.0)
    out = np.zeros((len(middles), len(LIMITS)))
    ranges = []

    def departures(points):
        apart = points - middles[:, None]
        own = np.stack(
            (
                np.ones(apart.shape[:2]),
                (apart * ahead[:, None]).sum(2),
                (apart * right[:, None]).sum(2),
            ),
            2,
        )
        return ground.at(points) - (own * plane[:, None]).sum(2), own

    for place in stands:
        found, _ = departures(ground.samples(place, ahead, (0.5 * long, 0.5 * wide)))
        unknown = np.isnan(found).all(1) if vehicle.unknown_passes else np.isnan(found).any(1)
        out[:, 0] = np.maximum(out[:, 0], unknown & (not vehicle.unknown_passes))
        found[unknown] = np.nan
        ranges.append((np.fmin.reduce(found, 1), np.fmax.reduce(found, 1)))
    lows, highs = (np.stack(each, 1) for each in zip(*ranges, strict=True))
    corners = np.array(list(itertools.product((False, True), repeat=lows.shape[1])))
    planes = (
        np.where(corners, highs[:, None], lows[:, None]) @ fit.T
    )  # (N, 2^W, 3) above the first plane
    found, own = departures(
        ground.samples(middles, ahead, (0.5 * vehicle.length_m, 0.5 * vehicle.width_m))
    )
    if not vehicle.unknown_passes:
        out[:, 0] = np.maximum(out[:, 0], np.isnan(found).any(1))
    slopes = planes[..., 1:] + plane[:, None, 1:]
    out[:, 1] = (highs - lows).max(1)
    out[:, 2:4] = np.arctan(np.abs(slopes).max(1))
    out[:, 4] = np.arctan(np.hypot(slopes[..., 0], slopes[..., 1]).max(1))
    out[:, 5] = np.fmax.reduce(found - (planes @ own.transpose(0, 2, 1)).min(1), 1)
    return out


class _Ground:
    """Bilinear ground between the cells' middles."""

    def __init__(self, dem, sides, unknown_passes):
        self.known = np.isfinite(dem)
        self.heights = np.where(self.known, dem, 0.0)
        self.sides = sides
        self.unknown_passes = unknown_passes

    def at(self, points):
        """Heights of (..., 2) points; NaN where a cell with weight is unknown (where all are, if
        unknown passes).
        """
        place = np.moveaxis(np.round(points / self.sides, 9), -1, 0)
        total, known = (
            map_coordinates(each, place, float, order=1, mode="grid-constant")
            for each in (self.heights, self.known)
        )
        least = 0.0 if self.unknown_passes else 1.0 - 1e-12
        with np.errstate(invalid="ignore"):
            return np.where(known > least, total / known, np.nan)

    def samples(self, middles, ahead, half):
        """(N, M, 2) points of rectangles around (N, 2) middles: their edges, and all cells' middles
        inside.

        Between the middles of four cells a bilinear height is linear along rows and along columns,
        and the least of several planes is concave: the ground rises highest above them at these
        points, and the edges are sampled.
        """
        right = np.stack((ahead[:, 1], -ahead[:, 0]), 1)
        counts = [2 + int(2.0 * side * PER_CELL / self.sides.min()) for side in half]
        along, across = (
            np.linspace(-side, side, count) for side, count in zip(half, counts, strict=True)
        )
        edges = np.array(
            [(x, y) for x in along for y in (-half[1], half[1])]
            + [(x, y) for x in (-half[0], half[0]) for y in across]
        )
        edges = edges[:, 0, None] * ahead[:, None] + edges[:, 1, None] * right[:, None]
        reach = math.ceil(math.hypot(*half) / self.sides.min()) + 1
        window = np.array(list(itertools.product(range(-reach, reach + 1), repeat=2)))
        near = (np.round(middles / self.sides)[:, None] + window) * self.sides
        apart = near - middles[:, None]
        inside = np.abs((apart * ahead[:, None]).sum(2)) <= half[0]
        inside &= np.abs((apart * right[:, None]).sum(2)) <= half[1]
        peaks = np.where(inside[..., None], near, middles[:, None])
        return np.concatenate((middles[:, None] + edges, peaks[:, inside.any(0)]), 1)
