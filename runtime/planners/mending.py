"""D* Lite, kept from one query to the next: over the whole map, or in regions."""

import numpy as np

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.kernels.nodes import octile
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.planners.searchers import AStarSearcher
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.search.dstar_lite import DStarLite, serves
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import MOST_JOINED


class MendingSearcher:
    """D* Lite, kept from one query to the next: in regions the paper's D*NN, in any region.

    Worth it for queries towards one goal: another goal starts D* Lite afresh. A* searches where
    steps cost too differently for D* Lite. Serves one thread at a time.
    """

    def __init__(self, state: MapState, fresh: AStarSearcher) -> None:
        self._state = state
        self._fresh = fresh
        self._dstar: DStarLite | None = None

    def prepare(self, goal: Cell) -> None:
        """Do now what the first query to this goal would else do, all of the memory backed by the
        system.
        """
        self._state.grid.complete()
        self._dstar = DStarLite(self._state, goal)
        touch(self._dstar)

    def search(self, query: Query, work: Work, region: Region | None) -> Search:
        """As `Searcher`; without a region over the whole map."""
        if not serves(self._state.grid):
            return self._fresh.search(query, work, region)
        if self._dstar is None:
            self._dstar = DStarLite(self._state, query.goal, region)
        elif self._dstar.goal != query.goal:
            self._dstar.set_goal(query.goal, region)
        elif region is not None:
            self._dstar.set_region(_joined(region, self._dstar.region))
        found = self._dstar.plan(query.start, deadline=query.deadline)
        work.stage_ends("search", found.expansions)
        if region is None:
            return found
        # D* Lite does not say what it refused: the octile distance is the bound
        straight = octile.py_func(*query.start, *query.goal, *self._state.grid.prices)
        return found._replace(refused_f=straight)


def _joined(region: Region, known: Region) -> Region:
    """The region together with the last one: to D* Lite, cells that leave are much work, and stay
    for nothing.
    """
    if not region.shares_blocks(known):
        return region
    wanted = region.blocks()
    both = wanted | known.blocks()
    if np.count_nonzero(both) > MOST_JOINED * np.count_nonzero(wanted):
        both = wanted
    return Region(both.astype(np.int32), region.row_block, region.col_block, 1)
