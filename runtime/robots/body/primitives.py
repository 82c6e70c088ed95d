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
from numpy.typing import NDArray

from nnpp_edge.runtime.kernels.lattice import COLS, DIRECTIONS, LEFT_TURN, LEG, ROWS, left_over
from nnpp_edge.runtime.kernels.poses import AXES as AXES
from nnpp_edge.runtime.terrain.vehicle import Vehicle

TURNS = AXES
ARCS = 2 * AXES
"""Numbers of the first motions after legs; arcs, if there are any, are sixteen: to the left from
each direction.
"""
FORWARDS = 0
BACKWARDS = DIRECTIONS
"""Added to a direction, the number of a state among those of its cell: the gear in which it was
come to.
"""
_LEGS = 1.0, math.sqrt(2.0), math.sqrt(5.0)
"""Cells of a straight, a diagonal and a knight's leg."""
_INT = np.int32
_FLOAT = np.float32
_Move = tuple[int, int, int, int, bool, int]


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


def heading_rad(direction: int, sides_m: tuple[float, float]) -> float:
    """Angle of a direction from down the rows, rising towards growing columns, on the ground."""
    row = ROWS[direction % DIRECTIONS]
    col = COLS[direction % DIRECTIONS]
    return math.atan2(col * sides_m[1], row * sides_m[0])


def turn_rad(direction: int, sides_m: tuple[float, float]) -> float:
    """Angle from a direction to the next."""
    return (heading_rad(direction + 1, sides_m) - heading_rad(direction, sides_m)) % (2.0 * math.pi)


def curve(direction: int, sides_m: tuple[float, float], radius_m: float) -> Curve:
    """The shortest from a direction to the next whose arc has at least this radius."""
    angle = turn_rad(direction, sides_m)
    after = (direction + 1) % DIRECTIONS
    legs = [math.hypot(ROWS[k] * sides_m[0], COLS[k] * sides_m[1]) for k in (direction, after)]
    touching = math.tan(0.5 * angle)
    counts = [max(math.ceil(radius_m * touching / leg - 1e-9), 1) for leg in legs]
    tangents = [count * leg for count, leg in zip(counts, legs, strict=True)]
    down, right = (
        counts[0] * steps[direction] + counts[1] * steps[after] for steps in (ROWS, COLS)
    )
    shorter = min(tangents)
    return Curve(
        down, right, tangents[0] - shorter, shorter / touching, angle, tangents[1] - shorter
    )


class Primitives(NamedTuple):
    """Of a vehicle on cells of certain sides, as the kernels take them (`kernels.lattice`)."""

    moves: NDArray[np.int32]
    """(S, P, 6) each primitive of each state: rows, columns, state, motion, whether it begins
    there, direction.
    """
    fares: NDArray[np.float32]
    """(S, P, 2) what each costs: cells by its code, and cells of level ground in any case."""
    origins: NDArray[np.int32]
    """(S, P) the state, among those of a cell, from which a primitive leads to each; -1 where none
    does.
    """
    rays: NDArray[np.int32]
    """(16 or 48, 6) ways from cell to cell whatever the direction: legs, and then arcs forwards."""
    ray_fares: NDArray[np.float32]
    """(16 or 48,) cells that each costs by its code."""
    shortest: float
    """No curve is shorter than so many times the way by legs."""


