"""Steps that cost by the slope they lead up or down, on a map of heights and on its coarse levels.

A step's cost here is that of the model less what its rise is worth (`SlopeCost.height_price`): so
it is above 0, and paths between two cells differ by as much as with the costs themselves. What is
reported is those.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.bands import in_bands
from nnpp_edge.runtime.cells import Cell, Rectangle, enclosing, widened
from nnpp_edge.runtime.kernels.directed import join_steps, pool_steps, price_steps
from nnpp_edge.runtime.kernels.lattice import FIXED
from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP
from nnpp_edge.runtime.kernels.records import FinerSteps, SlopePrices, Ways
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.motions import DIRECTIONS
from nnpp_edge.runtime.map.poses import between
from nnpp_edge.runtime.map.slope_cost import SlopeCost
from nnpp_edge.runtime.map.steps import Edges, PointSteps, PoseSteps, States

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid

_ROUNDED_DOWN = 1.0 - 1e-6
"""Of the cheapest step: edges are rounded to float32, the prices of the heuristic are not."""
_OBSTACLE = 1.5
"""Cost of an impassable cell in a coarse cell's mean, in times of a level step
(docs/decisions/slope-costs.md).
"""
_THREADS_FROM = 20_000
"""Cells from which on steps are computed by a thread a core."""


class CoarseSteps(PointSteps):
    """Costs of the steps of a coarse level, both ways; `prices` are those of the map's
    own steps.
    """

    by_slope = True

    def __init__(self, shape: Cell, prices: tuple[float, float]) -> None:
        rows, cols = shape
        self.shape = shape
        self.prices = prices
        self.means: Edges = np.full((rows + 2, cols + 2, 8), np.inf, np.float32)
        """By cell (with a border) and direction, what a step within it costs, over the cells of the
        finest level.
        """
        self.finer = FinerSteps(self.means, np.arange(8))
        nodes = (rows + 2) * (cols + 2)
        self.forwards: Edges = np.full((nodes, 8), np.inf, np.float32)
        """(nodes, 8) of the step that leaves a node in each direction."""
        self.backwards: Edges = np.full((nodes, 8), np.inf, np.float32)
        """(nodes, 8) of the step by which a node is come to from its neighbour in each
        direction.
        """

    def edges(self, backwards: bool = False) -> Edges:
        return self.backwards if backwards else self.forwards

    def pool(
        self,
        finer: FinerSteps,
        pieces: NDArray[np.uint16],
        area: Rectangle,
        obstacle: NDArray[np.float32],
    ) -> None:
        """Bring a rectangle of this level's cells up to date, and their steps.

        `finer` is of the map or the finer level; `pieces` and `obstacle` as for
        `kernels.directed.pool_steps`.
        """
        edges, backwards = (
            each.reshape(self.means.shape) for each in (self.forwards, self.backwards)
        )
        (row, col, rows, cols), (top, left, tall, wide) = area, widened(area, (1, 1), self.shape)

        def pool(row0: int, row1: int) -> None:
            area = (row0, row1, col, col + cols)  # `records.Area`
            pool_steps(tuple(finer), pieces, obstacle, area, self.means)

        in_bands(pool, row, row + rows, cols, threads_from=_THREADS_FROM)
        join_steps(self.means, (top, top + tall, left, left + wide), edges, backwards)


class DirectedSteps(PointSteps):
    """Costs of the steps of a map of heights.

    `heights` (H, W) float32 in metres, C-contiguous and not finite where unknown, are kept: whoever
    changes them says so (`follow`). The grid's own steps, a point's or poses', say where these may
    lead.
    """

    by_slope = True

    def __init__(
        self,
        heights: NDArray[np.float32],
        sides_m: tuple[float, float],
        model: SlopeCost,
        grid: "Grid",
    ) -> None:
        self._model = model
        self._heights = heights
        self._sides = sides_m
        self._under = grid.steps
        self.shape = grid.shape
        rows, cols = grid.shape
        dy, dx = sides_m
        self.by_poses = by_poses = grid.steps.by_poses
        self.states_a_node = grid.steps.states_a_node
        self.shortest = grid.steps.shortest
        self.readiness = grid.steps.readiness * dy * float(model.cost(1.0, 0.0))
        self.columns = grid.steps.columns
        leads = np.array(DIRECTIONS if by_poses else _NEIGHBOURS, np.int64)
        lengths = np.hypot(*(leads * sides_m).T)
        self._ways = Ways(leads, lengths, not by_poses, grid.corner_cutting)
        self._weights = np.empty(0, np.float32) if by_poses else grid.weights
        kinks, level, gradient = model.table
        gradient = gradient - model.height_price
        self._slope_prices = SlopePrices(kinks, level, gradient, model.least_per_m)
        least = _ROUNDED_DOWN * model.least_per_m
        straight = least * min(dy, dx)
        self.prices = straight, min(least * math.hypot(dy, dx), 2.0 * straight)
        """Cost of getting a straight and a diagonal step closer where all ways are as cheap as the
        cheapest.
        """
        self._edges: Edges = np.empty(((rows + 2) * (cols + 2), len(lengths)), np.float32)
        near = np.array([leads.tolist().index([*step]) for step in _NEIGHBOURS])
        self.finer = FinerSteps(self.padded, near)
        self.obstacle = (_OBSTACLE * model.least_per_m * lengths[near]).astype(np.float32)
        """(8,) what an impassable cell counts for in a coarse cell's mean, by direction."""
        self._greatest = straight
        self.padded[:: rows + 1] = self.padded[:, :: cols + 1] = np.inf
        self._compute((0, 0, rows, cols))

    @property
    def padded(self) -> Edges:
        """(H + 2, W + 2, 8 or 16) the steps, or a body's legs, by cell and direction, within a
        border.
        """
        return self._edges.reshape(self.shape[0] + 2, self.shape[1] + 2, -1)

    def follow(self, change: Change, heights: Rectangle) -> Change:
        """Bring the steps up to date after a change of the weights, and of the heights in a
        rectangle.

        Returns the change with the cells whose steps cost something else now.
        """
        parts = [part for part in (heights, change.part) if part[2] and part[3]]
        if not parts:
            return change
        row, col, rows, cols = part = widened(enclosing(parts), (1, 1), self.shape)
        here = self.padded[row + 1 : row + rows + 1, col + 1 : col + cols + 1]
        before = here.copy()
        self._compute(part)
        changed = (here != before).any(2)
        if not changed.any():
            return change
        found = np.argwhere(changed)
        (top, left), (bottom, right) = found.min(0).tolist(), found.max(0).tolist()
        steps = row + top, col + left, bottom - top + 1, right - left + 1
        whole = enclosing([steps, change.part]) if change.cells else steps
        cheaper = change.cheaper or bool((here < before).any())
        return change._replace(part=whole, cells=max(change.cells, len(found)), cheaper=cheaper)

    def edges(self, backwards: bool = False) -> Edges:
        return self._edges

    def states(self) -> States | None:
        if not isinstance(self._under, PoseSteps):
            return None
        packed, _, (unit, moves, fares, origins, rays, lengths, _) = self._under.states()
        metre = float(self._model.cost(1.0, 0.0))
        turns = fares.copy()
        turns[..., FIXED] *= self._sides[0] * metre
        by_angle = between(self._under.poses.turns_m * metre)
        return packed, self._edges, (unit, moves, turns, origins, rays, lengths, by_angle)

    def stands_at(self, grid: "Grid", cell: Cell) -> bool:
        return self._under.stands_at(grid, cell)

    def walk(
        self, grid: "Grid", path: NDArray[np.int32], first: int, costs: NDArray[np.float64]
    ) -> int:
        blocked = self._under.walk(grid, path, first, costs)
        cells = path[first:]
        lengths = np.hypot(*(np.diff(cells, axis=0) * self._sides).T)
        with np.errstate(invalid="ignore"):  # wherever steps lead
            rises = np.diff(self._heights[cells[:, 0], cells[:, 1]].astype(np.float64))
            legs = np.cumsum(self._model.cost(lengths, rises))
        if (states := self.states()) is not None and isinstance(self._under, PoseSteps):
            _, moves, fares, origins, rays, lengths, by_angle = states[2]
            turns = fares * np.array((0.0, 1.0), np.float32)
            by_turns = np.float32(0.0), moves, turns, origins, rays, lengths, by_angle
            blocked = self._under.poses.walk(path, first, costs, prices=by_turns)
            legs = legs + costs[first + 1 :]
        costs[first] = 0.0
        costs[first + 1 :] = legs
        return blocked

    def costs_of(self, grid: "Grid", path: NDArray[np.int32]) -> tuple[float, float, float]:
        cost, length, traverse_cost = self._under.costs_of(grid, path)
        if len(path):
            costs = np.zeros(len(path))
            self.walk(grid, path, 0, costs)
            cost = float(costs[-1])
        return cost, length, traverse_cost

    def worth_of_height(self, start: Cell, goal: Cell) -> float:
        rise = float(self._heights[goal[0], goal[1]]) - float(self._heights[start[0], start[1]])
        return self._model.height_price * rise

    def with_heights(self, field: NDArray[np.float32], start: Cell) -> NDArray[np.float32]:
        rise = self._heights - np.float64(self._heights[start])
        return field + np.where(np.isfinite(rise), self._model.height_price * rise, 0.0).astype(
            np.float32
        )

    def greatest(self, grid: "Grid") -> float:
        return self._greatest

    def _compute(self, part: Rectangle) -> None:
        """Compute the steps that leave a rectangle's cells, on all cores where that pays."""
        row, col, rows, cols = part
        dearest = [self._greatest]
        rule = tuple(self._slope_prices), tuple(self._ways)

        def price(row0: int, row1: int) -> None:
            area = (row0, row1, col, col + cols)  # `records.Area`
            priced = price_steps(self._heights, self._weights, *rule, area, self.padded)
            dearest.append(float(priced))

        in_bands(price, row, row + rows, cols, threads_from=_THREADS_FROM)
        self._greatest = max(dearest)


_NEIGHBOURS = tuple(zip(ROW_STEP, COL_STEP, strict=True))
