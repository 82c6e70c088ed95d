"""The map as the searches see it: padded weights, and what a step between two cells costs.

Both step-cost models have one form, so that the searches need not know which is in use:

    step(i, j) = length_term[kind] + weight_term[kind] · (w_i + w_j),   kind 0 straight, 1 diagonal

- ``paper`` (NNPP, Eq. 2-4): L + 255·ω·(T_i + T_j) with w = 255·ω·T. The paper's ω is for T in grey levels.
- ``length``: L × the mean of the two weights.
"""

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime._jit import kernel
from nnpp_edge.runtime.costmap import Float2D, Rectangle, as_map
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError

SQRT2 = math.sqrt(2.0)
PAPER_OMEGA = 0.011
"""Weight of the traversability cost per grey level (NNPP, section 4.2)."""
GREY_LEVELS = 255.0


class StepCost(StrEnum):
    """What a step costs; see the module's description."""

    PAPER = "paper"
    LENGTH = "length"


@dataclass(frozen=True)
class StepModel:
    """Coefficients of a step's cost, and of the weight that a cell's cost becomes."""

    kind: StepCost
    scale: float
    length_term: tuple[float, float]
    weight_term: tuple[float, float]

    @classmethod
    def of(cls, step_cost: str, omega: float = PAPER_OMEGA) -> "StepModel":
        """The model of that name; InvalidQueryError for another name or an omega below 0."""
        if step_cost == StepCost.LENGTH:
            return cls(StepCost.LENGTH, 1.0, (0.0, 0.0), (0.5, 0.5 * SQRT2))
        if step_cost != StepCost.PAPER:
            raise InvalidQueryError(f"step_cost must be 'paper' or 'length', got {step_cost!r}")
        if not 0.0 <= omega < math.inf:
            raise InvalidQueryError(f"omega must be a finite number of at least 0, got {omega}")
        return cls(StepCost.PAPER, GREY_LEVELS * omega, (1.0, SQRT2), (1.0, 1.0))

    def step(self, kind: int, weights: float) -> float:
        """Cost of a straight (0) or diagonal (1) step between cells whose weights sum to `weights`."""
        return self.length_term[kind] + self.weight_term[kind] * weights


@kernel
def _pad(cost, scale, ceiling, first, stride, weights, extremes):
    """Weights of a rectangle into the padded map, from node `first` on; extremes = least, greatest.

    The number of costs below 0.
    """
    bad = 0
    least, greatest = extremes[0], extremes[1]
    for row in range(cost.shape[0]):
        base = first + row * stride
        for col in range(cost.shape[1]):
            t = cost[row, col]
            if t < ceiling:
                w = np.float64(np.float32(t * scale))
                if t < 0.0:
                    bad += 1
                weights[base + col] = w
                least = min(least, w)
                greatest = max(greatest, w)
            else:  # NaN comes here too
                weights[base + col] = np.inf
    extremes[0], extremes[1] = least, greatest
    return bad


@kernel
def _compare(cost, scale, ceiling, first, stride, weights, bounds):
    """How many cells of a rectangle these costs would change, and the least cost.

    bounds = first row and column of those cells, and one past the last.
    """
    changed, least = 0, np.float32(np.inf)
    top, left, bottom, right = cost.shape[0], cost.shape[1], 0, 0
    for row in range(cost.shape[0]):
        for col in range(cost.shape[1]):
            t = cost[row, col]
            w = np.float32(t * scale) if t < ceiling else np.float32(np.inf)
            least = min(least, t) if t < np.inf else least  # no NaN comes here
            if w != weights[first + row * stride + col]:
                changed += 1
                top, bottom = min(top, row), row + 1
                left, right = min(left, col), max(right, col + 1)
    bounds[0], bounds[1], bounds[2], bounds[3] = top, left, bottom, right
    return changed, least


@dataclass
class Grid:
    """A map of weights with a border of impassable cells, so that no search need check the map's edge.

    Cell (row, col) stands at the flat index, the `node`, (row + 1) · stride + col + 1.
    """

    rows: int
    cols: int
    model: StepModel
    weights: NDArray[np.float32] = field(repr=False)
    least: float = math.inf
    """No passable cell weighs less; inf as long as there is none."""
    greatest: float = 0.0
    """No passable cell weighs more."""

    @property
    def cells(self) -> int:
        """Number of cells of the map."""
        return self.rows * self.cols

    @property
    def stride(self) -> int:
        """Nodes from one row to the next."""
        return self.cols + 2

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
        grid.update(cost, (0, 0, rows, cols))
        return grid

    def difference(self, cost: Float2D, origin: tuple[int, int]) -> tuple[int, Rectangle]:
        """How many cells `update` would change, and the least rectangle that holds them.

        Parameters
        ----------
        cost : (h, w) float32
            New costs; must lie inside the map.
        origin : (row, col)
            Where the first goes.

        Raises
        ------
        InvalidMapError
            As for `update`; the map is as it was.
        """
        bounds = np.empty(4, np.int64)
        changed, least = _compare(
            cost, np.float32(self.model.scale), self._ceiling, self.node(*origin), self.stride, self.weights, bounds
        )
        lengths = self.model.kind is StepCost.LENGTH
        if least < 0.0 or (lengths and least == 0.0):
            wanted = "greater than 0" if lengths else "at least 0"
            raise InvalidMapError(f"every cost of a patch must be {wanted}, got one of {least:g}")
        top, left, bottom, right = bounds.tolist()
        return int(changed), (origin[0] + top, origin[1] + left, bottom - top, right - left)

    @property
    def _ceiling(self) -> np.float32:
        """Costs from here up are impassable."""
        return np.float32(1.0 if self.model.kind is StepCost.PAPER else np.inf)

    def update(self, cost: Float2D, part: Rectangle, origin: tuple[int, int] = (0, 0)) -> None:
        """Take over a rectangle of the map from `cost`, whose first cell lies at `origin` on the map.

        The bounds on the weights only ever widen, unless the whole map is taken over.

        Raises
        ------
        InvalidMapError
            A cost below 0, or for ``length`` a weight of 0.
        """
        row, col, rows, cols = part
        whole = (rows, cols) == (self.rows, self.cols)
        extremes = np.array([np.inf, -np.inf] if whole else [self.least, self.greatest])
        seen = cost[row - origin[0] : row - origin[0] + rows, col - origin[1] : col - origin[1] + cols]
        bad = _pad(
            seen,
            np.float32(self.model.scale),
            self._ceiling,
            self.node(row, col),
            self.stride,
            self.weights,
            extremes,
        )
        if bad or (self.model.kind is StepCost.LENGTH and extremes[0] == 0.0):
            wanted = "at least 0" if self.model.kind is StepCost.PAPER else "greater than 0"
            raise InvalidMapError(f"every passable cost must be {wanted}, got one of {extremes[0]:g}")
        if math.isfinite(extremes[0]):
            self.least, self.greatest = float(extremes[0]), float(extremes[1])

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