@functools.lru_cache(maxsize=16)
def primitives(vehicle: Vehicle, sides_m: tuple[float, float]) -> Primitives:
    """Of a vehicle on cells of these sides, heights and widths."""
    geared = vehicle.gear_change_m > 0.0 and vehicle.reverse_cost is not None
    gears = (FORWARDS, BACKWARDS) if geared else (FORWARDS,)
    unit = min(sides_m)
    found = dict[tuple[int, int], tuple[_Move, tuple[float, float]]]()
    ways = list(_ways(vehicle, sides_m))
    kinds = sorted(
        {(kind, before) for _, kind, _, _, gear in ways for before in (gears if gear else (0,))}
    )
    for k, kind, move, length, gear in ways:
        down, right, to, motion, there, edge = move
        for before in gears:
            fixed = 0.0
            onwards = before if not gear else (BACKWARDS if gear < 0 and geared else FORWARDS)
            if not gear:
                fixed = vehicle.turn_m_per_rad * turn_rad(motion - TURNS, sides_m) / sides_m[0]
            elif geared and before != onwards:
                fixed = vehicle.gear_change_m / sides_m[0]
            cells = length * (vehicle.reverse_cost or 1.0) if gear < 0 else length
            at = kinds.index((kind, before if gear else 0))
            found[k + before, at] = (down, right, to + onwards, motion, there, edge), (cells, fixed)
    states = len(gears) * DIRECTIONS
    count = len(kinds)
    moves = np.full((states, count, 6), -1, _INT)
    fares = np.zeros((states, count, 2), _FLOAT)
    origins = np.full((states, count), -1, _INT)
    for (local, at), (move, fare) in found.items():
        moves[local, at] = move
        fares[local, at] = fare
        origins[move[2], at] = local
    legs: list[_Move] = [(ROWS[k], COLS[k], k, k % AXES, k >= AXES, k) for k in range(DIRECTIONS)]
    lengths = [math.hypot(ROWS[k], COLS[k]) for k in range(DIRECTIONS)]
    shortest = 1.0
    if vehicle.turning_radius_m is not None:
        for k in range(DIRECTIONS):
            bend = curve(k, sides_m, vehicle.turning_radius_m)
            cells = bend.length_m / unit
            ends = (bend.down, bend.right), (-bend.down, -bend.right)
            legs += [
                (*end, k, ARCS + k, there, -1)
                for end, there in zip(ends, (False, True), strict=True)
            ]
            lengths += [cells, cells]
            shortest = min(
                shortest, cells / left_over.py_func(abs(bend.down), abs(bend.right), _LEGS)
            )
    rays = np.array(legs, _INT)
    return Primitives(moves, fares, origins, rays, np.array(lengths, _FLOAT), shortest)


def _ways(
    vehicle: Vehicle, sides_m: tuple[float, float]
) -> Iterator[tuple[int, int, _Move, float, int]]:
    """Of each direction: kind, rows, columns, direction, motion, whether there, leg; cells, gear (0
    on the spot).
    """
    gears = (1,) if vehicle.reverse_cost is None else (1, -1)
    for k in range(DIRECTIONS):
        before = (k - 1) % DIRECTIONS
        after = (k + 1) % DIRECTIONS
        for gear in gears if vehicle.turning_radius_m is not None else (1,):
            way = k if gear > 0 else (k + AXES) % DIRECTIONS
            kind = LEG if gear > 0 else 3
            yield (
                k,
                kind,
                (ROWS[way], COLS[way], k, k % AXES, way >= AXES, way),
                math.hypot(ROWS[k], COLS[k]),
                gear,
            )
        if vehicle.can_turn_on_spot:
            yield k, LEFT_TURN, (0, 0, after, TURNS + k % AXES, False, -1), 0.0, 0
            yield k, LEFT_TURN + 1, (0, 0, before, TURNS + before % AXES, False, -1), 0.0, 0
        if (radius := vehicle.turning_radius_m) is None:
            continue
        for gear in gears:
            # from its beginning to the left, and from its end, the other way round, to the right
            ahead = k if gear > 0 else (k + AXES) % DIRECTIONS
            left = ahead
            right = (ahead - 1 + AXES) % DIRECTIONS
            for arc, to, there, kind in ((left, 1, False, 4), (right, -1, True, 5)):
                bend = curve(arc, sides_m, radius)
                sign = -1 if there else 1
                move = (
                    sign * bend.down,
                    sign * bend.right,
                    (k + to) % DIRECTIONS,
                    ARCS + arc,
                    there,
                    -1,
                )
                yield k, kind if gear > 0 else kind + 2, move, bend.length_m / min(sides_m), gear
