"""Searches of one coarse level, and the corridors around what they find."""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.kernels.corridor import close_dead_ends, surround
from nnpp_edge.runtime.map.pyramid import Level
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.search.astar import Search, astar
from nnpp_edge.runtime.search.landmarks import Landmarks
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import LANDMARK_PATIENCE, LEVEL_LANDMARKS, MOST_CELLS_FOR_LANDMARKS


class CoarseLevel:
    """Scratch memory and landmarks for searches of one coarse level. Serves one search at a time.

    The level's cells and links are read as they are when a search begins.
    """

    def __init__(self, level: Level) -> None:
        nodes, grid = len(level.grid.weights), level.grid
        self.level, self.grid, self.workspace = level, grid, Workspace(nodes)
        self.landmarks: Landmarks | None = None
        """Of the level as it was at `_version`."""
        self._version, self._spent = level.version, 0.0
        self._reached, self._queued = np.empty(nodes, np.float32), np.zeros(nodes, np.uint8)
        self._queue = np.empty(1 << (nodes - 1).bit_length(), np.int32)
        self._bitmaps = np.zeros((2, 2 * grid.rows, 2 * grid.cols), np.int32)
        self._stamp = 0
        self._closed: NDArray[np.uint8] | None = None
        """Links that `close_dead_ends` has closed, as bits."""

    def search(
        self, start: Cell, goal: Cell, region: Region | None, *, beyond: float, deadline: Deadline = NEVER
    ) -> Search:
        """`astar` on this level from a query's goal to its start, by landmarks where all of it is searched.

        Directed steps are taken backwards, and have no landmarks. Else searches of a whole level get them, one at a
        time, once they have expanded several times the cells that this takes: so a map that is searched often is
        answered sooner, and one that changes loses little.
        """
        if self._version != self.level.version:
            self.landmarks, self._version, self._spent = None, self.level.version, 0.0
        grid, ws, links, back = self.grid, self.workspace, self.level.links, self.grid.steps.by_slope
        hints = None if region is not None or self.landmarks is None else self.landmarks.towards(goal)
        found = astar(
            grid, start, goal, ws, region, links=links, hints=hints, backwards=back, beyond=beyond, deadline=deadline
        )
        if region is None and not back and grid.cells <= MOST_CELLS_FOR_LANDMARKS:
            self._spent += found.expansions
        return found

    def invest(self) -> None:
        """Set another landmark if enough work has been spent without; what the last search found is overwritten."""
        if self._closed is not None or self._spent < LANDMARK_PATIENCE * self.grid.cells:
            return
        count = len(self.landmarks.cells) if self.landmarks else 0
        landmarks = self.set_landmarks(count + 1)
        enough = len(landmarks.cells) in (count, LEVEL_LANDMARKS)  # there is no place for more, or no need
        self._spent = -math.inf if enough else 0.0

    def set_landmarks(self, count: int) -> Landmarks:
        """See to it that the level has so many landmarks, as far as there is place for them."""
        self.landmarks = self.landmarks or Landmarks(self.grid, self.workspace, self.level.links)
        self.landmarks.spread(count)
        return self.landmarks

    def close_dead_ends(self, region: Region, searched: Workspace, shape: Cell) -> bool:
        """Close the links that a search of a region of the map, of this shape, did not get across; whether any were.

        `searched` is that search's memory. `open_dead_ends` opens them again: no more has changed until then.
        """
        if self._closed is None:
            self._closed = np.zeros(len(self._queued), np.uint8)
        marks, reached = (region.bitmap, region.stamp), (searched.meta, searched.stamp, shape)
        return bool(close_dead_ends(self.level.links, marks, reached, self._queued, self._closed))

    def open_dead_ends(self) -> None:
        """Open again what was closed."""
        if self._closed is not None and self.level.links is not None:
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
        """Where to search the next finer level, around what the last search here found, from the goal to `start`.

        The region's bitmap is overwritten by the call after the next. OutOfTimeError at the deadline.

        Parameters
        ----------
        radius, band
            As in `tuning.CorridorWidth`: cells within so many quarters of the path's, and those on paths that cost
            at most 1 + `band` times as much, which the search settled.
        finer, finer_workspace
            The next finer level, and the memory of its search.
        """
        self._stamp += 1
        marks = self._bitmaps[self._stamp % 2], self._stamp
        ws, below, grid = self.workspace, finer.grid, self.grid
        searched, scratch = (ws.g, ws.meta, ws.stamp), (self._reached, self._queued, self._queue)
        ahead = below.weights, below.stride, below.rows, below.cols, finer_workspace.meta
        edges, width = grid.steps.packed()[1], (radius, band, deadline.at)
        node, path = grid.node(*start), found.path
        surround(grid.packed, edges, self.level.links, node, searched, scratch, path, width, marks, ahead)
        deadline.check()
        return Region(marks[0], *finer.quarters, self._stamp)
