"""That there is no path, on a map that changes."""

import math

from nnpp_edge.runtime.map.changes import Change, ChangeReader
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.search.workspace import Workspace


class NoPath:
    """What a search knows that found no path: all places to which ways from one end lead.

    Where the map changes, ways that lead on from there can only have opened where it did: so these
    places are searched, and not all. Serves one search at a time.

    Parameters
    ----------
    query
        As it was when the search began.
    memory
        Of the search; another search in it ends what is known.
    changes
        Those since the search began.
    """

    def __init__(self, grid: Grid, query: Query, memory: Workspace, changes: ChangeReader) -> None:
        self._grid = grid
        self._query = query
        self._memory = memory
        self._stamp = memory.stamp
        self._changes = changes
        self._from_start = self._cost_at(query) == 0.0
        self._holds = True

    def holds(self, query: Query) -> bool:
        """Whether it is certain that a query has no path on the map as it is now."""
        memory = self._memory
        before = self._query
        same_goal = query.goal == before.goal and str(query.wanted) == str(before.wanted)
        if not (self._holds and same_goal and memory.stamp == self._stamp):
            return False
        if self._from_start:  # it came to all places that can be reached from there
            inside = memory.came_to(self._grid.node(*query.start), query.direction)
        else:
            inside = self._cost_at(query) == math.inf
        return inside and not any(self._may_open(change, query) for change in self._changes.read())

    def _may_open(self, change: Change, query: Query) -> bool:
        grid = self._grid
        opens = change.cheaper and grid.robot.moves.may_open(grid, query, self._memory, change.part)
        self._holds = self._holds and not opens
        return opens

    def _cost_at(self, query: Query) -> float:
        """Cost of a query's start, as the search has it."""
        node = self._grid.node(*query.start)
        return float(self._memory.costs(slice(node, node + 1))[0])
