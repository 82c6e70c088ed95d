"""A body's path of motion primitives as what is driven: straight pieces, arcs and turns, and poses
along them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Floats, Int32, Int64
from nnpp_edge.runtime.cells import Sides
from nnpp_edge.runtime.kernels.lattice import DIRECTION_COUNT, LEG_COLS, LEG_ROWS
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT
from nnpp_edge.runtime.robots.body.primitives import curve, heading_rad, turn_rad
from nnpp_edge.runtime.terrain.vehicle import Vehicle

PoseOf = tuple[float, float, float]
POSES_EVERY_M = 0.25
_MOST_TURN_DEG = 15.0
_LEAST_M = 1e-9


@dataclass(frozen=True)
class Arc:
    """A piece of a path on which gear and curvature stay the same; it begins as the one before
    ends.
    """

    gear: int
    """1 forwards, -1 backwards, 0 for a turn on the spot."""
    curvature_per_m: float
    """To the left of the body positive, whichever way it drives; 0 straight on, and of a turn on
    the spot.
    """
    length_m: float
    """That the body's middle covers; 0 of a turn on the spot."""
    start_pose: PoseOf
    """Metres along columns and along rows from the middle of cell (0, 0), and degrees clockwise
    from grid north.
    """
    turn_deg: float = 0.0
    """By how much it turns, counterclockwise."""

    def at(self, share: float) -> PoseOf:
        """The pose so far along it, of 1."""
        x, y, heading = self.start_pose
        turned = math.radians(self.turn_deg) * share
        first = math.radians(heading)
        ahead = self.gear * self.length_m * share
        left = 0.0
        if self.gear and abs(turned) > _LEAST_M:
            radius = 1.0 / self.curvature_per_m
            ahead = radius * math.sin(turned)
            left = radius * (1.0 - math.cos(turned))
        x += ahead * math.sin(first) - left * math.cos(first)
        y -= ahead * math.cos(first) + left * math.sin(first)
        return x, y, (heading - math.degrees(turned)) % 360.0

    @property
    def poses(self) -> list[PoseOf]:
        """Those after the first, no farther apart than `POSES_EVERY_M`, turned by at most 15°."""
        by_length = math.ceil(self.length_m / POSES_EVERY_M)
        by_turn = math.ceil(abs(self.turn_deg) / _MOST_TURN_DEG)
        count = max(by_length, by_turn, 1)
        return [self.at((k + 1) / count) for k in range(count)]


def heading_deg(direction: int, sides_m: Sides) -> float:
    """Of one of the sixteen directions, or of a state, degrees clockwise from grid north."""
    return (180.0 - math.degrees(heading_rad(direction, sides_m))) % 360.0


def direction_near(heading: float, sides_m: Sides) -> int:
    """The direction whose heading is nearest to one in degrees."""
    return int(np.argmax(directions_within(heading, 0.0, sides_m)))


def directions_within(heading: float, tolerance_deg: float, sides_m: Sides) -> Bool:
    """(16,) those whose heading lies so near to one in degrees; the nearest always."""
    headings = np.array([heading_deg(k, sides_m) for k in range(DIRECTION_COUNT)])
    apart = np.abs((headings - heading + 180.0) % 360.0 - 180.0)
    return apart <= max(tolerance_deg, float(apart.min()))


def arcs_along(states: Int32, vehicle: Vehicle, sides_m: Sides) -> tuple[Arc, ...]:
    """The pieces that a body drives along states (N, 3) of a path, those of the same kind
    joined.
    """
    found: list[Arc] = []
    for before, after in pairwise(states.tolist()):
        row, col, state = before
        pose = col * sides_m[1], row * sides_m[0], heading_deg(state, sides_m)
        for gear, curvature, length, turned in _pieces(before, after, vehicle, sides_m):
            arc = Arc(gear, curvature, length, pose, turned)
            pose = arc.at(1.0)
            last = found[-1] if found else arc
            alike = (last.gear, last.curvature_per_m) == (gear, curvature)
            if last is not arc and alike and (gear or last.turn_deg * turned > 0):
                whole = last.length_m + length
                found[-1] = replace(last, length_m=whole, turn_deg=last.turn_deg + turned)
            else:
                found.append(arc)
    return tuple(found)


