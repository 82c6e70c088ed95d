"""The planner of the paper: a network says where the optimal path runs, and a search looks only there."""

from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.planners.exact import ExactPlanner
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import Searcher
from nnpp_edge.runtime.region.learned import LearnedRegions
from nnpp_edge.runtime.tuning import LEARNED_CORRIDOR, NEAR, REFINE_FROM, CorridorWidth


class LearnedPlanner:
    """Searches the network's region, then a wider one, then the whole map.

    Parameters
    ----------
    state : MapState
        The map.
    regions : LearnedRegions
        The network's regions.
    coarse_to_fine : CoarseToFine
        Searches the coarse levels.
    searcher : Searcher
        Searches inside the regions at full resolution.
    exact : ExactPlanner
        Finds near goals, and searches the whole map where all regions fail.
    network_from : int
        Cells between start and goal from which on the network is asked. Nearer goals A* has mostly found before
        the network has answered, and is tried first.
    width : CorridorWidth
        Of the corridors inside a region that is searched coarsely first.
    """

    def __init__(
        self,
        state: MapState,
        regions: LearnedRegions,
        coarse_to_fine: CoarseToFine,
        searcher: Searcher,
        exact: ExactPlanner,
        network_from: int = NEAR,
        width: CorridorWidth = LEARNED_CORRIDOR,
    ) -> None:
        self._state, self._regions, self._coarse_to_fine = state, regions, coarse_to_fine
        self._searcher, self._exact, self._network_from, self._width = searcher, exact, network_from, width
        self._top = len(coarse_to_fine.coarse_levels) if max(state.shape) >= REFINE_FROM else 0
        """Number of the level that a learned region is searched on first."""

    def find(self, query: Query, work: Work) -> Found:
        """A path, good enough for the query.

        Raises
        ------
        ModelError
            The network cannot be loaded.
        """
        if query.apart < self._network_from and (found := self._exact.find_briefly(query, work)) is not None:
            return found
        top, descent, deadline = self._top, self._coarse_to_fine, query.deadline
        level, memory = self._state.pyramid_by(deadline).levels[top], descent.workspace(top)
        answer, regions = self._regions.regions(query.start, query.goal, level, top, memory, work, deadline)
        for number, region in enumerate(regions):
            source = Source.WIDENED if number else Source.REGION
            found = descent.find(query, work, self._searcher, top, region, self._width, source)
            if found is not None and found.suffices(query):
                return found.by_network(answer.threshold, answer.region)
        return self._exact.find(query, work, Source.FALLBACK).by_network(answer.threshold, answer.region)

    def prepare(self) -> None:
        """Load the network and show it the map now; ModelError if it cannot be loaded."""
        self._regions.prepare(self._state.pyramid.levels[self._top], self._top)
