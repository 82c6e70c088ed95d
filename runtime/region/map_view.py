"""The network's view of a map: a window, averaged to the network's size, brought up to date when
needed.
"""

import math
import warnings
from functools import lru_cache
from pathlib import Path

import numpy as np

from nnpp_edge.runtime.arrays import Float32s
from nnpp_edge.runtime.cells import Cell, Rectangle, apart, common, enclosing, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import users_line
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.encoding import Frame, Point, map_planes
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.search.region import Lookup
from nnpp_edge.runtime.terrain.step_cost import GREY_LEVELS, StepCost
from nnpp_edge.runtime.tuning import STRIPE_CELLS, WINDOW_ROUNDING, WINDOW_SHARE

_Place = tuple[tuple[int, int], Rectangle, int, int]
"""A map's shape, the window that the network is shown, and that one's cells and blocks to a side.
"""


class MapView:
    """A network, and the window of the map that it is shown. Serves one thread at a time.

    Parameters
    ----------
    model : str, Path or NetworkModel
        As in `PlannerOptions`; ModelError where it cannot be loaded.
    unseen_change : float
        With 0, what the network is shown depends on the map and the query alone. Else a network in
        two parts is shown a changed map only once more than this share of the cells it saw is
        different, and so is its view of them (by the mean difference of a cell's cost, and of its
        share of impassable cells, in [0, 1]); and it is shown another window only where the
        standing one does not hold start and goal, or is over four times as wide as need be.
    """

    def __init__(
        self, state: MapState, model: str | Path | NetworkModel, unseen_change: float = 0.0
    ) -> None:
        self.network = model.share() if isinstance(model, NetworkModel) else NetworkModel(model)
        metadata = self.network.metadata
        steps = state.grid.model
        self.size = metadata.input_size
        self.blocks = metadata.blocks
        self._grid = state.grid
        self._unseen_change = unseen_change if self.network.in_parts else 0.0
        self.planes: Float32s = np.empty((2, self.size, self.size), np.float32)
        """The window at the network's size, as it was when the network was last shown it,
        or later.
        """
        self._changes = state.log.reader()
        self._show_window((0, 0, *self._grid.shape))
        trained = GREY_LEVELS * metadata.omega
        if steps.kind is StepCost.PAPER and not 0.5 * trained <= steps.scale <= 2.0 * trained:
            warnings.warn(
                f"the network {metadata.name} was trained for omega = {metadata.omega:g}, the "
                "planner uses "
                f"{steps.scale / GREY_LEVELS:g}: its regions may miss the optimum by more than "
                "stated",
                stacklevel=users_line(),
            )

    def show(self, start: Cell, goal: Cell, deadline: Deadline = NEVER) -> tuple[Point, Point]:
        """Show the network what a query between two cells needs of the map; where they lie, in
        network cells.

        At the deadline OutOfTimeError: the next call goes on from there.
        """
        self._read_changes()
        if (window := self._window_for(start, goal)) != self.window:
            self._show_window(window)
        if self._drift and self._differs(deadline):
            self.refresh(deadline)
        row, col = self.window[:2]
        places = [self.frame.place((cell[0] - row, cell[1] - col)) for cell in (start, goal)]
        return places[0], places[1]

    def refresh(self, deadline: Deadline = NEVER) -> None:
        """Show the network the window as it is now."""
        self._read_changes()
        self._average_changes(deadline)
        self.network.set_map(self.planes)
        self._shown = self.planes.copy()
        """The planes that the network saw last."""
        self._drift = 0.0

    def block(self, cell: Cell) -> Cell:
        """The block that a cell lies in; outside the window the last row or column."""
        return int(self.lookup[0][cell[0]]), int(self.lookup[1][cell[1]])

    def lookup_at(self, level: Grid, number: int) -> tuple[Lookup, bool]:
        """The block of each row's and column's middle on the level of that number; whether steps
        leave out none.
        """
        return _lookup_at(level.shape, number, self._place)

    def _show_window(self, window: Rectangle) -> None:
        """Look at this rectangle of the map from now on."""
        self.window = window
        _, _, rows, cols = window
        self.frame = Frame(rows, cols, self.size)
        self._place = self._grid.shape, window, self.size, self.blocks
        self.lookup = _lookup(self._place)
        """The block that each row and column of the map lies in."""
        self._drift = math.inf
        """Share of the window that has changed since the network saw it: by its cells or, where
        measured, planes.
        """
        self._changes.skip()
        self.planes[:] = 1.0
        self._stale = [(0, 0, rows, cols)]
        """Rectangles of the window that the planes are not of."""

    def _differs(self, deadline: Deadline) -> bool:
        """Whether the network should be shown the map again."""
        if 0.0 < self._unseen_change < self._drift < math.inf:  # some may have changed back
            self._average_changes(deadline)
            rows, cols = self.frame.inner
            self._drift = (
                float(np.abs(self.planes - self._shown).mean()) * self.size**2 / (rows * cols)
            )
        return self._drift > self._unseen_change

    def _read_changes(self) -> None:
        """Count what has changed in the window, and note what is to be averaged again."""
        row0, col0, rows, cols = self.window
        for change in self._changes.read():
            part = self.window if change.rescaled else common(change.part, self.window)
            if part is not None:
                cells = self._grid.cells if change.rescaled else change.cells
                self._drift += cells / (rows * cols)
                self._stale.append((part[0] - row0, part[1] - col0, *part[2:]))

    def _average_changes(self, deadline: Deadline) -> None:
        """Bring the planes up to date with the map, as far as its changes were read."""
        row0, col0, _, _ = self.window
        while self._stale:
            deadline.check()
            row, col, rows, cols = self._stale[-1]
            tall = rows if deadline.at == math.inf else min(max(STRIPE_CELLS // cols, 1), rows)
            stripe = (row, col, tall, cols)
            if (tiles := self._grid.tiles) is not None:
                tiles.planes(self.window, self.frame.inner, [stripe], self.planes)
            else:
                map_planes(self._grid, self.frame, self.planes, [stripe], (row0, col0))
            self._stale[-1:] = [(row + tall, col, rows - tall, cols)] if tall < rows else []

    def _window_for(self, start: Cell, goal: Cell) -> Rectangle:
        """A square around start and goal where it shows them finer than the whole map, else that.

        Its side is twice the distance, so that there is room for detours, and its corners are
        rounded: a robot on its way sees the same window for a while.
        """
        shape = self._grid.shape
        unit = WINDOW_ROUNDING
        side = max((2 * apart((*start, 1, 1), goal) // unit + 2) * unit, self.size)
        if self._unseen_change and max(self.window[2:]) <= 4 * side and self._holds(start, goal):
            return self.window
        if side > WINDOW_SHARE * max(shape):
            return (0, 0, *shape)
        corner = []
        for begin, end, cells in zip(start, goal, shape, strict=True):
            first = (begin + end - side + unit) // (2 * unit) * unit
            corner.append(min(max(first, 0), max(cells - side, 0)))
        return corner[0], corner[1], min(side, shape[0]), min(side, shape[1])

    def _holds(self, start: Cell, goal: Cell) -> bool:
        """Whether the window holds these cells, and an eighth of its side around them where the map
        goes on.
        """
        _, _, rows, cols = self.window
        ends = enclosing(((*start, 1, 1), (*goal, 1, 1)))
        around = widened(ends, (rows // 8, cols // 8), self._grid.shape)
        return common(around, self.window) == around


# kept by their shapes, for the next map


@lru_cache(maxsize=8)
def _lookup(place: _Place) -> Lookup:
    """The block that each row and column of a map lies in; outside the window one past the last."""
    shape, (row, col, height, width), size, blocks = place
    of_rows, of_cols = (np.full(side, blocks, np.int32) for side in shape)
    within = Frame(height, width, size).lookup(blocks)
    of_rows[row : row + height], of_cols[col : col + width] = within
    return of_rows, of_cols


@lru_cache(maxsize=8)
def _lookup_at(level: tuple[int, int], number: int, place: _Place) -> tuple[Lookup, bool]:
    """As `MapView.lookup_at`, for a level of this shape."""
    factor = FACTOR**number
    rows, cols = (
        of_map[np.minimum(np.arange(cells) * factor + factor // 2, len(of_map) - 1)]
        for of_map, cells in zip(_lookup(place), level, strict=True)
    )
    inside = (each[each < place[-1]] for each in (rows, cols))
    return (rows, cols), all((np.diff(each) <= 1).all() for each in inside)
