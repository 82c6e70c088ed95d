"""The map as the searches see it: weights with a border of impassable cells."""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels.weights import write_costs
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.step_cost import GREY_LEVELS, PAPER_OMEGA, StepCost, StepModel

PackedGrid = tuple[NDArray[np.float32], int, tuple[float, float, float, float], bool]
"""A grid as the kernels take it: (weights, stride, steps, corner_cutting)."""
_LEAST_ABOVE_0 = np.nextafter(np.float32(0.0), np.float32(1.0))
_NO_NODES, _NO_WEIGHTS = np.empty(0, np.int32), np.empty(0, np.float32)


class Grid:
    """Weights of a map's cells, and what a step between two of them costs.

    Cell (row, col) stands at the flat index, the `node`, (row + 1) · stride + col + 1.

    Parameters
    ----------
    rows, cols : int
        Of the map.
    model : StepModel
        What a step costs.
    corner_cutting : bool
        Whether a diagonal step may pass beside an impassable cell.
    """

    def __init__(self, rows: int, cols: int, model: StepModel, corner_cutting: bool = True) -> None:
        self.rows, self.cols, self.model, self.corner_cutting = rows, cols, model, corner_cutting
        self.cells, self.stride = rows * cols, cols + 2
        """Number of cells of the map, and nodes from one row to the next."""
        self.weights: NDArray[np.float32] = np.full((rows + 2) * (cols + 2), np.inf, np.float32)
        """(nodes,) weights; inf where impassable. At first all are."""
        self.packed: PackedGrid = (self.weights, self.stride, model.steps, corner_cutting)
        lengths = model.kind is StepCost.LENGTH
        floor, ceiling = (_LEAST_ABOVE_0, math.inf) if lengths else (np.float32(0.0), 1.0)
        self._limits = floor, np.float32(model.scale), np.float32(ceiling)
        self.set_bounds(math.inf, 0.0)

    @classmethod
    def of(cls, cost: Float2D, model: StepModel, corner_cutting: bool = True) -> "Grid":
        """The grid of a whole cost map.

        Parameters
        ----------
        cost : (H, W) float
            For ``paper`` T, impassable from 1 up; for ``length`` a weight above 0, impassable where
            infinite. NaN is impassable in both.
        """
        cost = as_map(cost, "cost")
        rows, cols = cost.shape
        grid = cls(rows, cols, model, corner_cutting)
        grid.update(cost)
        return grid

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self.rows, self.cols

    def set_bounds(self, least: float, greatest: float) -> None:
        """No passable cell weighs less than `least`, inf as long as there is none, and none more than `greatest`."""
        self.least, self.greatest = least, greatest
        straight = self.model.step(0, 2.0 * least)
        self.prices = straight, min(self.model.step(1, 2.0 * least), 2.0 * straight)
        """Cost of getting a straight and a diagonal step closer where all cells are as cheap as the cheapest."""

    def update(self, cost: Float2D, origin: Cell = (0, 0), *, keep_old_weights: bool = False) -> Change:
        """Put new costs into a rectangle of the map.

        The bounds on the weights only ever widen, unless the rectangle is the whole map.

        Parameters
        ----------
        cost : (h, w) float
            As for `of`; must lie inside the map.
        origin : (row, col)
            Where its first cell goes.
        keep_old_weights : bool
            Whether the change says what the changed cells weighed before.

        Raises
        ------
        InvalidMapError
            The rectangle does not lie inside the map; or a cost is below 0, or for ``length`` not above. The map is
            as it was.
        """
        cost, row, col = as_map(cost, "patch"), int(origin[0]), int(origin[1])
        rows, cols = cost.shape
        if row < 0 or col < 0 or row + rows > self.rows or col + cols > self.cols:
            raise InvalidMapError(f"a patch must lie inside the map of {self.shape}, got {(row, col, rows, cols)}")
        bounds = (math.inf, -math.inf) if cost.shape == self.shape else (self.least, self.greatest)
        nodes, old = _NO_NODES, _NO_WEIGHTS
        if keep_old_weights:
            nodes, old = np.empty(rows * cols, np.int32), np.empty(rows * cols, np.float32)
        lowest, cells, cheaper, (top, left, bottom, right), (least, greatest) = write_costs(
            cost, self._limits, self.node(row, col), self.stride, self.weights, bounds, nodes, old
        )
        if lowest < self._limits[0]:
            wanted = "at least 0" if self.model.kind is StepCost.PAPER else "greater than 0"
            raise InvalidMapError(f"every passable cost must be {wanted}, got one of {lowest:g}")
        before = self.least, self.greatest
        if math.isfinite(least):
            self.set_bounds(least, greatest)
        rescaled = self.model.kind is StepCost.LENGTH and before != (self.least, self.greatest)
        part = (row + top, col + left, bottom - top, right - left)
        if keep_old_weights:
            nodes, old = nodes[:cells].copy(), old[:cells].copy()
        return Change(part, cells, cheaper, rescaled, nodes, old)

    def as_traversability(self) -> tuple[float, float]:
        """Scale and offset from a weight to a traversability cost T in [0, 1].

        In the ``length`` model a cell of the cheapest weight counts as T = 0, and one of 1 + 2·255·ω times
        that weight as T = 1: so straight steps cost alike, up to a factor, in both models.
        """
        if self.model.kind is StepCost.PAPER:
            return (1.0 / self.model.scale if self.model.scale else 0.0), 0.0
        span = 2.0 * GREY_LEVELS * PAPER_OMEGA
        return 1.0 / (span * max(self.least, 1e-30)), -1.0 / span

    def map(self) -> Float2D:
        """(rows, cols) float32, the weights of the map's own cells; a view."""
        return self.weights.reshape(self.rows + 2, self.stride)[1:-1, 1:-1]

    def node(self, row: int, col: int) -> int:
        """Flat index of a cell."""
        return (row + 1) * self.stride + col + 1

    def cell(self, node: int) -> Cell:
        """The cell at a flat index."""
        return node // self.stride - 1, node % self.stride - 1

    def holds(self, cell: Cell) -> bool:
        """Whether a cell lies inside the map."""
        return 0 <= cell[0] < self.rows and 0 <= cell[1] < self.cols

    def is_passable(self, cell: Cell) -> bool:
        """Whether a cell of the map can be stood on."""
        return math.isfinite(self.weights[self.node(*cell)])
