"""The map as the searches see it: weights with a border of impassable cells."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.map.step_cost import GREY_LEVELS, PAPER_OMEGA, StepCost, StepModel

_LEAST_ABOVE_0 = np.nextafter(np.float32(0.0), np.float32(1.0))


@kernel
def _exchange(cost, floor, scale, ceiling, first, stride, weights, least, greatest, was):
    """Put the weights of a rectangle's costs into the padded map, from node `first` on, unless a cost is too low.

    The least cost; how many weights differ from those that stood there, and whether one of them fell; first row and
    column of those, and one past the last; `least` and `greatest`, bounds on the weights of passable cells, widened
    by those that come. `was` gets what stood within, if it has room.
    """
    changed, fell, lowest = 0, False, np.float32(np.inf)
    top, left, bottom, right = cost.shape[0], cost.shape[1], 0, 0
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for row in range(cost.shape[0]):
        for col in range(cost.shape[1]):
            t, w = cost[row, col], np.float32(np.inf)
            if t < ceiling:  # no NaN comes here
                w = np.float32(t * scale)
                lowest = min(lowest, t)
                low, high = min(low, w), max(high, w)
            before = weights[first + row * stride + col]
            if w != before:
                changed += 1
                fell = fell or w < before
                top, bottom = min(top, row), row + 1
                left, right = min(left, col), max(right, col + 1)
    least, greatest = min(least, np.float64(low)), max(greatest, np.float64(high))
    if changed == 0 or lowest < floor:
        return lowest, 0, False, 0, 0, 0, 0, least, greatest
    for row in range(top, bottom):
        for col in range(left, right):
            node, t = first + row * stride + col, cost[row, col]
            if len(was):
                was[(row - top) * (right - left) + col - left] = weights[node]
            weights[node] = np.float32(t * scale) if t < ceiling else np.float32(np.inf)
    return lowest, changed, fell, top, left, bottom, right, least, greatest


class Change(NamedTuple):
    """What an update has changed."""

    cells: int
    """How many have another weight now."""
    part: Rectangle
    """The least rectangle that holds them."""
    cheaper: bool
    """Whether one of them weighs less."""
    was: NDArray[np.float32]
    """Weights that stood in `part`, row by row; empty unless asked for."""


@dataclass(eq=False)
class Grid:
    """A map of weights with a border of impassable cells, so that no search need check the map's edge.

    Cell (row, col) stands at the flat index, the `node`, (row + 1) · stride + col + 1.
    """

    rows: int
    cols: int
    model: StepModel
    weights: NDArray[np.float32] = field(repr=False)

    def __post_init__(self) -> None:
        """Work out what the searches ask for again and again."""
        self.cells, self.stride = self.rows * self.cols, self.cols + 2
        """Number of cells of the map, and nodes from one row to the next."""
        self.steps = (*self.model.length_term, *self.model.weight_term)
        """The model's coefficients: lengths, then weights, each for straight and for diagonal steps."""
        lengths = self.model.kind is StepCost.LENGTH
        self._limits = (
            _LEAST_ABOVE_0 if lengths else np.float32(0.0), np.float32(self.model.scale),
            np.float32(np.inf if lengths else 1.0),
        )  # fmt: skip
        self.set_bounds(math.inf, 0.0)

    def set_bounds(self, least: float, greatest: float) -> None:
        """No passable cell weighs less than `least`, inf as long as there is none, and none more than `greatest`."""
        self.least, self.greatest = least, greatest
        straight = self.model.step(0, 2.0 * least)
        self.prices = straight, min(self.model.step(1, 2.0 * least), 2.0 * straight)
        """Cost of getting a straight and a diagonal step closer where all cells are as cheap as the cheapest."""

    @classmethod
    def empty(cls, rows: int, cols: int, model: StepModel) -> "Grid":
        """A grid whose cells are all impassable."""
        return cls(rows, cols, model, np.full((rows + 2) * (cols + 2), np.inf, np.float32))

    @classmethod
    def of(cls, cost: Float2D, model: StepModel) -> "Grid":
        """The grid of a whole cost map.

        Parameters
        ----------
        cost : (H, W) float
            For ``paper`` T, impassable from 1 up; for ``length`` a weight above 0, impassable where
            infinite. NaN is impassable in both.
        """
        cost = as_map(cost, "cost")
        rows, cols = cost.shape
        grid = cls.empty(rows, cols, model)
        grid.update(cost)
        return grid

    def update(self, cost: Float2D, origin: tuple[int, int] = (0, 0), *, keep: bool = False) -> Change:
        """Take over a rectangle of the map.

        The bounds on the weights only ever widen, unless the whole map is taken over.

        Parameters
        ----------
        cost : (h, w) float
            As for `of`; must lie inside the map.
        origin : (row, col)
            Where its first cell goes.
        keep : bool
            Whether to tell what stood there.

        Raises
        ------
        InvalidMapError
            The rectangle does not lie inside the map; or a cost is below 0, or for ``length`` not above. The map is
            as it was.
        """
        cost, row, col = as_map(cost, "patch"), int(origin[0]), int(origin[1])
        rows, cols = cost.shape
        if row < 0 or col < 0 or row + rows > self.rows or col + cols > self.cols:
            raise InvalidMapError(
                f"a patch must lie inside the map of {(self.rows, self.cols)}, got {(row, col, rows, cols)}"
            )
        whole = (rows, cols) == (self.rows, self.cols)
        least, greatest = (math.inf, -math.inf) if whole else (self.least, self.greatest)
        was = np.empty(rows * cols if keep else 0, np.float32)
        lowest, changed, fell, top, left, bottom, right, least, greatest = _exchange(
            cost, *self._limits, self.node(row, col), self.stride, self.weights, least, greatest, was
        )
        if lowest < self._limits[0]:
            wanted = "at least 0" if self.model.kind is StepCost.PAPER else "greater than 0"
            raise InvalidMapError(f"every passable cost must be {wanted}, got one of {lowest:g}")
        if math.isfinite(least):
            self.set_bounds(least, greatest)
        part = (row + top, col + left, bottom - top, right - left)
        return Change(changed, part, fell, was[: part[2] * part[3]])

    def as_traversability(self) -> tuple[float, float]:
        """Scale and offset from a weight to a traversability cost T in [0, 1].

        In the ``length`` model a cell of the cheapest weight counts as T = 0, and one of 1 + 2·255·ω times
        that weight as T = 1: so straight steps cost alike, up to a factor, in both models.
        """
        if self.model.kind is StepCost.PAPER:
            return (1.0 / self.model.scale if self.model.scale else 0.0), 0.0
        span = 2.0 * GREY_LEVELS * PAPER_OMEGA
        return 1.0 / (span * max(self.least, 1e-30)), -1.0 / span

    def map(self) -> NDArray[np.float32]:
        """(rows, cols) float32, the weights of the map's own cells; a view."""
        return self.weights.reshape(self.rows + 2, self.stride)[1:-1, 1:-1]

    def node(self, row: int, col: int) -> int:
        """Flat index of a cell."""
        return (row + 1) * self.stride + col + 1

    def is_passable(self, row: int, col: int) -> bool:
        """Whether a cell of the map can be stood on."""
        return math.isfinite(self.weights[self.node(row, col)])
