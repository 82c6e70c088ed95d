"""Regions from a network's answers."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nnpp_edge.runtime.arrays import Float2D, Int32, UInt8
from nnpp_edge.runtime.cells import Cell, Endpoints, coarser
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.kernels import threshold as kernels
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.records import ThresholdMemory
from nnpp_edge.runtime.kernels.threshold import lowered
from nnpp_edge.runtime.map.pyramid import Level
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.region.map_view import MapView
from nnpp_edge.runtime.search.region import Lookup, Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import WIDENED_BLOCKS, WIDENED_THRESHOLD


def probability_of(level: int) -> float:
    """The probability that a level of the threshold stands for; 0 below 0, which stands
    for no way.
    """
    return (max(level, 0) / kernels.LEVELS) ** 4


class RegionFinder:
    """Turns probabilities on blocks × blocks into regions; holds the scratch memory for
    one size.
    """

    def __init__(self, blocks: int) -> None:
        padded = (blocks + 1, blocks + 1)
        self.bitmap: Int32 = np.zeros(padded, np.int32)
        """(B + 1, B + 1), where the blocks of `stamp` were marked; it holds until the next marking.

        The last row and column belong to no region: cells that the network is not shown lie there.
        """
        self.at_td: Int32 = np.zeros(padded, np.int32)
        """The region at td itself, by `first`; it stays while wider ones are searched."""
        self.stamp = 0
        levels = np.zeros(padded, np.uint8)
        self._memory = ThresholdMemory(
            levels,
            np.empty(kernels.LEVELS, np.int32),
            np.empty(levels.size, np.int32),
            np.empty(levels.size, np.uint8),
        )

    @property
    def levels(self) -> UInt8:
        """Level of each block: (B, B) uint8."""
        return self._memory.levels[:-1, :-1]

    def read(self, probability: Float2D) -> None:
        """Take over a network's answer, (B, B) float32 in [0, 1]."""
        kernels.quantise(probability, self._memory.levels)

    def threshold(self, start: Cell, goal: Cell) -> int:
        """The adaptive threshold td between two blocks, as a level."""
        return int(kernels.adaptive_threshold(tuple(self._memory), start, goal))

    def first(
        self,
        probability: Float2D,
        level: Level,
        workspace: Workspace,
        lookup: Lookup,
        ends: Endpoints,
        blocks: Endpoints,
        factor: float,
        *,
        touching: bool = False,
        deadline: Deadline = NEVER,
    ) -> int:
        """Take over an answer and find td as a level, along steps that the grid allows; -1 where
        there is no way.

        The blocks at td are numbered `stamp` in `at_td`, those at `factor` of it in `bitmap`. Where
        td is not above 0, `at_td` is every block and `bitmap` is left alone. The level is walked
        on; `workspace` is memory of its grid, `lookup` the block that each of its rows and columns
        lies in, and `blocks` are in every region. To say that each step on the grid leads to the
        same block or a `touching` one saves time. OutOfTimeError at the deadline.
        """
        self.stamp += 1
        workspace.next_stamp()
        grid = level.grid
        start, goal = ends
        td = kernels.first_regions(
            probability,
            lookup,
            grid.packed,
            level.links,
            # `records.RegionQuery`
            (grid.node(*start), grid.node(*goal), blocks, touching, factor),
            tuple(self._memory),
            workspace.packed,
            (self.stamp, self.at_td, self.bitmap),  # `records.RegionMarks`
            deadline.at,
        )
        if td == kernels.TOO_LATE:
            raise OutOfTimeError
        return int(td)

    def mark(self, threshold: int, start: Cell, goal: Cell, radius: int = 0) -> None:
        """Number the blocks at or above a threshold in `bitmap`; the number is `stamp`."""
        self.stamp += 1
        levels = self._memory.levels
        kernels.fill_region(levels, threshold, start, goal, self.stamp, radius, self.bitmap)

    def region(self, lookup: Lookup) -> Region:
        """The blocks marked last, as a region of the grid whose rows and columns lie in the blocks
        of `lookup`.
        """
        return Region(self.bitmap, *lookup, self.stamp)


class LearnedRegions:
    """Regions of one map by a network, which is loaded now: ModelError where it cannot be.
    `unseen_change` as for `MapView`.
    """

    def __init__(
        self, state: MapState, model: str | Path | NetworkModel, unseen_change: float = 0.0
    ) -> None:
        self._view = MapView(state, model, unseen_change)
        self._finder = RegionFinder(self._view.blocks)

    def prepare(self, level: Level, number: int) -> None:
        """Do now what the first query on this level, the pyramid's of that number, would do before
        it is answered.
        """
        view = self._view
        view.network.waited = False
        view.lookup_at(level.grid, number)
        view.refresh()
        if view.network.in_parts:
            view.network.try_out()

    def regions(
        self,
        start: Cell,
        goal: Cell,
        level: Level,
        number: int,
        workspace: Workspace,
        stopwatch: Work,
        deadline: Deadline = NEVER,
    ) -> tuple[float, Region, Iterator[Region | None]]:
        """The adaptive threshold td, a probability, the region at td itself (NNPP, section 4.3)
        over the map's own cells, and regions of a level to search one after another until one
        suffices.

        td is found along steps that the level, the pyramid's of that number, allows. The regions
        are that at a share of td, a wider one, and None, which stands for all of a coarse level; to
        search all of the map itself is left to the caller. Timed are the stages ``encode``,
        ``inference`` and ``threshold``, and ``load`` where the file had to be opened, or was just
        being opened by another thread. OutOfTimeError at the deadline, but that neither loading nor
        running a network can be stopped.
        """
        view = self._view
        if view.network.waited:
            view.network.waited = False
            stopwatch.stage_ends("load")
        places = view.show(start, goal, deadline)
        deadline.check()
        stopwatch.stage_ends("encode")
        probability = view.network.answer(*places)
        stopwatch.stage_ends("inference")
        deadline.check()
        factor = FACTOR**number
        finder = self._finder
        share = view.network.metadata.region_factor
        lookup, touching = view.lookup_at(level.grid, number)
        ends = (coarser(start, factor), coarser(goal, factor))
        blocks = view.block(start), view.block(goal)
        td = finder.first(
            probability,
            level,
            workspace,
            lookup,
            ends,
            blocks,
            share,
            touching=touching,
            deadline=deadline,
        )
        at_td = Region(finder.at_td, *view.lookup, finder.stamp)
        stopwatch.stage_ends("threshold")

        def widening() -> Iterator[Region | None]:
            if td > 0:
                yield finder.region(lookup)
                finder.mark(lowered(td, share * WIDENED_THRESHOLD), *blocks, WIDENED_BLOCKS)
                stopwatch.stage_ends("threshold")
                yield finder.region(lookup)
            if number:
                yield None

        return probability_of(td), at_td, widening()
