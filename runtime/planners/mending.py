"""D* Lite in regions, kept from one query to the next."""

import math

import numpy as np

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import OutOfTimeError
from nnpp_edge.runtime.kernels.nodes import octile
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.pyramid import quarters
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.planners.query import Work
from nnpp_edge.runtime.planners.searchers import AStarSearcher
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.search.dstar_lite import DStarLite, serves
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.tuning import MOST_JOINED

_FOR_READING = 0.25
"""Share of the time left that D* Lite may take to read the map before the region is searched
afresh.
"""


class MendingSearcher:
    """D* Lite in regions, kept from one query to the next: the paper's D*NN, in any region.

    Worth it for queries towards one goal: another goal starts D* Lite afresh. A* searches where
    steps cost too differently for D* Lite, and where a new region takes it too long to read. Serves
    one thread at a time.
    """

    def __init__(self, state: MapState, fresh: AStarSearcher) -> None:
        self._state = state
        self._fresh = fresh
        self._dstar: DStarLite | None = None
        self._known: Region | None = None
        """Where D* Lite has searched; None where it has forgotten all."""

    def prepare(self, goal: Cell) -> None:
        """Do now what the first query to this goal would else do, all of the memory backed by the
        system.
        """
        dstar = self._towards(goal)
        touch(dstar.memory)
        dstar.plan(goal)  # so that the cells left out are dealt with now

    def search(self, query: Query, work: Work, region: Region) -> Search:
        """As `Searcher`."""
        if not serves(self._state.grid) or query.start == query.goal:
            return self._fresh.search(query, work, region)
        dstar = self._towards(query.goal)
        dstar.move_start(query.start)
        self._known = self._joined(region)
        dstar.set_region(self._known)
        try:
            dstar.read(query.deadline.share(_FOR_READING))
        except OutOfTimeError:  # the next query's search goes on reading
            return self._fresh.search(query, work, region)
        found = dstar.plan(query.start, deadline=query.deadline)
        work.searched(found)
        # D* Lite does not say what it refused: the octile distance is the bound
        straight = octile.py_func(*query.start, *query.goal, *self._state.grid.prices)
        return found._replace(refused_f=straight)

    def _towards(self, goal: Cell) -> DStarLite:
        """D* Lite with this goal; for a new one its region holds nothing yet."""
        if self._dstar is not None and self._dstar.goal == goal:
            return self._dstar
        rows, cols = self._state.shape
        blocks = [2 * math.ceil(cells / FACTOR) for cells in (rows, cols)]
        nothing = Region(np.zeros(blocks, np.int32), quarters(rows), quarters(cols), 1)
        self._known = None
        if self._dstar is None:
            self._dstar = DStarLite(self._state, goal, nothing)
        else:
            self._dstar.set_goal(goal)
            self._dstar.set_region(nothing)
        return self._dstar

    def _joined(self, region: Region) -> Region:
        """The region together with the last one: to D* Lite, cells that leave are much work, and
        stay for nothing.
        """
        wanted = region.blocks()
        known = self._known
        both = wanted | known.blocks() if known and region.shares_blocks(known) else wanted
        if np.count_nonzero(both) > MOST_JOINED * np.count_nonzero(wanted):
            both = wanted
        return Region(both.astype(np.int32), region.row_block, region.col_block, 1)
