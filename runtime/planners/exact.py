"""Exact planning: A* over the whole map, or D* Lite."""

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import AStarSearcher
from nnpp_edge.runtime.search.dstar_lite import DStarLite, serves
from nnpp_edge.runtime.tuning import BRIEF_EXPANSIONS


class ExactPlanner:
    """A* over the whole map, afresh for each query.

    Parameters
    ----------
    searcher : AStarSearcher
        Of the map.
    """

    def __init__(self, searcher: AStarSearcher) -> None:
        self._searcher = searcher

    def find(self, query: Query, work: Work, source: Source = Source.MAP) -> Found:
        """The optimal path; `source` says why the whole map was searched."""
        work.remark = ""
        return Found.of(self._searcher.grid, self._searcher.search(query, work, None), source, None, work)

    def find_briefly(self, query: Query, work: Work) -> Found | None:
        """The optimal path; None where the way to the goal turns out too long for its distance."""
        limit = BRIEF_EXPANSIONS + 2 * query.apart**2
        found = self._searcher.search(query, work, None, limit=limit)
        if found.status is Status.TIMEOUT:
            return None
        return Found.of(self._searcher.grid, found, Source.MAP, None, work)


class MendingExactPlanner:
    """D* Lite over the whole map, mended from one query to the next.

    Parameters
    ----------
    state : MapState
        The map.
    exact : ExactPlanner
        Asked where steps cost too differently for D* Lite.
    """

    def __init__(self, state: MapState, exact: ExactPlanner) -> None:
        self._state, self._exact = state, exact
        self._dstar: DStarLite | None = None

    def prepare(self, goal: Cell) -> None:
        """Set D* Lite up for queries to this goal, all of its memory backed by the system."""
        self._dstar = self._dstar or DStarLite(self._state, goal)
        self._dstar.touch()
        self._dstar.read()

    def find(self, query: Query, work: Work) -> Found:
        """The optimal path."""
        if not serves(self._state.grid):
            return self._exact.find(query, work)
        if self._dstar is None:
            self._dstar = DStarLite(self._state, query.goal)
        elif self._dstar.goal != query.goal:
            self._dstar.set_goal(query.goal)
        found = self._dstar.plan(query.start, deadline=query.deadline)
        work.expansions += found.expansions
        work.stage_ends("search")
        return Found.of(self._state.grid, found, Source.MAP, None, work)
