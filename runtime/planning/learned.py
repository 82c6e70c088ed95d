"""The network's side of a planner: its view of the map, and regions from its answers."""

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.costmap import Rectangle
from nnpp_edge.runtime.encoding import Cell, Frame, map_planes
from nnpp_edge.runtime.grid import GREY_LEVELS, Grid, StepCost
from nnpp_edge.runtime.inference import NetworkModel
from nnpp_edge.runtime.planning.astar import Region
from nnpp_edge.runtime.planning.pyramid import FACTOR
from nnpp_edge.runtime.planning.query import Query
from nnpp_edge.runtime.region import RegionFinder


class LearnedRegions:
    """The network's side of a planner: its view of the map, and regions from its answers."""

    def __init__(self, grid: Grid, model: str | Path | NetworkModel) -> None:
        self.model = model if isinstance(model, NetworkModel) else NetworkModel(model)
        size, blocks = self.model.metadata.input_size, self.model.metadata.blocks
        scale, trained = grid.model.scale, GREY_LEVELS * self.model.metadata.omega
        if grid.model.kind is StepCost.PAPER and not 0.5 * trained <= scale <= 2.0 * trained:
            warnings.warn(
                f"the network {self.model.metadata.name} was trained for omega = {self.model.metadata.omega:g}, "
                f"the planner uses {scale / GREY_LEVELS:g}: its regions may miss the optimum by more than stated",
                stacklevel=4,
            )
        self.grid = grid
        self.frame = Frame(grid.rows, grid.cols, size)
        self.lookup = self.frame.lookup(blocks)
        self.factor = self.model.metadata.region_factor
        self.planes: NDArray[np.float32] = np.empty((2, size, size), np.float32)
        # two finders, so that the region at td itself stays while wider ones are searched
        self.finder, self.at_td = RegionFinder(blocks), RegionFinder(blocks)
        self._level_lookups: dict[int, tuple[NDArray[np.int32], NDArray[np.int32]]] = {0: self.lookup}
        self.update(None)

    def update(self, changed: Rectangle | None) -> None:
        """Bring the network's view up to date with the grid, where it changed or all over."""
        map_planes(
            self.grid.weights,
            self.grid.stride,
            self.frame,
            *self.grid.as_traversability(),
            self.planes,
            changed,
        )
        self.stale = True

    def infer(self, query: Query) -> float:
        """Ask the network; the adaptive threshold, in [0, 1]."""
        if self.stale or self.model.owner is not self:
            self.model.set_map(self.planes)
            self.model.owner = self
            self.stale = False
        self.model.set_query(self.frame.place(query.start), self.frame.place(query.goal))
        query.lap("encode")
        probability = self.model.run()
        query.lap("inference")
        self.finder.read(probability)
        td = self.finder.threshold(self._block(query.start), self._block(query.goal))
        self.at_td.levels[:] = self.finder.levels
        query.lap("threshold")
        return td / 256.0

    def _block(self, cell: Cell) -> Cell:
        return int(self.lookup[0][cell[0]]), int(self.lookup[1][cell[1]])

    def region(self, threshold: float, query: Query, radius: int | None = None) -> Region:
        """The region at a threshold in [0, 1]; without a radius, the one kept for the figures."""
        finder = self.at_td if radius is None else self.finder
        level = max(int(threshold * 256.0), 1)
        stamp = finder.mark(level, self._block(query.start), self._block(query.goal), radius or 0)
        query.lap("threshold")
        return Region(finder.bitmap, *self.lookup, stamp)

    def at_level(self, region: Region, grid: Grid, level: int) -> Region:
        """The same region as a coarser level of the pyramid reads it."""
        if level not in self._level_lookups:
            factor = FACTOR**level
            rows = np.minimum(np.arange(grid.rows) * factor + factor // 2, self.grid.rows - 1)
            cols = np.minimum(np.arange(grid.cols) * factor + factor // 2, self.grid.cols - 1)
            self._level_lookups[level] = (self.lookup[0][rows], self.lookup[1][cols])
        return Region(region.bitmap, *self._level_lookups[level], region.stamp)
