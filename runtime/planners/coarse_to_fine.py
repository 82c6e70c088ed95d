"""Coarse to fine: each level of the pyramid is searched inside a corridor around the path on the one above."""

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import OutOfTimeError
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.streamed import StreamedMap
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import AStarSearcher, Searcher
from nnpp_edge.runtime.region.corridor import CoarseLevel
from nnpp_edge.runtime.search.astar import Search
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import CELLS_APART, MOST_CORRECTIONS, CorridorWidth


class CoarseToFine:
    """Searches of a map's coarse levels; `finest` is memory of those at full resolution, which `descend` is given.

    Coarse levels can only guess where a vehicle's poses pass. A region without a path shows, at the price of many
    checks, where they do not: links from what its search reached to what it did not are closed, and the first coarse
    level is searched again. Poses that have been checked cost nothing the second time.
    """

    def __init__(self, state: MapState | StreamedMap, finest: Workspace) -> None:
        self._state, self._finest = state, finest
        self._levels = state.pyramid.levels
        self._coarse = [CoarseLevel(level) for level in self._levels[1:]]
        self._corrects = state.grid.steps.by_poses
        self._last: Region | None = None
        """Where the last descent let the map itself be searched."""

    @property
    def coarse_levels(self) -> list[CoarseLevel]:
        """The searched levels above the map itself, finest first."""
        return self._coarse

    def workspace(self, number: int) -> Workspace:
        """Memory of the searches of the level of that number; 0 is the map itself."""
        return self._coarse[number - 1].workspace if number else self._finest

    def top_for(self, query: Query) -> int:
        """The level to begin at: where start and goal are close, a finer one than the coarsest."""
        number = 1 if self._corrects else len(self._coarse)
        while number > 1 and query.apart < CELLS_APART * FACTOR**number:
            number -= 1
        return number

    def descend(
        self, query: Query, work: Work, searcher: Searcher, top: int, region: Region | None, width: CorridorWidth
    ) -> tuple[Search, Region] | None:
        """From level `top` down to the map, each level inside a corridor around the path on the one above.

        `searcher` looks on the map itself; `region` is where to look on level `top`, None for all of a coarse level.
        The search at full resolution, and where it was allowed to go; None where a level or the region holds no way.
        OutOfTimeError where time was up before that.
        """
        self._levels = self._state.pyramid_by(query.deadline).levels  # brought up to date
        for number in range(top, 0, -1):
            coarse, (radius, band) = self._coarse[number - 1], _margins(query, number, width)
            start, goal = _at_level(query.start, number), _at_level(query.goal, number)
            found = coarse.search(goal, start, region, beyond=band, deadline=query.deadline)
            work.expansions += found.expansions
            work.stage_ends("coarse")
            if found.status is Status.NO_PATH:
                return None
            if found.status is Status.TIMEOUT:  # a coarse path leads nowhere on the map
                raise OutOfTimeError
            finer, memory = self._levels[number - 1], self.workspace(number - 1)
            region = coarse.around(found, start, radius, band, finer, memory, query.deadline)
            coarse.invest()
            work.stage_ends("coarse")
        assert region is not None
        self._last = region
        found = searcher.search(query, work, region)
        return None if found.status is Status.NO_PATH else (found, region)

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
        """As `descend`; what was found, or None where there is no way.

        A vehicle's links are corrected meanwhile, as often as it pays.
        """
        coarse, self._last = self._coarse[0], None
        try:
            for left in reversed(range(MOST_CORRECTIONS if self._corrects else 1)):
                descent = self.descend(query, work, searcher, top, region, width)
                if descent is not None:
                    return Found.of(self._state.grid, descent[0], source, descent[1], work)
                if not left or self._last is None or not isinstance(searcher, AStarSearcher):
                    break
                if not coarse.close_dead_ends(self._last, self._finest, self._state.shape):
                    break
                work.stage_ends("coarse")
            return None
        finally:
            coarse.open_dead_ends()

    def touch(self) -> None:
        """Have the system back all arrays with memory now."""
        for level in self._levels:
            touch(level, level.grid)
        for coarse in self._coarse:
            touch(coarse, coarse.workspace)


def _at_level(cell: Cell, number: int) -> Cell:
    """The coarse cell that holds a cell of the map."""
    factor = FACTOR**number
    return cell[0] // factor, cell[1] // factor


def _margins(query: Query, number: int, width: CorridorWidth) -> tuple[int, float]:
    """Radius and band of the corridor that a level of that number leaves to the next finer one."""
    band = width.band + FACTOR * width.nearby / max(query.apart, FACTOR)
    if number == 1:
        return width.radius, band
    return width.radius + width.coarse_radius, band + width.coarse_band
