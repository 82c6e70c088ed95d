"""A map larger than memory: its coarse levels, made from bands of rows, and its cells where they
have been put.

The arrays of the finest level have the whole map's size, but take memory only where something was
written.
"""

import itertools
import math

import numpy as np

from nnpp_edge.runtime.arrays import Cells, Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels.pooling import FACTOR, pool_and_link
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.pyramid import Level, coarse_shapes
from nnpp_edge.runtime.memory import virtual_zeros
from nnpp_edge.runtime.terrain.step_cost import StepCost, StepModel

MOST_NODES = int(np.iinfo(np.int32).max)
"""Of the finest level: nodes are int32."""
_KEPT = FACTOR + 1
"""Rows of a band that the next one needs: those under the last coarse row, whose links it
completes, and one more.
"""


class StreamedMap:
    """Coarse levels as `Pyramid` makes them, and a finest one that is filled (`put`) where a search
    goes.

    Elsewhere its weights take no memory, are 0, and mean nothing. Costs are taken band by band from
    top to bottom, with `take`, and `finish` ends that. Steps cost as in ``paper`` only, as
    ``length`` weighs obstacles by the dearest cell of the whole map. Serves one thread at a time.
    InvalidMapError where the map is empty, or has more cells than nodes have numbers.
    """

    vehicle = None
    checked = 0
    costs_computed = 1.0
    """As of a `MapState`."""

    def __init__(
        self, shape: tuple[int, int], model: StepModel, *, corner_cutting: bool = True
    ) -> None:
        rows, cols = shape
        if (
            rows < 1
            or cols < 1
            or (rows + 2) * (cols + 2) > MOST_NODES
            or model.kind is not StepCost.PAPER
        ):
            raise InvalidMapError(
                f"wanted a map of 1 to {MOST_NODES} cells with the paper's costs, got {shape}"
            )
        self.grid = Grid(
            rows, cols, model, corner_cutting, virtual_zeros((rows + 2) * (cols + 2), np.float32)
        )
        self.levels = [Level(self.grid)]
        for coarse in coarse_shapes(rows, cols):
            grid = Grid(*coarse, model)
            nodes = len(grid.weights)
            self.levels.append(Level(grid, np.zeros(nodes, np.uint16), np.zeros(nodes, np.uint8)))
        self._band: Grid | None = None
        self._taken = 0
        self._least = math.inf
        self._obstacle = model.scale
        """Weight of an impassable cell in the mean: T = 1."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.grid.shape

    def pyramid_by(self, _: Deadline) -> "StreamedMap":
        """Levels that are there already."""
        return self

    def known_along(self, path: Cells) -> int:
        """As `MapState.known_along`."""
        return len(path)

    def along(self, _: Cells) -> None:
        """As `MapState.along`: heights are read anew for that."""

    def put(self, cost: Float2D, origin: Cell) -> None:
        """Fill a rectangle of the finest level, and the border beside it; the bounds stay as they
        are.
        """
        grid = self.grid
        row, col = origin
        rows, cols = cost.shape
        least = grid.least
        greatest = grid.greatest
        grid.update(cost, origin)
        grid.set_bounds(least, greatest)
        beside = grid.weights.reshape(grid.rows + 2, grid.stride)[
            row : row + rows + 2, col : col + cols + 2
        ]
        for at_border, border in (
            (row == 0, beside[0]),
            (col == 0, beside[:, 0]),
            (row + rows == grid.rows, beside[-1]),
            (col + cols == grid.cols, beside[:, -1]),
        ):
            if at_border:
                border[:] = np.inf

    def take(self, cost: Float2D) -> None:
        """Pool the next rows' costs (h, cols); h is a multiple of four, but for the last band."""
        row0 = self._taken
        rows = len(cost)
        band = self._next_band(rows)
        above = 1 if row0 else 0
        band.update(cost, (FACTOR * above, 0))
        first = row0 // FACTOR - above
        count = math.ceil(rows / FACTOR)
        level = self.levels[1]
        stride = level.grid.stride
        cols = level.grid.cols
        part = slice(first * stride, (first + above + count + 2) * stride)
        assert level.links is not None
        arrays = level.grid.weights[part], level.pieces[part], level.links[part]
        # the last coarse row so far, too, is linked anew: below it there was nothing yet
        least = pool_and_link(
            Level(band).packed,
            self.grid.corner_cutting,
            self._obstacle,
            (above, above + count, 0, cols),  # `records.Area`
            (*arrays, stride, above + count, cols),  # `records.Level`
        )
        self._band = band
        self._taken = row0 + rows
        self._least = min(self._least, least)
        self.grid.set_bounds(
            min(self.grid.least, band.least), max(self.grid.greatest, band.greatest)
        )

    def finish(self) -> None:
        """Make the coarser levels, once all bands have been taken."""
        self._band = None
        least = self._least
        greatest = max(self.grid.greatest, self._obstacle)
        self.levels[1].grid.set_bounds(least, greatest)
        for fine, coarse in itertools.pairwise(self.levels[1:]):
            grid = coarse.grid
            area = (0, grid.rows, 0, grid.cols)  # `records.Area`
            cutting = self.grid.corner_cutting
            least = pool_and_link(fine.packed, cutting, self._obstacle, area, coarse.packed)
            grid.set_bounds(least, greatest)

    def _next_band(self, rows: int) -> Grid:
        """A grid for the next rows below four of the last ones; the row above those stands in its
        border.
        """
        above = FACTOR if self._taken else 0
        grid = self.grid
        last = self._band
        band = last
        if band is None or band.rows != rows + above:
            band = Grid(rows + above, grid.cols, grid.model, grid.corner_cutting)
        if last is not None:
            kept = last.weights.reshape(-1, grid.stride)[-1 - _KEPT : -1]
            band.weights.reshape(-1, grid.stride)[:_KEPT] = kept.copy()
        return band
