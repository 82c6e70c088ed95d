"""From blocks whose links have prices to the map: one coarse search, and one of the region that it leaves."""

from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import Searcher
from nnpp_edge.runtime.region.links import LinkSearch
from nnpp_edge.runtime.region.looked import LookedMap
from nnpp_edge.runtime.tuning import CorridorWidth


class LinkDescent:
    """Stands in for `CoarseToFine` on a map whose links a network has priced. Serves one thread at a time."""

    def __init__(self, looked: LookedMap) -> None:
        self._looked, self._links = looked, LinkSearch(looked.shape)

    def top_for(self, query: Query) -> int:
        """There is one coarse level."""
        return 1

    def find(
        self,
        query: Query,
        work: Work,
        searcher: Searcher,
        top: int,
        region: Region | None,
        width: CorridorWidth,
        source: Source,
    ) -> Found | None:
        """As `CoarseToFine.find`."""
        prices = self._looked.prices
        work.stage_ends("look")
        band = width.band + FACTOR * width.nearby / max(query.apart, FACTOR)
        region, expanded = self._links.around(prices, query.start, query.goal, band, width.radius)
        work.expansions += expanded
        work.stage_ends("coarse")
        found = searcher.search(query, work, region)
        return None if found.status is Status.NO_PATH else Found.of(self._looked.grid, found, source, region, work)
