"""The corridor planner: coarse to fine over the mean costs of blocks of cells, without a network."""

from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.planners.exact import ExactPlanner
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import Searcher
from nnpp_edge.runtime.tuning import CORRIDOR, WIDENED_CORRIDOR, CorridorWidth


class CorridorPlanner:
    """Searches a corridor around the coarse path, then a wider one, then the whole map.

    Parameters
    ----------
    coarse_to_fine : CoarseToFine
        Searches the coarse levels.
    searcher : Searcher
        Searches the corridor at full resolution.
    exact : ExactPlanner
        Searches the whole map where both corridors fail.
    widths : (CorridorWidth, CorridorWidth)
        Of the first corridor and of the wider one.
    """

    def __init__(
        self,
        coarse_to_fine: CoarseToFine,
        searcher: Searcher,
        exact: ExactPlanner,
        widths: tuple[CorridorWidth, CorridorWidth] = (CORRIDOR, WIDENED_CORRIDOR),
    ) -> None:
        self._coarse_to_fine, self._searcher, self._exact, self._widths = coarse_to_fine, searcher, exact, widths

    def find(self, query: Query, work: Work) -> Found:
        """A path, good enough for the query."""
        descent = self._coarse_to_fine
        for width, source in zip(self._widths, (Source.REGION, Source.WIDENED), strict=True):
            top = descent.top_for(query)
            found = descent.find(query, work, self._searcher, top, None, width, source)
            if found is not None and found.suffices(query):
                return found
        return self._exact.find(query, work, Source.FALLBACK)
