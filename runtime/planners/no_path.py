"""That there is no path, on a map that changes."""

import math

from nnpp_edge.runtime.map.changes import ChangeReader
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.search.workspace import Workspace


class NoPath:
    """What a search knows that found no path: all places to which ways from one end lead.

    Where the map changes, ways that lead on from there can only have opened where it did: so these
    places are searched, and not all. Serves one search at a time.

    Parameters
    ----------
    plan
        That says so.
    query
        As it was when the search began.
    memory
        Of the search; another search in it ends what is known.
    changes
        Those since the search began.
    """

    def __init__(
        self, plan: Plan, grid: Grid, query: Query, memory: Workspace, changes: ChangeReader
    ) -> None:
        self.plan = plan
        self._grid = grid
        self._memory = memory
        self._changes = changes
        self._known = self._asked(query)
        self._from_start = self._cost_at(query) == 0.0

    def holds(self, query: Query) -> bool:
        """Whether it is certain that a query has no path on the map as it is now; once False, for
        good.
        """
        grid = self._grid
        memory = self._memory
        if self._asked(query) != self._known:
            return False
        # it came to all places that can be reached from the start, or else from the goal
        inside = self._cost_at(query) == math.inf
        if self._from_start:
            inside = memory.came_to(grid.node(*query.start), query.direction)
        return inside and not any(
            change.cheaper and grid.robot.moves.may_open(grid, query, memory, change.part)
            for change in self._changes.read()
        )

    def _asked(self, query: Query) -> tuple[object, ...]:
        """The end that all places are searched for, and the number of the search in the memory."""
        return query.goal, str(query.wanted), self._memory.stamp

    def _cost_at(self, query: Query) -> float:
        """Cost of a query's start, as the search has it."""
        node = self._grid.node(*query.start)
        return float(self._memory.costs(slice(node, node + 1))[0])
