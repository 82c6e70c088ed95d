"""Motion primitives: how a body gets from a state, a cell and a direction of its sixteen, to
others.

A primitive is a leg along the direction, a turn on the spot to the next, or an arc that leads from
a cell's middle and direction to another's middle and the next direction: two straight pieces and
between them an arc of a circle, of which only the shorter piece may be missing. Backwards the same
curves are driven the other way. A body is the same the other way round, so a curve to the right is
one to the left from its other end.
"""

import functools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Float32s
from nnpp_edge.runtime.cells import Sides
from nnpp_edge.runtime.kernels.lattice import (
    DIRECTION_COUNT,
    LEFT_TURN,
    LEG,
    LEG_COLS,
    LEG_ROWS,
    left_over,
)
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT
from nnpp_edge.runtime.kernels.records import FARE_COLUMNS, MOVE_COLUMNS, Legs, Prices
from nnpp_edge.runtime.terrain.vehicle import Vehicle

TURNS = AXIS_COUNT
ARCS = 2 * AXIS_COUNT
"""Numbers of the first motions after legs; arcs, if there are any, are sixteen: to the left from
each direction.
"""
FORWARDS = 0
BACKWARDS = DIRECTION_COUNT
"""Added to a direction, the number of a state among those of its cell: the gear in which it was
come to.
"""
_LEG_LENGTHS = Legs(1.0, math.sqrt(2.0), math.sqrt(5.0))
"""In cells."""
_BACKWARD_LEG = 3
_LEFT_ARC = 4
_RIGHT_ARC = 5
_BACKWARDS_ON = 2
_KINDS = 8
"""Kinds of primitives after the turns; an arc backwards is so many on; and how many there are."""
_INT = np.int32
_FLOAT = np.float32


class Move(NamedTuple):
    """A primitive, as the kernels have its numbers (`kernels.records.DOWN`)."""

    down: int
    right: int
    to: int
    motion: int
    there: bool


class Curve(NamedTuple):
    """From a cell's middle and direction to another's middle and the next direction, to
    the left.
    """

    down: int
    right: int
    before_m: float
    """Straight, then along the arc, then straight again."""
    radius_m: float
    angle_rad: float
    after_m: float

    @property
    def length_m(self) -> float:
        """Of all three."""
        return self.before_m + self.radius_m * self.angle_rad + self.after_m

    def at(self, metres: float) -> tuple[float, float, float]:
        """Metres ahead and to the left of where it begins, and by how much it has turned, so far
        along it.
        """
        bent = min(max(metres - self.before_m, 0.0), self.radius_m * self.angle_rad)
        turned = bent / self.radius_m
        rest = max(metres - self.before_m - bent, 0.0)
        ahead = (
            min(metres, self.before_m) + self.radius_m * math.sin(turned) + rest * math.cos(turned)
        )
        return ahead, self.radius_m * (1.0 - math.cos(turned)) + rest * math.sin(turned), turned


def heading_rad(direction: int, sides_m: Sides) -> float:
    """Angle of a direction from down the rows, rising towards growing columns, on the ground."""
    row = LEG_ROWS[direction % DIRECTION_COUNT]
    col = LEG_COLS[direction % DIRECTION_COUNT]
    return math.atan2(col * sides_m[1], row * sides_m[0])


def turn_rad(direction: int, sides_m: Sides) -> float:
    """Angle from a direction to the next."""
    return (heading_rad(direction + 1, sides_m) - heading_rad(direction, sides_m)) % (2.0 * math.pi)


def curve(direction: int, sides_m: Sides, radius_m: float) -> Curve:
    """The shortest from a direction to the next whose arc has at least this radius."""
    after = (direction + 1) % DIRECTION_COUNT
    angle = turn_rad(direction, sides_m)
    touching = math.tan(0.5 * angle)
    down = 0
    right = 0
    tangents = []
    for k in (direction, after):
        leg = math.hypot(LEG_ROWS[k] * sides_m[0], LEG_COLS[k] * sides_m[1])
        count = max(math.ceil(radius_m * touching / leg - 1e-9), 1)
        tangents.append(count * leg)
        down += count * LEG_ROWS[k]
        right += count * LEG_COLS[k]
    shorter = min(tangents)
    before_m, after_m = (tangent - shorter for tangent in tangents)
    return Curve(down, right, before_m, shorter / touching, angle, after_m)


def sharpest_m(radius_m: float, sides_m: Sides) -> float:
    """Radius of the sharpest arc of them all, where none may be below `radius_m`."""
    return min(curve(k, sides_m, radius_m).radius_m for k in range(DIRECTION_COUNT))