def _pieces(
    before: Sequence[int], after: Sequence[int], vehicle: Vehicle, sides_m: Sides
) -> Iterator[tuple[int, float, float, float]]:
    """(gear, curvature, metres, degrees) of a primitive between two states."""
    down, right, side = np.subtract(after, before).tolist()
    k = before[2] % DIRECTION_COUNT
    side = (side + AXIS_COUNT) % DIRECTION_COUNT - AXIS_COUNT
    if not (down or right):
        step = 1 if side > 0 else -1
        first = k if side > 0 else k - 1
        for n in range(first, first + side, step):
            angle = turn_rad(n, sides_m)
            yield 0, 0.0, 0.0, math.degrees(math.copysign(angle, side))
        return
    dy, dx = sides_m
    towards = down * LEG_ROWS[k] * dy**2 + right * LEG_COLS[k] * dx**2
    gear = 1 if towards > 0 else -1
    if not side:
        yield gear, 0.0, math.hypot(down * dy, right * dx), 0.0
        return
    # an arc to the right is one to the left from its other end
    ahead = k if gear > 0 else k + AXIS_COUNT
    first = ahead if side > 0 else ahead - 1 + AXIS_COUNT
    bend = curve(first % DIRECTION_COUNT, sides_m, vehicle.turning_radius_m or 0.0)
    turned = side * math.degrees(bend.angle_rad)
    straight = [(gear, 0.0, length, 0.0) for length in (bend.before_m, bend.after_m)]
    bent = gear, side * gear / bend.radius_m, bend.radius_m * bend.angle_rad, turned
    begin, end = straight if side > 0 else straight[::-1]
    yield from (piece for piece in (begin, bent, end) if piece[2] > _LEAST_M)


class Drive(NamedTuple):
    """Poses along a path of states, no farther apart than `POSES_EVERY_M`; turned on the spot by at
    most 15°.
    """

    poses: Floats
    """(N, 3) metres along columns, metres along rows, degrees clockwise from grid north."""
    gears: Int64
    curvatures_per_m: Floats
    """(N,) of the piece that comes to each pose, of the first that leaves it, see `Arc`."""
    steps: Int64
    """(N,) numbers of the states that these pieces come from."""


def drive_along(states: Int32, vehicle: Vehicle, sides_m: Sides) -> Drive:
    """The drive of a body along states (N, 3) of a path, pose by pose."""
    places = states[:, 1::-1] * sides_m[::-1]
    found = [
        _motion(row - from_row, col - from_col, before, after, vehicle, sides_m)
        for (from_row, from_col, before), (row, col, after) in pairwise(states.tolist())
    ]
    steps = np.repeat(np.arange(len(found)), [len(poses) for poses in found])
    heading = heading_deg(int(states[0, 2]), sides_m)
    table = np.vstack(((*places[0], heading, 0.0, 0.0), *found))
    table[1:, :2] += places[steps]
    table[0, 3:] = table[min(1, len(steps)), 3:]
    gears = table[:, 3].astype(np.int64)
    return Drive(table[:, :3], gears, table[:, 4], np.append(0, steps))


@lru_cache(maxsize=4096)
def _motion(
    down: int, right: int, before: int, after: int, vehicle: Vehicle, sides_m: Sides
) -> Floats:
    """(N, 5) pose, gear and curvature along a motion between two states, from cell (0, 0) on."""
    states = np.array(((0, 0, before), (down, right, after)), np.int32)
    arcs = arcs_along(states, vehicle, sides_m)
    rows = [(*pose, arc.gear, arc.curvature_per_m) for arc in arcs for pose in arc.poses]
    return np.array(rows).reshape(-1, 5)
