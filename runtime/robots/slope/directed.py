"""Steps that cost by the slope they lead up or down, on a map of heights and on its coarse levels.

A step's cost here is that of the model less what its rise is worth (`SlopeCost.height_price`): so
it is above 0, and paths between two cells differ by as much as with the costs themselves. What is
reported is those.
"""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arrays import Cells, Float2D, Float32s, Floats, UInt16
from nnpp_edge.runtime.bands import in_bands, stripes
from nnpp_edge.runtime.cells import (
    Cell,
    Rectangle,
    Sides,
    above,
    enclosing,
    slices,
    widened,
)
from nnpp_edge.runtime.kernels.directed import join_steps, pool_steps, price_steps
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.records import FinerSteps, SlopePrices, Ways
from nnpp_edge.runtime.options import CELLS
from nnpp_edge.runtime.robots.robot import WAYS, Edges, PathCosts, Price
from nnpp_edge.runtime.robots.slope.cost import SlopeCost

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.changes import Change
    from nnpp_edge.runtime.map.grid import Grid
    from nnpp_edge.runtime.map.pyramid import Level
    from nnpp_edge.runtime.map.state import MapState

_ROUNDED_DOWN = 1.0 - 1e-6
"""Of the cheapest step: edges are rounded to float32, the prices of the heuristic are not."""
_OBSTACLE = 1.5
"""Cost of an impassable cell in a coarse cell's mean, in times of a level step
(docs/decisions/slope-costs.md).
"""
_THREADS_FROM = 20_000
"""Cells from which on steps are computed by a thread a core."""


class GroundPrice(Price):
    """Costs of steps of a map of heights that depend on the ground, not on the slope: each is a
    metre's on the mean of both ends' ground, the same both ways.
    """

    def __init__(self, heights: Float2D, sides_m: Sides, model: SlopeCost, point: "Grid") -> None:
        self._place = model, heights, sides_m
        self._point = point
        self._cell = np.float32(sides_m[0] * float(model.cost(1.0, 0.0)))
        """Cost of a cell's length."""

    def weights(self, part: Rectangle) -> Float2D:
        weights: Float2D = self._cell * _ground_of(*self._place, part)
        return weights

    def costs_of(self, grid: "Grid", path: Cells) -> PathCosts:
        cost, length, _ = super().costs_of(grid, path)
        return cost, length, super().costs_of(self._point, path)[2]


def _ground_of(model: SlopeCost, heights: Float2D, sides_m: Sides, part: Rectangle) -> Float2D:
    """(h, w) how many times as dear a metre is on the cells of a part; (0, 0) where that does not
    count.
    """
    row, col, rows, cols = part
    top, left, *_ = around = widened(part, (1, 1), heights.shape)
    ground = model.ground(heights[slices(around)], sides_m)
    here: Float2D = ground[slices((row - top, col - left, rows, cols))]
    return here


class CoarseSlopePrice(Price):
    """Costs of the steps of a coarse level, both ways; `prices` are those of the map's
    own steps.
    """

    def __init__(self, shape: Cell, prices: tuple[float, float]) -> None:
        rows, cols = shape
        self.shape = shape
        self._prices = prices
        self.means: Edges = np.full((rows + 2, cols + 2, 8), np.inf, np.float32)
        """By cell (with a border) and direction, what a step within it costs, over the cells of the
        finest level.
        """
        self.finer = FinerSteps(self.means, np.arange(8))
        self.both_ways: Edges = np.full((2, *self.means.shape), np.inf, np.float32)
        """Likewise, of the step that leaves a cell in each direction, and of that by which it is
        come to from its neighbour there.
        """

    def edges(self, backwards: bool = False) -> Edges:
        here: Edges = self.both_ways[int(backwards)]
        return here.reshape(-1, 8)

    def bounds(self, grid: "Grid", shortest: float) -> tuple[float, float, float]:
        return *self._prices, math.inf

    def average(
        self,
        finer: FinerSteps,
        pieces: UInt16,
        area: Rectangle,
        obstacle: Float32s,
    ) -> None:
        """Bring a rectangle of this level's cells up to date, and their steps.

        `finer` is of the map or the finer level; `pieces` and `obstacle` as for
        `kernels.directed.pool_steps`.
        """
        row, col, rows, cols = area
        top, left, tall, wide = widened(area, (1, 1), self.shape)

        def pool(row0: int, row1: int) -> None:
            area = (row0, row1, col, col + cols)  # `records.Area`
            pool_steps(tuple(finer), pieces, obstacle, area, self.means)

        in_bands(pool, row, row + rows, cols, threads_from=_THREADS_FROM)
        join_steps(self.means, (top, top + tall, left, left + wide), *self.both_ways)


