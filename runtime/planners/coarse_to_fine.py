"""Coarse to fine: each level of the pyramid is searched inside a corridor around the path on the
one above.
"""

import functools
import itertools
import math
import operator
from collections.abc import Iterator

import numpy as np

from nnpp_edge.runtime.arrays import Int64, UInt8
from nnpp_edge.runtime.cells import Cell, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.kernels.by_address import RECORD_WORDS, address_of
from nnpp_edge.runtime.kernels.corridor import close_dead_ends, descend, keep_level
from nnpp_edge.runtime.kernels.expansion import NO_HINTS, NO_LINKS, NO_REGION, expand
from nnpp_edge.runtime.kernels.nodes import EXHAUSTED, FOUND, FULL
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.records import LEVEL_AT, SPENT
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.pyramid import Level
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found
from nnpp_edge.runtime.planners.searchers import Searcher
from nnpp_edge.runtime.search.astar import Query, allowed, rule_of
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.runtime.tuning import CELLS_APART, CorridorWidth

_MOST_LEVELS = 16
"""More than a map can have."""


@functools.cache
def _expand_at() -> int:
    """Where `expand` lies in memory."""
    grid = Grid(1, 1, StepModel.of("paper"))
    rule = tuple(rule_of(grid, NO_LINKS))
    before = (grid.packed, NO_LINKS, NO_REGION, NO_HINTS, 0.0, (0, 0), rule)
    return int(address_of(expand, *before, Workspace(1).packed, (0, 0.0)))  # type: ignore[no-untyped-call]  # as all of `kernels`


class CoarseLevel:
    """Memory for searches of one coarse level, and for marking what to search on the next finer
    one. Serves one search at a time.

    The level's cells and links are read as they are when a search begins.
    """

    def __init__(self, level: Level, finer: Level) -> None:
        grid = level.grid
        nodes = len(grid.weights)
        self.level = level
        self.workspace = Workspace(nodes)
        self._flood = (  # `records.FloodMemory`
            np.empty(nodes, np.float32),
            np.zeros(nodes, np.uint8),
            np.empty(1 << (nodes - 1).bit_length(), np.int32),
        )
        self._bitmap = np.zeros((2 * grid.rows, 2 * grid.cols), np.int32)
        self._marked = np.zeros(1, np.int64)
        self._quarters = finer.quarters
        self._closed: UInt8 | None = None
        """Links that `close_dead_ends` has closed, as bits."""
        self._written: tuple[object, ...] = (None, None)
        """What the record was written from that may be another one later; it keeps these alive."""

    def keep(self, records: Int64, number: int) -> None:
        """Write this level's `records.CoarseLevel` into a row of memory, where it is not what was
        written last.
        """
        grid = self.level.grid
        now = (grid.bounds, self.workspace.entries)
        if all(map(operator.is_, now, self._written)):
            return
        price = grid.robot.price
        level = (
            (*grid.packed[:-1], price.edges(backwards=True)),
            self.level.links,
            price.edges(),
            tuple(rule_of(grid, self.level.links)),
            self.workspace.packed,
            self._flood,
            self._bitmap,
            self._marked,
            *self._quarters,
            _expand_at(),
        )
        keep_level(level, records[number])
        self._written = now

    @property
    def region(self) -> Region:
        """Where to search the next finer level, as marked last; the bitmap is overwritten by the
        next.
        """
        return Region(self._bitmap, *self._quarters, int(self._marked[0]))

    def close_dead_ends(self, region: Region, searched: Workspace, shape: Cell) -> bool:
        """Close the links that a search of a region of the map, of this shape, did not get across;
        whether any were.

        `searched` is that search's memory, of cells or of states. `open_dead_ends` opens them
        again: no more has changed until then.
        """
        _, came, _ = self._flood  # all 0
        if self._closed is None:
            self._closed = np.zeros_like(came)
        reached = (searched.meta, searched.stamp, searched.states, shape)
        links = self.level.links
        return bool(close_dead_ends(links, tuple(region), *reached, came, self._closed))

    def open_dead_ends(self) -> None:
        """Open again what was closed."""
        if self._closed is not None:
            self.level.links |= self._closed
            self._closed = None


