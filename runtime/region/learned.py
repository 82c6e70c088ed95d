"""Regions from a network's answers."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.threshold import lowered
from nnpp_edge.runtime.map.pyramid import Level
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.region.map_view import MapView
from nnpp_edge.runtime.region.threshold import Ends, RegionFinder, probability_of
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Stopwatch
from nnpp_edge.runtime.tuning import WIDENED_BLOCKS, WIDENED_THRESHOLD


class NetworkAnswer(NamedTuple):
    """A network's answer to a query."""

    threshold: float
    """The adaptive threshold td, a probability."""
    region: Region
    """The region at td itself (NNPP, section 4.3), over the map's own cells."""


class LearnedRegions:
    """Regions from a network's answers, for one map; with `MapView`'s arguments.

    The network is loaded when first needed; ModelError where it cannot be.
    """

    def __init__(self, state: MapState, model: str | Path | NetworkModel, unseen_change: float = 0.0) -> None:
        self._state, self._unseen_change = state, unseen_change
        self.use_model(model)

    def use_model(self, model: str | Path | NetworkModel) -> None:
        """Take the regions from this network from now on."""
        self.model = model
        self._view: MapView | None = None
        self._finder = RegionFinder(1)

    def prepare(self, level: Level, number: int) -> None:
        """Do now what the first query on this level, the pyramid's of that number, would do before it is answered."""
        view = self._loaded_view(Stopwatch())
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
        stopwatch: Stopwatch,
        deadline: Deadline = NEVER,
    ) -> tuple[NetworkAnswer, Iterator[Region | None]]:
        """The network's answer, and regions of a level to search one after another until one suffices.

        td is found along steps that the level allows. The regions are that at a share of td, a wider one, and None,
        which stands for all of a coarse level; to search all of the map itself is left to the caller.

        Parameters
        ----------
        start, goal : (row, col)
            Cells of the map.
        level, number, workspace
            The pyramid's level of that number, and memory of its grid.
        stopwatch : Stopwatch
            The stages ``encode``, ``inference`` and ``threshold`` are timed by it, and ``load`` where the model's
            file had to be opened, or was just being opened by another thread.
        deadline : Deadline
            When to give up with OutOfTimeError. Neither loading nor running a network can be stopped; it is not run
            where its fastest run so far took longer than there is time left.
        """
        view = self._loaded_view(stopwatch)
        places = view.show(start, goal, deadline)
        deadline.check()
        view.network.check_time(deadline)
        stopwatch.stage_ends("encode")
        probability = view.network.answer(*places)
        stopwatch.stage_ends("inference")
        deadline.check()
        factor, finder, share = FACTOR**number, self._finder, view.network.metadata.region_factor
        lookup, touching = view.lookup_at(level.grid, number)
        cells = (start[0] // factor, start[1] // factor), (goal[0] // factor, goal[1] // factor)
        ends = Ends(*cells, view.block(start), view.block(goal))
        td = finder.first(probability, level, workspace, lookup, ends, share, touching=touching, deadline=deadline)
        answer = NetworkAnswer(probability_of(td), Region(finder.at_td, *view.lookup, finder.stamp))
        stopwatch.stage_ends("threshold")

        def widening() -> Iterator[Region | None]:
            if td > 0:
                yield finder.region(lookup)
                finder.mark(lowered(td, share * WIDENED_THRESHOLD), ends.start_block, ends.goal_block, WIDENED_BLOCKS)
                stopwatch.stage_ends("threshold")
                yield finder.region(lookup)
            if number:
                yield None

        return answer, widening()

    def _loaded_view(self, stopwatch: Stopwatch) -> MapView:
        if self._view is None:
            self._view = MapView(self._state, self.model, self._unseen_change)
            self._finder = RegionFinder(self._view.blocks)
            if self._view.network.waited:
                stopwatch.stage_ends("load")
        return self._view
