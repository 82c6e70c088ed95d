"""Paths that are made to lead from where the robot is, and to where it is to go, by short searches
at their ends.

A path that was planned some ticks ago, or that is still being driven, seldom has the ends that are
asked for by now. Both have moved a little, and what lies between them is as good as before.
"""

from functools import cached_property

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Int32
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.lattice import DIRECTION_COUNT
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import JOIN_AT, JOIN_EXPANSIONS, JOIN_WITHIN


class Joiner:
    """Joins the ends of paths on one map to the robot and the goal. Serves one thread at a time.

    Its searches have memory of their own: another search may be paused meanwhile.
    """

    def __init__(self, state: MapState) -> None:
        self._grid = state.grid

    @cached_property
    def _memory(self) -> Workspace:
        grid = self._grid
        return Workspace(len(grid.weights), grid.robot.states_a_node, sparse=True)

    def joined(self, way: Int32, index: int, query: Query, *, to_goal: bool) -> Int32 | None:
        """States from a query's start to its goal, for the most part along a way; None where no
        short search joins them.

        Parameters
        ----------
        way : (N, 2) or (N, 3) int32
            As `Plan.walked`.
        index : int
            Number of the state in which the robot is; -1 where it is beside the way.
        query
            Its searches are given up at its deadline.
        to_goal : bool
            Whether the way ends elsewhere than at the goal, and is to be led there.

        The way itself is not checked.
        """
        on_way = index >= 0
        if not on_way:
            away = np.abs(way[:, :2] - np.array(query.start, np.int32)).max(1)
            index = int(away.argmin())
            if away[index] > JOIN_WITHIN:
                return None
        way = way[index:]
        if not to_goal:
            return way if on_way else self._from_start(way, query)
        led = self._to_goal(way, query)
        return led if led is None or on_way else self._from_start(led, query)

    def _from_start(self, way: Int32, query: Query) -> Int32 | None:
        """The way, to a state of which another leads from the query's start."""
        for ahead in JOIN_AT:
            at = min(ahead, len(way) - 1)
            wanted = query.wanted if at == len(way) - 1 else self._alone(way[: at + 1])
            found = self._search(query._replace(goal=_cell(way[at]), wanted=wanted))
            if found is not None:
                return np.concatenate((found, way[at + 1 :]))
        return None

    def _to_goal(self, way: Int32, query: Query) -> Int32 | None:
        """The way, from a state of which another leads to the query's goal."""
        for behind in JOIN_AT:
            at = max(len(way) - 1 - behind, 0)
            if at:
                direction = self._grid.robot.arrival(way[: at + 1])
                query = query._replace(start=_cell(way[at]), direction=direction)
            found = self._search(query)
            if found is not None:
                return np.concatenate((way[:at], found))
        return None

    def _alone(self, way: Int32) -> Bool | None:
        """The direction in which a way comes to its end, as `Query.wanted`."""
        direction = self._grid.robot.arrival(way)
        return None if direction < 0 else np.arange(DIRECTION_COUNT) == direction

    def _search(self, query: Query) -> Int32 | None:
        grid = self._grid
        search = grid.robot.search(grid, query, self._memory, None, limit=JOIN_EXPANSIONS)
        return search.path if search.status is Status.OK else None


def _cell(state: Int32) -> tuple[int, int]:
    row, col = state[:2].tolist()
    return row, col
