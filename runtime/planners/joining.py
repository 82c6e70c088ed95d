"""Paths that are made to lead from where the robot is to where it is to go, and around what blocks
them, by short searches.

A path that was planned some ticks ago seldom has the ends that are asked for by now, and a patch of
the map may lie on it. What is left of it is as good as before.
"""

from functools import cached_property

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Int32
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.lattice import DIRECTION_COUNT
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import JOIN_AT, JOIN_EXPANSIONS


class Joiner:
    """Joins the ends of paths on one map to the robot and the goal. Serves one thread at a time.

    Its searches have memory of their own: another search may be paused meanwhile.
    """

    def __init__(self, state: MapState) -> None:
        self._grid = state.grid

    @cached_property
    def _memory(self) -> Workspace:
        grid = self._grid
        return Workspace(len(grid.weights), grid.robot.moves.states_a_node, sparse=True)

    def joined(self, way: Int32, query: Query, *, beside: bool, to_goal: bool) -> Int32 | None:
        """States from a query's start to its goal, for the most part along a way, around what
        blocks it; None where no short search joins them.

        Parameters
        ----------
        way : (N, 2) or (N, 3) int32
            As `Plan.walked`.
        query
            Its searches are given up at its deadline.
        beside : bool
            Whether the robot is not where the way begins.
        to_goal : bool
            Whether the way ends elsewhere than at the goal, and is to be led there.
        """
        led: Int32 | None = way
        gap = self._gap(way)
        if gap is not None:
            led = self._replaced(way, *gap, query)
        if to_goal and led is not None:
            led = self._replaced(led, len(led) - 1, len(led) - 1, query)
        if beside and led is not None:
            led = self._replaced(led, 0, 0, query)
        return led

    def _gap(self, way: Int32) -> tuple[int, int] | None:
        """Numbers of the first and the last state of a way that cannot be stepped on; None where it
        is clear.
        """
        costs = np.empty(len(way))
        first = last = self._grid.walk(way, 0, costs)
        while 0 <= last < len(way) - 1:
            blocked = self._grid.walk(way, last, costs)
            if blocked < 0:
                break
            last = max(blocked, last + 1)
        return None if first < 0 else (first, last)

    def _replaced(self, way: Int32, first: int, last: int, query: Query) -> Int32 | None:
        """A way in which another leads from some states before its `first` to some behind its
        `last` state, or from the query's start, or to its goal.
        """
        moves = self._grid.robot.moves
        for apart in JOIN_AT:
            begin = first - apart
            end = last + apart
            part = query
            if begin > 0:
                part = part._replace(
                    start=_cell(way[begin]), direction=moves.arrival(way[: begin + 1])
                )
            if end < len(way) - 1:
                part = part._replace(goal=_cell(way[end]), wanted=self._alone(way[: end + 1]))
            found = self.search(part)
            if found is not None:
                return np.concatenate((way[: max(begin, 0)], found, way[end + 1 :]))
        return None

    def _alone(self, way: Int32) -> Bool | None:
        """The direction in which a way comes to its end, as `Query.wanted`."""
        direction = self._grid.robot.moves.arrival(way)
        return None if direction < 0 else np.arange(DIRECTION_COUNT) == direction

    def search(self, query: Query) -> Int32 | None:
        """The states of a short search; None where it came to nothing."""
        grid = self._grid
        search = grid.robot.moves.search(grid, query, self._memory, None, limit=JOIN_EXPANSIONS)
        return search.path if search.status is Status.OK else None


def _cell(state: Int32) -> tuple[int, int]:
    row, col = state[:2].tolist()
    return row, col
