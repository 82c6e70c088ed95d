"""The costs to go of cells that guided one search of a body's states, kept for the next."""

import math
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arrays import Int32
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.kernels.lattice import DIRECTION_COUNT
from nnpp_edge.runtime.kernels.nodes import FOUND, octile
from nnpp_edge.runtime.robots.body.search import (
    Guide,
    by_field,
    filled,
    goal_alone,
    octile_cost,
    turns_in_field,
)
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import FIELD_KEPT

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.changes import ChangeLog
    from nnpp_edge.runtime.map.grid import Grid

Goal = tuple[Cell, bytes | None]
"""A cell, and in which of the directions it may be arrived at."""


class KeptField:
    """The field of the last search that was worth keeping: it guides the next one to the same goal,
    for an answer about as good.

    What is driven is checked on the map as it is, and the field is dropped once much of the map has
    changed. `workspace` is the search's memory.
    """

    def __init__(self, grid: "Grid", workspace: Workspace, log: "ChangeLog") -> None:
        self._grid = grid
        self._workspace = workspace
        self._log = log
        self._changes = log.reader()
        self._goal: Goal | None = None
        self._region: Region | None = None
        self._stamp = 0
        self._begun: Cell = (0, 0)
        self._promised = math.inf
        self._turns = np.empty((0, DIRECTION_COUNT), np.float32)
        self.above = 1.0
        """Cost of the path that was found by it, over what it promised."""
        self.extra = 0.0
        """By how much it cost more."""

    def keep(self, query: Query, region: Region | None, search: Search, cost: float) -> None:
        """Keep the field of a search that has just found a path of this cost; at the goal itself
        there was none.
        """
        if search.promised == math.inf:
            return
        self._goal = _goal_of(query)
        self._region = None if region is None else region.copy()
        self._turns = turns_in_field(self._grid, query, region)
        self._is_new(query, search.promised)
        self.above = cost / search.promised
        self.extra = cost - search.promised

    def refill(self, query: Query) -> int:
        """Fill the field anew, on the map as it is, where it last led to a path to the goal: the
        expansions.
        """
        field = self._workspace.field
        if field is None or _goal_of(query) != self._goal:
            return 0
        place = (field, self._region, self._turns)
        code, spent, _ = filled(self._grid, query, *place, goal_alone(self._grid, query))
        self._goal = None
        if code == FOUND:
            self._goal = _goal_of(query)
            self._is_new(query, float(field.g[2 * self._grid.node(*query.start)]))
        return int(spent)

    def _is_new(self, query: Query, promised: float) -> None:
        """The field was filled just now, and has this cost from the start."""
        assert self._workspace.field is not None
        self._stamp = self._workspace.field.stamp
        self._begun = query.start
        self._promised = promised
        self._changes = self._log.reader()

    def cost_from(self, query: Query) -> float:
        """Least cost from start to goal by the field; inf to another goal, or where it is out of
        date.
        """
        field = self._workspace.field
        grid = self._grid
        if field is None or (_goal_of(query), field.stamp) != (self._goal, self._stamp):
            return math.inf
        if sum(change.cells for change in self._changes.peek()) > FIELD_KEPT * grid.cells:
            return math.inf
        node = grid.node(*query.start)
        known = float(field.costs(slice(node, node + 1))[0])
        if known < math.inf:
            return known
        return self._promised - float(octile.py_func(*query.start, *self._begun, *grid.prices))

    def search(self, query: Query, state: Int32, limit: int) -> Search:
        """A path by the field, where `cost_from` is known, to a state (row, col, number) on the way
        to the goal; at the `limit` of expansions the best path so far counts.
        """
        grid = self._grid
        row, col, number = state.tolist()
        wanted = np.arange(self._workspace.states) == number
        query = query._replace(goal=(row, col), wanted=wanted)
        guide = Guide(grid.node(*self._begun), self._promised, self._turns)
        place = (self._workspace, self._region)
        found = by_field(grid, query, *place, guide, limit, best_so_far=True)
        return found._replace(refused_f=octile_cost(grid, query))


def _goal_of(query: Query) -> Goal:
    return query.goal, None if query.wanted is None else query.wanted.tobytes()