@functools.lru_cache(maxsize=16)
def primitives(vehicle: Vehicle, sides_m: Sides) -> tuple[Prices, float]:
    """Of a vehicle on cells of these sides, heights and widths; no curve is shorter than so many
    times the way by legs. Rays are legs, and then arcs forwards, if there are any.
    """
    geared = vehicle.gear_change_m > 0.0 and vehicle.reverse_cost is not None
    gears = (FORWARDS, BACKWARDS) if geared else (FORWARDS,)
    # a column for each kind and each gear before it, at first
    shape = len(gears) * DIRECTION_COUNT, _KINDS * len(gears)
    moves = np.full((*shape, MOVE_COLUMNS), -1, _INT)
    fares = np.zeros((*shape, FARE_COLUMNS), _FLOAT)
    origins = np.full(shape, -1, _INT)
    for k, kind, move, length, gear in _ways(vehicle, sides_m):
        cells = length * (vehicle.reverse_cost or 1.0) if gear < 0 else length
        for number, before in enumerate(gears):
            if gear:
                onwards = gears[-1] if gear < 0 else FORWARDS
                fixed_m = 0.0 if before == onwards else vehicle.gear_change_m
            else:
                number = 0
                onwards = before
                fixed_m = vehicle.turn_m_per_rad * turn_rad(move.motion - TURNS, sides_m)
            at = kind * len(gears) + number
            moves[k + before, at] = move._replace(to=move.to + onwards)
            fares[k + before, at] = cells, fixed_m / sides_m[0]
            origins[move.to + onwards, at] = k + before
    there = (origins >= 0).any(0)
    moves = np.compress(there, moves, axis=1)
    fares = np.compress(there, fares, axis=1)
    origins = np.compress(there, origins, axis=1)
    legs = [_leg(k, k) for k in range(DIRECTION_COUNT)]
    lengths = list(map(math.hypot, LEG_ROWS, LEG_COLS))
    shortest = 1.0
    if vehicle.turning_radius_m is not None:
        for k in range(DIRECTION_COUNT):
            bend = curve(k, sides_m, vehicle.turning_radius_m)
            cells = bend.length_m / min(sides_m)
            legs.append(Move(bend.down, bend.right, k, ARCS + k, False))
            legs.append(Move(-bend.down, -bend.right, k, ARCS + k, True))
            lengths += [cells, cells]
            by_legs = left_over.py_func(abs(bend.down), abs(bend.right), _LEG_LENGTHS)
            shortest = min(shortest, cells / by_legs)
    prices = Prices(
        unit=_FLOAT(0.0),
        moves=moves,
        fares=fares,
        origins=origins,
        rays=np.array(legs, _INT),
        ray_fares=np.array(lengths, _FLOAT),
        turns=_turns(vehicle, sides_m),
    )
    return prices, shortest


def _turns(vehicle: Vehicle, sides_m: Sides) -> Float32s:
    """(16, 16) what the shorter turn from each direction to each other costs, in cells."""
    angles = np.array([turn_rad(k, sides_m) for k in range(AXIS_COUNT)])
    to_next = vehicle.turn_m_per_rad * angles / sides_m[0]
    at = np.cumsum(np.concatenate(([0.0], to_next, to_next)))
    apart = np.abs(at[:-1, None] - at[:-1])
    found: Float32s = np.minimum(apart, at[-1] - apart).astype(np.float32)
    return found


def _ways(vehicle: Vehicle, sides_m: Sides) -> Iterator[tuple[int, int, Move, float, int]]:
    """Direction, kind, primitive, its cells, and gear (0 on the spot)."""
    radius = vehicle.turning_radius_m
    for k in range(DIRECTION_COUNT):
        before = (k - 1) % DIRECTION_COUNT
        after = (k + 1) % DIRECTION_COUNT
        if vehicle.can_turn_on_spot:
            left_turn = Move(0, 0, after, TURNS + k % AXIS_COUNT, False)
            right_turn = Move(0, 0, before, TURNS + before % AXIS_COUNT, False)
            yield k, LEFT_TURN, left_turn, 0.0, 0
            yield k, LEFT_TURN + 1, right_turn, 0.0, 0
        for gear in (1,) if vehicle.reverse_cost is None else (1, -1):
            ahead = k if gear > 0 else (k + AXIS_COUNT) % DIRECTION_COUNT
            kind = LEG if gear > 0 else _BACKWARD_LEG
            yield k, kind, _leg(ahead, k), math.hypot(LEG_ROWS[k], LEG_COLS[k]), gear
            if radius is None:
                continue
            # from its beginning to the left, and from its end, the other way round, to the right
            right = (ahead - 1 + AXIS_COUNT) % DIRECTION_COUNT
            for arc, to, kind in ((ahead, 1, _LEFT_ARC), (right, -1, _RIGHT_ARC)):
                bend = curve(arc, sides_m, radius)
                turned = (k + to) % DIRECTION_COUNT
                move = Move(to * bend.down, to * bend.right, turned, ARCS + arc, to < 0)
                kind = kind if gear > 0 else kind + _BACKWARDS_ON
                yield k, kind, move, bend.length_m / min(sides_m), gear


def _leg(way: int, direction: int) -> Move:
    """The leg that leads a way, of a body that stands in this direction."""
    there = way >= AXIS_COUNT
    return Move(LEG_ROWS[way], LEG_COLS[way], direction, direction % AXIS_COUNT, there)
