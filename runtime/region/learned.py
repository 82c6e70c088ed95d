"""The network's side of a planner: its view of the map, and regions from its answers."""

import math
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell, Rectangle, common
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.pyramid import FACTOR, Level
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import GREY_LEVELS, StepCost
from nnpp_edge.runtime.network.encoding import Frame, map_planes, mean_difference
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Query
from nnpp_edge.runtime.region.threshold import RegionFinder, lowered, probability_of

Lookup = tuple[NDArray[np.int32], NDArray[np.int32]]

_ROUNDED = 32
"""A window's corner and side are multiples of so many cells."""
_WORTH_A_WINDOW = 0.6
"""Share of the map's longer side from which on the network is shown the whole map instead of a window."""
_MOST_UNREAD = 16
"""Changed parts that are kept apart until they are read; one more, and the window is read as a whole."""
_WIDENED_FACTOR, _WIDENED_BLOCKS = 0.25, 1
"""To widen a region, the threshold is multiplied by the first and so many blocks are added all around."""


class LearnedRegions:
    """The network's side of a planner: its view of the map, and regions from its answers.

    Parameters
    ----------
    grid : Grid
        The map; `update` is to be called after each change.
    model : str, Path or NetworkModel
        A shipped model's name, a file, or a model already loaded.
    overlooked : float
        With 0, regions depend on the map and the query alone. Else on what was before, too: a network in two parts
        looks at a changed map again once more than this share of the cells it saw is different, and so is its view
        of them (by the mean difference of a cell's cost, and of its share of impassable cells, in [0, 1]); and it is
        shown another window only where the standing one does not hold start and goal, or is over four times as wide
        as need be.

    Raises
    ------
    ModelError
        The model cannot be loaded.
    """

    def __init__(self, grid: Grid, model: str | Path | NetworkModel, overlooked: float = 0.0) -> None:
        self.model = model if isinstance(model, NetworkModel) else NetworkModel(model)
        size, blocks = self.model.metadata.input_size, self.model.metadata.blocks
        scale, trained = grid.model.scale, GREY_LEVELS * self.model.metadata.omega
        if grid.model.kind is StepCost.PAPER and not 0.5 * trained <= scale <= 2.0 * trained:
            warnings.warn(
                f"the network {self.model.metadata.name} was trained for omega = {self.model.metadata.omega:g}, "
                f"the planner uses {scale / GREY_LEVELS:g}: its regions may miss the optimum by more than stated",
                stacklevel=5,
            )
        self.grid = grid
        self.size, self.blocks, self.factor = size, blocks, self.model.metadata.region_factor
        self.planes: NDArray[np.float32] = np.empty((2, size, size), np.float32)
        self.overlooked = overlooked if self.model.in_parts else 0.0
        self._shown = np.full_like(self.planes, np.inf)
        """What the network saw last."""
        self._unread: list[Rectangle] = []
        """What has changed since the planes were read, as parts of the window."""
        self._drift: float = math.inf
        """Share of the window that has changed since the network saw it: by cells told, or where measured, planes."""
        self.finder = RegionFinder(blocks)
        self._look_at((0, 0, grid.rows, grid.cols))

    def update(self, changed: Rectangle, cells: int) -> None:
        """So many cells of the grid, all in this rectangle, are other ones; they are read when that is needed."""
        if part := common(changed, self.window):
            row0, col0, rows, cols = self.window
            self._drift += cells / (rows * cols)
            self._unread.append((part[0] - row0, part[1] - col0, *part[2:]))
            if len(self._unread) > _MOST_UNREAD:
                self._unread = [(0, 0, rows, cols)]

    def _look_at(self, window: Rectangle) -> None:
        """Show the network this rectangle of the map."""
        self.window = window
        row0, col0, rows, cols = window
        self.frame = Frame(rows, cols, self.size)
        lookup = []
        inner = self.frame.lookup(self.blocks)
        for first, seen, cells in zip((row0, col0), inner, (self.grid.rows, self.grid.cols), strict=True):
            whole = np.full(cells, self.blocks, np.int32)  # outside: the bitmap's last row or column
            whole[first : first + len(seen)] = seen
            lookup.append(whole)
        self.lookup = lookup[0], lookup[1]
        self._level_lookups: dict[int, tuple[Lookup, bool]] = {}
        self._unread, self._drift = [], math.inf
        self._read(None)

    def _read(self, parts: Sequence[Rectangle] | None) -> None:
        """Bring the planes up to date with the map: these parts of the window, or all of it."""
        grid, (row0, col0, *_) = self.grid, self.window
        first = grid.weights[row0 * grid.stride + col0 :]
        map_planes(first, grid.stride, self.frame, *grid.as_traversability(), self.planes, parts)

    def _window(self, query: Query) -> Rectangle:
        """What to show the network: a square around start and goal where it shows the query finer than the map does.

        Its side is twice the distance, so that there is room for detours, and its corners are rounded: a robot
        on its way sees the same window for a while.
        """
        rows, cols = self.grid.rows, self.grid.cols
        side = max((2 * query.apart // _ROUNDED + 2) * _ROUNDED, self.size)
        if self.overlooked and max(self.window[2:]) <= 4 * side and self._holds(query.start, query.goal):
            return self.window
        if side > _WORTH_A_WINDOW * max(rows, cols):
            return (0, 0, rows, cols)
        corner = [
            min(max((a + b - side + _ROUNDED) // (2 * _ROUNDED) * _ROUNDED, 0), max(cells - side, 0))
            for a, b, cells in zip(query.start, query.goal, (rows, cols), strict=True)
        ]
        return corner[0], corner[1], min(side, rows), min(side, cols)

    def _holds(self, *cells: Cell) -> bool:
        """Whether the window holds these cells, and an eighth of its side around them where the map goes on."""
        row, col, rows, cols = self.window
        low_row, low_col = row + rows // 8 if row else 0, col + cols // 8 if col else 0
        high_row = row + rows - (rows // 8 if row + rows < self.grid.rows else 0)
        high_col = col + cols - (cols // 8 if col + cols < self.grid.cols else 0)
        return all(low_row <= r < high_row and low_col <= c < high_col for r, c in cells)

    def regions(self, query: Query, level: Level, number: int) -> Iterator[tuple[Region | None, Source]]:
        """Regions of `level`, the pyramid's of that number, to search one after another until one suffices.

        td is found along the steps that the level allows; it and the region at it are noted in the query. None
        stands for all of a level; of the map itself that is left to the caller.
        """
        probability, factor = self._ask(query), FACTOR**number
        start, goal = query.start, query.goal
        ends, (lookup, touching) = (self._block(start), self._block(goal)), self._lookup_at(level.grid, number)
        cells = (start[0] // factor, start[1] // factor), (goal[0] // factor, goal[1] // factor)
        finder = self.finder
        td = finder.first(
            probability, level.grid, level.links, level.workspace, lookup, cells, ends, query.corner_cutting,
            self.factor, touching=touching,
        )  # fmt: skip
        query.threshold = probability_of(td)
        query.network_region = Region(finder.at_td, *self.lookup, finder.stamp)
        query.lap("threshold")
        if td > 0:
            yield finder.region(lookup), Source.REGION
            finder.mark(lowered(td, self.factor * _WIDENED_FACTOR), *ends, _WIDENED_BLOCKS)
            query.lap("threshold")
            yield finder.region(lookup), Source.WIDENED
        if number:
            yield None, Source.WIDENED if td > 0 else Source.REGION

    def _ask(self, query: Query) -> NDArray[np.float32]:
        """The network's answer."""
        if (window := self._window(query)) != self.window:
            self._look_at(window)
        if self.model.owner is not self or self._differs():
            self._show()
        ends = self._place(query.start), self._place(query.goal)
        if self.model.in_parts:
            query.lap("encode")
            probability = self.model.ask(*ends)
        else:
            self.model.set_query(*ends)
            query.lap("encode")
            probability = self.model.run()
        query.lap("inference")
        return probability

    def look(self, level: Level, number: int) -> None:
        """Do now what the first query on this level, the pyramid's of that number, would do before it is answered."""
        self._lookup_at(level.grid, number)
        self._show()
        if self.model.in_parts:
            self.model.run()

    def _show(self) -> None:
        self._read_changes()
        self.model.set_map(self.planes)
        self.model.owner = self
        self._shown[:] = self.planes
        self._drift = 0.0

    def _differs(self) -> bool:
        """Whether the network should look at the map again."""
        if 0.0 < self.overlooked < self._drift < math.inf:  # some may have changed back
            self._read_changes()
            rows, cols = self.frame.inner
            self._drift = mean_difference(self.planes, self._shown) * self.size**2 / (rows * cols)
        return self._drift > self.overlooked

    def _read_changes(self) -> None:
        if self._unread:
            self._read(self._unread)
            self._unread.clear()

    def _place(self, cell: Cell) -> tuple[float, float]:
        return self.frame.place((cell[0] - self.window[0], cell[1] - self.window[1]))

    def _block(self, cell: Cell) -> Cell:
        return int(self.lookup[0][cell[0]]), int(self.lookup[1][cell[1]])

    def _lookup_at(self, grid: Grid, number: int) -> tuple[Lookup, bool]:
        """The block that the middle of each row and column of a grid lies in, and whether steps leave out none."""
        if number not in self._level_lookups:
            factor = FACTOR**number
            rows = np.minimum(np.arange(grid.rows) * factor + factor // 2, self.grid.rows - 1)
            cols = np.minimum(np.arange(grid.cols) * factor + factor // 2, self.grid.cols - 1)
            lookup = self.lookup[0][rows], self.lookup[1][cols]
            inside = (each[each < self.blocks] for each in lookup)
            self._level_lookups[number] = lookup, all((np.diff(each) <= 1).all() for each in inside)
        return self._level_lookups[number]