class DirectedPrice(Price):
    """Costs of the steps of a map of heights.

    `heights` (H, W) float32 in metres, C-contiguous and not finite where unknown, are kept: whoever
    changes them says so (`follow`). The grid's own robot, a point or a body, says where steps may
    lead.
    """

    def __init__(
        self,
        heights: Float2D,
        sides_m: Sides,
        model: SlopeCost,
        grid: "Grid",
    ) -> None:
        self._model = model
        self._heights = heights
        self._sides = sides_m
        self._under = grid.robot
        self.shape = grid.shape
        rows, cols = grid.shape
        dy, dx = sides_m
        ground = _ground_of(model, heights, sides_m, (0, 0, rows, cols))
        self._ground = np.ascontiguousarray(ground)
        """(H, W) how many times as dear a metre is on each cell; (0, 0) where that does not
        count."""
        self.level_cell = dy * float(model.cost(1.0, 0.0))
        leads = np.array(self._under.moves.ways, np.int64)
        lengths = np.hypot(*(leads * sides_m).T)
        by_weights = self._under.moves.over == CELLS
        if by_weights:
            grid.complete()
        ways = Ways(leads, lengths, by_weights, grid.corner_cutting)
        kinks, level, gradient = model.table
        gradient = gradient - model.height_price
        prices = SlopePrices(kinks, level, gradient, model.least_per_m, model.height_price)
        self._rule = heights, self._ground, grid.weights, tuple(prices), tuple(ways)
        """As `price_steps` takes them."""
        least = _ROUNDED_DOWN * model.least_per_m
        straight = least * min(dy, dx)
        self._prices = straight, min(least * math.hypot(dy, dx), 2.0 * straight)
        self.padded: Edges = np.empty((rows + 2, cols + 2, len(lengths)), np.float32)
        """The steps, or a body's legs, by cell (with a border) and direction."""
        self._edges = self.padded.reshape(-1, len(lengths))
        near = np.array([leads.tolist().index([*step]) for step in WAYS])
        self.finer = FinerSteps(self.padded, near)
        self.obstacle = (_OBSTACLE * model.least_per_m * lengths[near]).astype(np.float32)
        """(8,) what an impassable cell counts for in a coarse cell's mean, by direction."""
        self._greatest = straight
        self.padded[:: rows + 1] = self.padded[:, :: cols + 1] = np.inf
        self._compute((0, 0, rows, cols))

    def follow(self, change: "Change", part: Rectangle, *, heights: bool) -> "Change":
        """Bring the steps up to date after a change of the weights, and of the heights in `part`.
        All that leave the cells there or beside them count as changed.
        """
        new = part if heights else (0, 0, 0, 0)
        if len(self._ground) and new[2]:
            new = widened(new, (1, 1), self.shape)
            self._ground[slices(new)] = _ground_of(self._model, self._heights, self._sides, new)
        parts = [each for each in (new, change.part) if each[2]]
        if not parts:
            return change
        around = widened(enclosing(parts), (1, 1), self.shape)
        self._compute(around)
        return change._replace(part=around, cells=around[2] * around[3])

    def edges(self, backwards: bool = False) -> Edges:
        return self._edges

    def walk(self, grid: "Grid", path: Cells, first: int, costs: Floats) -> int:
        blocked = self._under.moves.walk_turns(grid, path, first, costs, self.level_cell)
        cells = path[first:]
        lengths = np.hypot(*(np.diff(cells, axis=0) * self._sides).T)
        with np.errstate(invalid="ignore"):  # wherever steps lead
            heights = self._heights[cells[:, 0], cells[:, 1]]
            rises = np.diff(heights.astype(np.float64))
            steps = self._model.cost(lengths, rises)
            if len(self._ground):
                ground = self._ground[cells[:, 0], cells[:, 1]].astype(np.float64)
                steps *= 0.5 * (ground[1:] + ground[:-1])
            costs[first + 1 :] += np.cumsum(steps)
        costs[first] = 0.0
        return blocked

    def costs_of(self, grid: "Grid", path: Cells) -> PathCosts:
        cost, length, traverse_cost = self._under.price.costs_of(grid, path)
        if len(path):
            costs = np.zeros(len(path))
            self.walk(grid, path, 0, costs)
            cost = float(costs[-1])
        return cost, length, traverse_cost

    def worth(self, start: Cell, end: Cell | None = None) -> Edges | float:
        if end is not None:
            rise = float(self._heights[end]) - float(self._heights[start])
            return self._model.height_price * rise
        rises = self._heights - np.float64(self._heights[start])
        worth = np.where(np.isfinite(rises), self._model.height_price * rises, 0.0)
        return worth.astype(np.float32)

    def bounds(self, grid: "Grid", shortest: float) -> tuple[float, float, float]:
        """Of the cheapest metre over all slopes: no change of the map alters it."""
        straight, diagonal = self._prices
        return straight * shortest, diagonal * shortest, self._greatest

    def coarse(self, shape: Cell, prices: tuple[float, float]) -> CoarseSlopePrice:
        return CoarseSlopePrice(shape, prices)

    def pool(self, levels: Sequence["Level"], changed: Rectangle) -> Iterator[None]:
        finer = self.finer
        part = changed
        for level in levels:
            row, col, rows, cols = part = widened(above(part, FACTOR), (1, 1), level.grid.shape)
            coarse = level.grid.robot.price
            assert isinstance(coarse, CoarseSlopePrice)
            for first, last in stripes(rows, 8 * FACTOR**2 * cols):
                area = (row + first, col, last - first, cols)
                coarse.average(finer, level.pieces, area, self.obstacle)
                yield
            finer = coarse.finer

    def _compute(self, part: Rectangle) -> None:
        """Compute the steps that leave a rectangle's cells, on all cores where that pays."""
        row, col, rows, cols = part
        dearest = [self._greatest]

        def price(row0: int, row1: int) -> None:
            area = (row0, row1, col, col + cols)  # `records.Area`
            dearest.append(float(price_steps(*self._rule, area, self.padded)))

        in_bands(price, row, row + rows, cols, threads_from=_THREADS_FROM)
        self._greatest = max(dearest)


def price_of(state: "MapState", model: SlopeCost, sides_m: Sides) -> Price:
    """What the steps of a map's robot cost by a model: by its cells, where these say it all."""
    assert state.heights is not None
    heights = state.heights.array
    dy, dx = sides_m
    if model.symmetric and dy == dx and state.grid.robot.moves.over == CELLS:
        return GroundPrice(heights, sides_m, model, state.point)
    return DirectedPrice(heights, sides_m, model, state.grid)
