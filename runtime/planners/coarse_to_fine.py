"""Coarse to fine: each level of the pyramid is searched inside a corridor around the path on the
one above.
"""

import math
from collections.abc import Iterator

import numpy as np

from nnpp_edge.runtime.arrays import UInt8
from nnpp_edge.runtime.cells import Cell, coarser, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.corridor import close_dead_ends, surround
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.pyramid import Level
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found
from nnpp_edge.runtime.planners.searchers import Searcher
from nnpp_edge.runtime.search.astar import Query, Search, astar
from nnpp_edge.runtime.search.landmarks import Landmarks
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import (
    CELLS_APART,
    LANDMARK_PATIENCE,
    LEVEL_LANDMARKS,
    MOST_CELLS_FOR_LANDMARKS,
    CorridorWidth,
)


class CoarseLevel:
    """Scratch memory and landmarks for searches of one coarse level. Serves one search at a time.

    The level's cells and links are read as they are when a search begins.
    """

    def __init__(self, level: Level) -> None:
        nodes = len(level.grid.weights)
        grid = level.grid
        self.level = level
        self.grid = grid
        self.workspace = Workspace(nodes)
        self.landmarks: Landmarks | None = None
        """Of the level as it was at `_version`."""
        self._version = level.version
        self._spent = 0.0
        self._reached = np.empty(nodes, np.float32)
        self._queued = np.zeros(nodes, np.uint8)
        self._queue = np.empty(1 << (nodes - 1).bit_length(), np.int32)
        self._bitmaps = np.zeros((2, 2 * grid.rows, 2 * grid.cols), np.int32)
        self._stamp = 0
        self._closed: UInt8 | None = None
        """Links that `close_dead_ends` has closed, as bits."""

    def search(
        self,
        start: Cell,
        goal: Cell,
        region: Region | None,
        *,
        beyond: float,
        deadline: Deadline = NEVER,
    ) -> Search:
        """`astar` on this level from a query's goal to its start, by landmarks where all of it is
        searched.

        Directed steps are taken backwards, and have no landmarks. Else searches of a whole level
        get them, one at a time, once they have expanded as many cells as this takes: so a map that
        is searched often is answered faster, and one that changes loses little.
        """
        if self._version != self.level.version:
            self.landmarks = None
            self._version = self.level.version
            self._spent = 0.0
        grid = self.grid
        back = grid.robot.price.edges() is not None
        hints = None
        if region is None and self.landmarks is not None and self._spent < 0.0:
            hints = self.landmarks.towards(goal)
        place = (grid, start, goal, self.workspace, region)
        found = astar(
            *place,
            links=self.level.links,
            hints=hints,
            backwards=back,
            beyond=beyond,
            deadline=deadline,
        )
        if region is None and not back and grid.cells <= MOST_CELLS_FOR_LANDMARKS:
            self._spent += found.expansions
        return found

    def invest(self) -> None:
        """Set another landmark if enough work has been spent without; what the last search found is
        overwritten.
        """
        if self._closed is not None or self._spent < LANDMARK_PATIENCE * self.grid.cells:
            return
        self.landmarks = self.landmarks or Landmarks(self.grid, self.workspace, self.level.links)
        count = len(self.landmarks.cells)
        self.landmarks.spread(count + 1)
        found = len(self.landmarks.cells)
        if found in (count, LEVEL_LANDMARKS):
            self._spent = -math.inf
        if found == count:  # there is no place for all, and fewer are slower than none
            self.landmarks = None

    def close_dead_ends(self, region: Region, searched: Workspace, shape: Cell) -> bool:
        """Close the links that a search of a region of the map, of this shape, did not get across;
        whether any were.

        `searched` is that search's memory, of cells or of states. `open_dead_ends` opens them
        again: no more has changed until then.
        """
        if self._closed is None:
            self._closed = np.zeros(len(self._queued), np.uint8)
        marks = (region.bitmap, region.stamp)  # `records.Marks`
        reached = (searched.meta, searched.stamp, searched.states, shape)
        links = self.level.links
        return bool(close_dead_ends(links, marks, *reached, self._queued, self._closed))

    def open_dead_ends(self) -> None:
        """Open again what was closed."""
        if self._closed is not None:
            self.level.links |= self._closed
            self._closed = None

    def around(
        self,
        found: Search,
        start: Cell,
        radius: int,
        band: float,
        finer: Level,
        finer_workspace: Workspace,
        deadline: Deadline = NEVER,
    ) -> Region:
        """Where to search the next finer level, around what the last search here found, from the
        goal to `start`.

        In it are cells within `radius` quarters of the path's, and those on paths that cost at most
        1 + `band` times as much, which the search settled. Its bitmap is overwritten by the call
        after the next. OutOfTimeError at the deadline.
        """
        self._stamp += 1
        bitmap = self._bitmaps[self._stamp % 2]
        ws = self.workspace
        below = finer.grid
        grid = self.grid
        surround(
            grid.packed,
            grid.robot.price.edges(),
            self.level.links,
            grid.node(*start),
            (ws.g, ws.meta, ws.stamp),  # `records.Searched`
            (self._reached, self._queued, self._queue),  # `records.FloodMemory`
            found.path,
            (radius, band, deadline.at),  # `records.Width`
            (bitmap, self._stamp),  # `records.Marks`
            # `records.FinerLevel`
            (below.weights, below.stride, below.rows, below.cols, finer_workspace.meta),
        )
        deadline.check()
        return Region(bitmap, *finer.quarters, self._stamp)


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
        self._levels: list[Level] = []
        self.coarse_levels: list[CoarseLevel] = []
        """The searched levels above the map itself, finest first; from the first `update` on."""
        self._moves = state.grid.robot.moves

    def update(self, deadline: Deadline = NEVER) -> list[Level]:
        """The levels as the map is now, finest first; OutOfTimeError at the deadline."""
        self._levels = self._state.pyramid_by(deadline).levels
        if not self.coarse_levels:
            self.coarse_levels = [CoarseLevel(level) for level in self._levels[1:]]
        return self._levels

    def workspace(self, number: int) -> Workspace:
        """Memory of the searches of the level of that number; 0 is the map itself."""
        return self.coarse_levels[number - 1].workspace if number else self._finest

    def top_for(self, query: Query) -> int:
        """The level to begin at: where start and goal are close, a finer one than the coarsest."""
        number = min(self._moves.most_levels, len(self.coarse_levels))
        while number > 1 and query.apart < CELLS_APART * FACTOR**number:
            number -= 1
        return number

    def _descend(
        self, query: Query, work: Work, top: int, region: Region | None, width: CorridorWidth
    ) -> Region | None:
        """Where to look on the map: from level `top` down around the path on the one above; None
        without a way.
        """
        for number in range(top, 0, -1):
            coarse = self.coarse_levels[number - 1]
            radius = width.radius
            band = width.band
            if query.apart > self._moves.band_up_to:
                band *= math.sqrt(self._moves.band_up_to / query.apart)
            band += FACTOR * width.nearby / max(query.apart, FACTOR)
            if number > 1:
                radius = radius + width.coarse_radius
                band = band + width.coarse_band
            start = coarser(query.start, FACTOR**number)
            goal = coarser(query.goal, FACTOR**number)
            found = coarse.search(goal, start, region, beyond=band, deadline=query.deadline)
            work.expansions += found.expansions
            work.stage_ends("coarse")
            if found.status is Status.NO_PATH:
                return None
            if found.status is Status.TIMEOUT:  # a coarse path leads nowhere on the map
                raise OutOfTimeError
            finer = self._levels[number - 1]
            memory = self.workspace(number - 1)
            region = coarse.around(found, start, radius, band, finer, memory, query.deadline)
            coarse.invest()
            work.stage_ends("coarse")
        ends = (query.start, query.direction >= 0), (query.goal, query.wanted is not None)
        for end, has_heading in ends:
            if region is not None and has_heading:
                region.add(widened((*end, 1, 1), self._moves.swing, self._state.shape))
        return region

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
                if (inside := self._descend(query, work, top, region, width)) is None:
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
