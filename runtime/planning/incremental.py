"""A planner whose regions are searched by D* Lite, mended from one query to the next."""

import math

import numpy as np

from nnpp_edge.runtime.costmap import Float2D
from nnpp_edge.runtime.encoding import Cell
from nnpp_edge.runtime.planning.astar import Region, Search, prices
from nnpp_edge.runtime.planning.dstar_lite import DStarLite
from nnpp_edge.runtime.planning.expansion import octile
from nnpp_edge.runtime.planning.plan import Method, Plan, Source
from nnpp_edge.runtime.planning.planner import Planner
from nnpp_edge.runtime.planning.pyramid import FACTOR
from nnpp_edge.runtime.planning.query import Query

_MOST_JOINED = 3
"""Regions are joined as long as they hold at most so many times the blocks of the newest."""


class DStarPlanner(Planner):
    """A planner that can search its regions by D* Lite, which it keeps from one query to the next.

    Coarse levels and the whole map are searched afresh. Worth it for queries towards one goal: another goal
    starts D* Lite afresh.
    """

    incremental = False
    """Whether regions are searched by D* Lite; else by A*."""
    _dstar: DStarLite | None = None

    def update(self, row: int, col: int, patch: Float2D) -> None:
        """As `Planner.update`; D* Lite takes note."""
        super().update(row, col, patch)
        if self._dstar is not None:
            self._dstar.cells_changed(row, col, *patch.shape)

    def expect(self, goal: Cell) -> None:
        """Set D* Lite up for queries to this goal, in a region that holds nothing yet."""
        if self._dstar is None:
            self._dstar = DStarLite(self.grid, goal, corner_cutting=self.corner_cutting)
        elif self._dstar.goal != goal:
            self._dstar.set_goal(goal)
        corridor = (2 * math.ceil(self.grid.rows / FACTOR), 2 * math.ceil(self.grid.cols / FACTOR))
        self._known = Region(np.zeros(corridor, np.int32), *self.pyramid.levels[0].quarters)
        self._dstar.set_region(self._known)
        self._dstar.plan(goal)  # so that the cells left out are dealt with now

    def mends(self, goal: Cell) -> bool:
        """Whether there is a search to be mended, for this goal."""
        return self._dstar is not None and self._dstar.goal == goal and bool(self._known.bitmap.any())

    def mend(self, query: Query) -> Plan:
        """Search the region that D* Lite knows again, from another start and on the map as it is now."""
        return self._answer(query, Method.CORRIDOR, Source.REGION, self._in_region(query), None)

    def _search(self, query: Query, level: int, region: Region | None, band: float = 0.0) -> Search:
        if level or region is None or not self.incremental or query.start == query.goal:
            return super()._search(query, level, region, band)
        if self._dstar is None or self._dstar.goal != query.goal:
            self.expect(query.goal)
        assert self._dstar is not None
        self._dstar.move_start(query.start)
        self._known = self._joined(region)
        self._dstar.set_region(self._known)
        return self._in_region(query)

    def _joined(self, region: Region) -> Region:
        """The region together with the last one: to D* Lite, cells that leave are much work, and stay for nothing."""
        wanted, known = region.bitmap == region.stamp, self._known
        same = wanted.shape == known.bitmap.shape and region.row_block is known.row_block
        both = wanted | (known.bitmap != 0) if same else wanted
        if np.count_nonzero(both) > _MOST_JOINED * np.count_nonzero(wanted):
            both = wanted
        return Region(both.astype(np.int32), region.row_block, region.col_block)

    def _in_region(self, query: Query) -> Search:
        assert self._dstar is not None
        found = self._dstar.plan(query.start, deadline=query.deadline, cancelled=query.cancelled)
        query.expansions += found.expansions
        query.lap("search")
        # D* Lite does not say what it refused: the octile distance is the bound
        straight = octile.py_func(*query.start, *query.goal, *prices(self.grid))
        return Search(found.status, found.path, found.expansions, straight)