class CoarseToFine:
    """Searches of a map's coarse levels; `finest` is memory of those at full resolution.

    Coarse levels can only guess where a vehicle's poses pass. A region without a path shows, at the
    price of many checks, where they do not: links from what its search reached to what it did not
    are closed, and the first coarse level is searched again. Poses that have been checked cost
    nothing the second time.
    """

    def __init__(self, state: MapState, finest: Workspace) -> None:
        self._state = state
        self._finest = finest
        self.coarse_levels: list[CoarseLevel] = []
        """The searched levels above the map itself, finest first; from the first `update` on."""
        self._records = np.empty((_MOST_LEVELS, RECORD_WORDS), np.int64)
        self._moves = state.grid.robot.moves

    def update(self, deadline: Deadline = NEVER) -> list[Level]:
        """The levels as the map is now, finest first; OutOfTimeError at the deadline."""
        levels = self._state.pyramid_by(deadline).levels
        if not self.coarse_levels:
            pairs = itertools.pairwise(levels)
            self.coarse_levels = [CoarseLevel(level, finer) for finer, level in pairs]
        return levels

    def workspace(self, number: int) -> Workspace:
        """Memory of the searches of the level of that number; 0 is the map itself."""
        return self.coarse_levels[number - 1].workspace if number else self._finest

    def top_for(self, query: Query) -> int:
        """The level to begin at: where start and goal are close, a finer one than the coarsest."""
        number = min(self._moves.most_levels, len(self.coarse_levels))
        while number > 1 and query.apart < CELLS_APART * FACTOR**number:
            number -= 1
        return number

    def corridor(
        self, query: Query, work: Work, top: int, region: Region | None, width: CorridorWidth
    ) -> Region | None:
        """Where to look on the map: from level `top` down around the path on the one above; None
        without a way. OutOfTimeError at the deadline.
        """
        if not top:
            return region
        deadline = query.deadline
        apart = max(query.apart, FACTOR)
        band = width.band * min(math.sqrt(self._moves.band_up_to / apart), 1.0)
        band += FACTOR * width.nearby / apart
        wide = (width.radius, band, width.coarse_radius, width.coarse_band)  # `records.Width`
        at = np.array((top, top, 0, 0))  # `records.TOP` and the others
        while True:
            for number, coarse in enumerate(self.coarse_levels[:top]):
                coarse.keep(self._records, number)
            code = descend(
                self._records,
                query.start,
                query.goal,
                allowed(region),
                wide,
                deadline.until,
                deadline.at,
                at,
            )
            if code in (FOUND, EXHAUSTED) or not deadline.goes_on():
                break
            if code == FULL:
                self.workspace(at[LEVEL_AT]).grow()
        work.stage_ends("coarse", int(at[SPENT]))
        if code == EXHAUSTED:
            return None
        if code != FOUND or deadline.passed:  # a coarse path leads nowhere on the map
            raise OutOfTimeError
        found = self.coarse_levels[0].region
        by_heading = (query.start, query.direction >= 0), (query.goal, query.wanted is not None)
        for end, has_heading in by_heading:
            if has_heading:
                found.add(widened((*end, 1, 1), self._moves.swing, self._state.shape))
        return found

    def find(
        self,
        query: Query,
        work: Work,
        searcher: Searcher,
        top: int | None,
        region: Region | None,
        width: CorridorWidth,
        source: Source,
    ) -> Found | None:
        """A path, from level `top` down to the map, on which `searcher` looks for it, or that its
        region holds none; None where no coarse path leads.

        `region` is where to look on level `top`, None for all of a coarse level; without `top` it
        begins where that suits the query. A vehicle's links are corrected meanwhile, as often as it
        pays. OutOfTimeError where time was up before the search at full resolution.
        """
        self.update(query.deadline)
        if top is None:
            top = self.top_for(query)
        coarse = self.coarse_levels[0]
        try:
            for left in reversed(range(self._moves.corridor_tries)):
                if (inside := self.corridor(query, work, top, region, width)) is None:
                    break
                search = searcher.search(query, work, inside)
                dead_end = search.exhausted if search.refused_f < math.inf else None
                if (
                    not left
                    or dead_end is None
                    or not coarse.close_dead_ends(inside, dead_end, self._state.shape)
                ):
                    return Found.of(self._state.grid, search, source, inside)
                work.stage_ends("coarse")
            return None
        finally:
            coarse.open_dead_ends()

    def corridors(
        self,
        query: Query,
        work: Work,
        searcher: Searcher,
        widths: tuple[CorridorWidth, CorridorWidth] | None = None,
    ) -> Iterator[Found]:
        """What is found in corridors, each wider than the one before; none where no coarse path
        leads.
        """
        moves = self._moves
        by_default = moves.corridors if query.wanted is None else moves.corridors_to_heading
        widths = widths or by_default
        for width, source in zip(widths, (Source.REGION, Source.WIDENED), strict=True):
            found = self.find(query, work, searcher, None, None, width, source)
            if found is not None:
                yield found

    def touch(self) -> None:
        """Have the system back all arrays with memory now."""
        for level in self.update():
            touch(level, level.grid)
        for coarse in self.coarse_levels:
            touch(coarse, coarse.workspace)
