"""Steps that cost by the slope they lead up or down, on a map of heights and on its coarse levels.

A step's cost here is that of the model less what its rise is worth (`SlopeCost.height_price`): so it is above 0, and
paths between two cells differ by as much as with the costs themselves. What is reported is those, see `costs_along`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.bands import in_bands
from nnpp_edge.runtime.cells import Cell, Rectangle, enclosing
from nnpp_edge.runtime.kernels.nodes import COL_STEP, OPPOSITE, ROW_STEP
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.slope_cost import SlopeCost
from nnpp_edge.runtime.terrain.traversability import with_rim

_ROUNDED_DOWN = 1.0 - 1e-6
"""Of the cheapest step: edges are rounded to float32, the prices of the heuristic are not."""
_OBSTACLE = 1.5
"""What an impassable cell counts for in a coarse cell's mean, in times of a level step (docs/decisions.md)."""
_BAND = 64
"""Rows whose steps are computed at once."""
Edges = NDArray[np.float32]


class CoarseSteps:
    """What the steps of a coarse level cost, from one cell to the next and back.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the level.
    prices : (float, float)
        Of the map's own steps.
    """

    def __init__(self, shape: Cell, prices: tuple[float, float]) -> None:
        rows, cols = shape
        self.shape, self.prices = shape, prices
        self.means: Edges = np.full((rows + 2, cols + 2, 8), np.inf, np.float32)
        """By cell (with a border) and direction, what a step within it costs, over the cells of the finest level."""
        nodes = (rows + 2) * (cols + 2)
        self.edges: Edges = np.full((nodes, 8), np.inf, np.float32)
        """(nodes, 8) of the step that leaves a node in each direction."""
        self.backwards: Edges = np.full((nodes, 8), np.inf, np.float32)
        """(nodes, 8) of the step by which a node is come to from its neighbour in each direction."""

    def pool(self, finer: Edges, pieces: NDArray[np.uint16], area: Rectangle, obstacle: NDArray[np.float32]) -> None:
        """Bring a rectangle of cells up to date, and their steps.

        Parameters
        ----------
        finer : (rows, cols, 8) float32
            Means of the finer level, or steps of the map, without a border. Those that lead off the map do not count.
        pieces : (nodes,) uint16
            The cells below each cell that it stands for, as bits; what is in none of them counts as an obstacle.
        area : (row, col, rows, cols)
            Of cells of this level.
        obstacle : (8,) float32
            By direction.
        """
        row, col, rows, cols = area
        below = _without_rim(finer, (FACTOR * row, FACTOR * col, FACTOR * rows, FACTOR * cols))
        missing = FACTOR * rows - below.shape[0], FACTOR * cols - below.shape[1]
        if any(missing):
            below = np.pad(below, ((0, missing[0]), (0, missing[1]), (0, 0)), constant_values=np.nan)
        here = np.s_[row + 1 : row + rows + 1, col + 1 : col + cols + 1]
        own = pieces.reshape(self.means.shape[:2])[here]
        total, count = np.zeros((rows, cols, 8), np.float32), np.zeros((rows, cols, 8), np.float32)
        for bit in range(FACTOR * FACTOR):
            steps = below[bit // FACTOR :: FACTOR, bit % FACTOR :: FACTOR]
            in_piece = (own >> bit) & 1 != 0
            on_map = ~np.isnan(steps)
            total += np.where(
                on_map, np.where(in_piece[..., None] & (steps < np.inf), steps, obstacle), np.float32(0.0)
            )
            count += on_map
        means = np.where(count > 0, total / np.maximum(count, 1), obstacle)
        means[own == 0] = np.inf
        self.means[here] = means
        self._join(with_rim(area, self.shape))

    def _join(self, area: Rectangle) -> None:
        """Steps of a rectangle of cells: half by the cell that is left, half by the one that is come to."""
        row, col, rows, cols = area
        here = np.s_[row + 1 : row + rows + 1, col + 1 : col + cols + 1]
        edges, backwards = (each.reshape(self.means.shape) for each in (self.edges, self.backwards))
        half = np.float32(0.5)
        for k, (up, left) in enumerate(zip(ROW_STEP, COL_STEP, strict=True)):
            there = np.s_[row + 1 + up : row + rows + 1 + up, col + 1 + left : col + cols + 1 + left]
            edges[(*here, k)] = half * (self.means[(*here, k)] + self.means[(*there, k)])
            back = OPPOSITE[k]
            backwards[(*here, k)] = half * (self.means[(*here, back)] + self.means[(*there, back)])


def _without_rim(steps: Edges, part: Rectangle) -> Edges:
    """A copy of a rectangle of (rows, cols, 8) steps, as far as it lies on the map; NaN where they lead off it."""
    (row, col, rows, cols), (most_row, most_col, _) = part, steps.shape
    out = steps[row : row + rows, col : col + cols].copy()
    for k, (up, left) in enumerate(zip(ROW_STEP, COL_STEP, strict=True)):
        rim_row, rim_col = (0 if up < 0 else most_row - 1) - row, (0 if left < 0 else most_col - 1) - col
        if up and 0 <= rim_row < out.shape[0]:
            out[rim_row, :, k] = np.nan
        if left and 0 <= rim_col < out.shape[1]:
            out[:, rim_col, k] = np.nan
    return out


class DirectedSteps:
    """What the steps of a map of heights cost.

    Parameters
    ----------
    heights : (H, W) float
        Metres; not finite where unknown. Kept: whoever changes them says so (`follow`).
    sides_m : (float, float)
        Height and width of a cell.
    model : SlopeCost
        What a way costs.
    weights : (nodes,) float32 or None
        Of the map's grid, inf where it is impassable; kept. None where a body's poses decide.
    corner_cutting : bool
        Whether a diagonal step may pass beside an impassable cell.
    """

    def __init__(
        self,
        heights: NDArray[np.floating],
        sides_m: tuple[float, float],
        model: SlopeCost,
        weights: NDArray[np.float32] | None,
        corner_cutting: bool,
    ) -> None:
        self.model, self._heights, self._sides = model, heights, sides_m
        self.shape: Cell = (heights.shape[0], heights.shape[1])
        (rows, cols), (dy, dx) = self.shape, sides_m
        self._weights, self._corner_cutting = weights, corner_cutting or weights is None
        self._lengths = tuple(math.hypot(up * dy, left * dx) for up, left in zip(ROW_STEP, COL_STEP, strict=True))
        least = _ROUNDED_DOWN * model.least_per_m
        straight = least * min(dy, dx)
        self.prices = straight, min(least * self._lengths[-1], 2.0 * straight)
        """Cost of getting a straight and a diagonal step closer where all ways are as cheap as the cheapest."""
        self.edges: Edges = np.full(((rows + 2) * (cols + 2), 8), np.inf, np.float32)
        """(nodes, 8) of the step that leaves a node in each direction; inf where there is none."""
        self.greatest = straight
        """No step costs more, nor has one."""
        in_bands(lambda row0, row1: self._compute((row0, 0, row1 - row0, cols)), rows, cols)
        self.greatest = float(self.edges.max(where=np.isfinite(self.edges), initial=straight))

    @property
    def obstacle(self) -> NDArray[np.float32]:
        """(8,) what an impassable cell counts for in a coarse cell's mean, by direction."""
        return np.array(self._lengths, np.float32) * np.float32(_OBSTACLE * self.model.least_per_m)

    @property
    def map(self) -> Edges:
        """(H, W, 8) steps of the map's own cells; a view."""
        return self._padded[1:-1, 1:-1]

    @property
    def _padded(self) -> Edges:
        return self.edges.reshape(self.shape[0] + 2, self.shape[1] + 2, 8)

    def follow(self, change: Change, heights: Rectangle) -> Change:
        """Bring the steps up to date after a change of the weights, and of the heights in a rectangle.

        Returns the change with the cells whose steps cost something else now.
        """
        parts = [part for part in (heights, change.part) if part[2] and part[3]]
        if not parts:
            return change
        row, col, rows, cols = part = with_rim(enclosing(parts), self.shape)
        here = self.map[row : row + rows, col : col + cols]
        before = here.copy()
        here[:] = np.inf
        self._compute(part)
        changed = (here != before).any(2)
        if not changed.any():
            return change
        self.greatest = max(self.greatest, float(here.max(where=np.isfinite(here), initial=0.0)))
        found = np.argwhere(changed)
        (top, left), (bottom, right) = found.min(0).tolist(), found.max(0).tolist()
        steps = row + top, col + left, bottom - top + 1, right - left + 1
        whole = enclosing([steps, change.part]) if change.cells else steps
        cheaper = change.cheaper or bool((here < before).any())
        return change._replace(part=whole, cells=max(change.cells, len(found)), cheaper=cheaper)

    def worth_of_height(self, start: Cell, goal: Cell) -> float:
        """What the height from one cell to another is worth: by so much a path costs more than its steps here."""
        rise = float(self._heights[goal[0], goal[1]]) - float(self._heights[start[0], start[1]])
        return self.model.height_price * rise

    def heights_from(self, start: Cell) -> NDArray[np.float32]:
        """(H, W) what the height from a cell to every other is worth; 0 where one is not known."""
        rise = self._heights - np.float64(self._heights[start])
        return np.where(np.isfinite(rise), self.model.height_price * rise, 0.0).astype(np.float32)

    def costs_along(self, path: NDArray[np.int32]) -> NDArray[np.float64]:
        """(N - 1,) what the steps of a path cost by the model itself, wherever they lead."""
        heights = self._heights[path[:, 0], path[:, 1]].astype(np.float64)
        steps = np.diff(path, axis=0) * np.array(self._sides)
        with np.errstate(invalid="ignore"):
            return self.model.cost(np.hypot(steps[:, 0], steps[:, 1]), np.diff(heights))

    def first_blocked(self, path: NDArray[np.int32]) -> int:
        """Number of the first cell of a path that no step leads to; -1 if all do."""
        steps = np.diff(path, axis=0)
        kinds = _KIND[steps[:, 0] + 1, steps[:, 1] + 1]
        blocked = np.flatnonzero(np.isinf(self.map[path[:-1, 0], path[:-1, 1], kinds]))
        return int(blocked[0]) + 1 if len(blocked) else -1

    def _compute(self, part: Rectangle) -> None:
        """Compute the steps that leave a rectangle's cells, a band of rows at a time."""
        row, col, rows, cols = part
        for top in range(row, row + rows, _BAND):
            band = top, col, min(_BAND, row + rows - top), cols
            for k in range(8):
                self._compute_direction(k, band)

    def _compute_direction(self, k: int, part: Rectangle) -> None:
        (row, col, rows, cols), (up, left), length = part, (ROW_STEP[k], COL_STEP[k]), self._lengths[k]
        row0, row1 = max(row, -up), min(row + rows, self.shape[0] - up)
        col0, col1 = max(col, -left), min(col + cols, self.shape[1] - left)
        if row0 >= row1 or col0 >= col1:
            return
        here = self._heights[row0:row1, col0:col1].astype(np.float64)
        there = self._heights[row0 + up : row1 + up, col0 + left : col1 + left]
        with np.errstate(invalid="ignore"):
            rise = there - here
            cost = self.model.cost(length, rise) - self.model.height_price * rise
        free = np.isfinite(rise)
        if self._weights is not None:
            weights = self._weights.reshape(self.shape[0] + 2, -1)
            ends = ((0, 0), (up, left))
            for down, right in ends if self._corner_cutting or k < 4 else (*ends, (up, 0), (0, left)):
                free &= np.isfinite(weights[row0 + 1 + down : row1 + 1 + down, col0 + 1 + right : col1 + 1 + right])
        least = self.model.least_per_m * length
        cost = np.where(free, np.maximum(cost, least), np.inf)
        self.map[row0:row1, col0:col1, k] = cost


_KIND = np.zeros((3, 3), np.int64)
"""Direction of a step by its rows and columns, each one more; 0 for no step at all."""
for _k in range(8):
    _KIND[ROW_STEP[_k] + 1, COL_STEP[_k] + 1] = _k
