"""The one way to a path on a map that has changed, from a place that has moved: `Joiner.join`.

A path that was planned some ticks ago seldom has the ends that are asked for by now, and a patch of
the map may lie on it. What is left of it is as good as before: short searches lead to it from where
the robot is, from it to where it is to go, and around what blocks it. Where it is clear as it is,
nothing is searched.
"""

from functools import cached_property

import numpy as np

from nnpp_edge.runtime.arrays import Int32
from nnpp_edge.runtime.cells import Cell, cell_of
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.lattice import DIRECTION_COUNT
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import JOIN_AT, JOIN_EXPANSIONS, JOIN_WITHIN

ON_IT = -1
"""Cells from a robot to the state of a path in which it is."""


def nearest_on(path: Int32, at: Cell, direction: int) -> tuple[int, int]:
    """Number of the state of a path, as `Plan.walked`, that is nearest to a robot which heads in a
    direction, -1 where that is not given; and cells to it, `ON_IT` where the robot is in it.
    """
    rows = np.abs(path[:, 0] - at[0])
    cols = np.abs(path[:, 1] - at[1])
    away = np.maximum(rows, cols)
    here = away == 0
    if direction >= 0 and path.shape[1] > 2:  # such a path may cross itself
        here &= path[:, 2] % DIRECTION_COUNT == direction
    away[here] = ON_IT
    index = int(away.argmin())
    return index, int(away[index])


class Joiner:
    """Joins paths on one map to places. Serves one thread at a time.

    Its searches have memory of their own: another search may be paused meanwhile.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._moves = grid.robot.moves

    @cached_property
    def _memory(self) -> Workspace:
        return Workspace(len(self._grid.weights), self._moves.states_a_node, sparse=True)

    def join(self, path: Int32, place: Query) -> Int32 | None:
        """States from the start of a place to its goal, for the most part along a path, as
        `Plan.walked`, that can be driven on the map as it is; None where that is far from the
        start, or no short search joins them by the place's deadline.
        """
        index, away = nearest_on(path, place.start, place.direction)
        if away > JOIN_WITHIN:
            return None
        rest: Int32 = path[index:]
        first, last = self._blocked(rest)
        way = rest if first < 0 else self._led(rest, first, last, place)
        if way is not None and not self._arrives(way, place):
            way = self._led(way, len(way) - 1, len(way) - 1, place)
        if way is not None and away != ON_IT:
            way = self._led(way, 0, 0, place)
        if way is None or self._grid.walk(way, 0, np.empty(len(way))) >= 0:
            return None  # an end itself may be blocked
        return way

    def _arrives(self, way: Int32, place: Query) -> bool:
        """Whether a way ends at the goal, in a direction that is wanted there."""
        if cell_of(way[-1]) != place.goal:
            return False
        if place.wanted is None or way.shape[1] == 2:  # a body on feet turns on the spot there
            return True
        return bool(place.wanted[self._moves.arrival(way)])

    def _blocked(self, way: Int32) -> tuple[int, int]:
        """Numbers of the first and the last state of a way that cannot be stepped on; -1 where it
        is clear.
        """
        costs = np.empty(len(way))
        first = last = self._grid.walk(way, 0, costs)
        while 0 <= last < len(way) - 1:
            blocked = self._grid.walk(way, last, costs)
            if blocked < 0:
                break
            last = max(blocked, last + 1)
        return first, last

    def _led(self, way: Int32, first: int, last: int, place: Query) -> Int32 | None:
        """A way in which another leads from some states before its `first` to some behind its
        `last` state, or from the place's start, or to its goal.
        """
        for apart in JOIN_AT:
            begin = first - apart
            end = last + apart
            part = place
            if begin > 0:
                arrival = self._moves.arrival(way[: begin + 1])
                part = part._replace(start=cell_of(way[begin]), direction=arrival)
            if end < len(way) - 1:
                wanted = np.arange(DIRECTION_COUNT) == self._moves.arrival(way[: end + 1])
                part = part._replace(goal=cell_of(way[end]), wanted=wanted)
            found = self.search(part)
            if found.status is Status.OK:
                return np.concatenate((way[: max(begin, 0)], found.path, way[end + 1 :]))
        return None

    def search(self, query: Query) -> Search:
        """A short search; of arcs as in a corridor, as what it finds need not be the best."""
        region = Region.everywhere(*self._grid.shape) if self._moves.columns == 3 else None
        return self._moves.search(self._grid, query, self._memory, region, limit=JOIN_EXPANSIONS)
