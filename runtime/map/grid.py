"""The map as the searches see it: weights with a border of impassable cells."""

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import (
    Bool,
    Cells,
    Float2D,
    Float32s,
    Floats,
    Int64,
    as_map,
    close_border,
)
from nnpp_edge.runtime.cells import Cell, Rectangle, patch_at
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.nodes import octile
from nnpp_edge.runtime.kernels.records import CostLimits, Packed
from nnpp_edge.runtime.kernels.weights import fill_costs, write_costs
from nnpp_edge.runtime.map.changes import NO_NODES, NO_WEIGHTS, Change
from nnpp_edge.runtime.map.tiles import COMPLETE, Tiles, rectangle_of
from nnpp_edge.runtime.memory import Number, virtual_zeros
from nnpp_edge.runtime.robots.robot import Robot
from nnpp_edge.runtime.terrain.step_cost import (
    GREY_LEVELS,
    LEAST_WEIGHT,
    PAPER_OMEGA,
    StepCost,
    StepModel,
)

_FAR = 0.25
"""A bound is measured anew when it lies beyond this share, or one over it, of what was measured
last.
"""
_OF_WEIGHTS = CostLimits(*np.array((0.0, np.inf, 1.0, np.inf), np.float32))
"""Limits of costs that are weights already."""
ALL_SEEN = np.empty((0, 0), np.bool_)
"""Of a patch whose cells are all written."""


class Grid:
    """Weights of a map's cells, and what a step between two of them costs.

    Cell (row, col) stands at the flat index, the `node`, (row + 1) · stride + col + 1, within a
    border. By default all cells are impassable at first. With `tiles` weights are computed by
    these, as the level of that number; the bounds are T's own then.
    """

    def __init__(
        self,
        rows: int,
        cols: int,
        model: StepModel,
        corner_cutting: bool = True,
        weights: Float32s | None = None,
        tiles: Tiles | None = None,
        level: int = 0,
    ) -> None:
        self.rows = rows
        self.cols = cols
        self.model = model
        self.corner_cutting = corner_cutting
        self.cells = rows * cols
        self.stride = cols + 2
        """Number of cells of the map, and nodes from one row to the next."""
        if weights is None:
            weights = np.full((rows + 2) * (cols + 2), np.inf, np.float32)
        self.weights: Float32s = weights
        """(nodes,) weights; inf where impassable."""
        self.tiles = tiles
        """By which weights are computed where a search reads them; None where all are there."""
        packed_tiles = COMPLETE if tiles is None else tiles.packed(level)
        steps = (*model.length_term, *model.weight_term)  # `records.StepTerms`
        self._record = (self.weights, self.stride, steps, corner_cutting, packed_tiles)
        floor, most, ceiling = map(np.float32, model.costs)
        self._limits = CostLimits(floor, most, np.float32(model.scale), ceiling)
        self.least = math.inf if tiles is None else 0.0
        self.greatest = 0.0 if tiles is None else model.scale
        self.drive_by(Robot())

    @classmethod
    def of(cls, cost: Float2D, model: StepModel, corner_cutting: bool = True) -> "Grid":
        """The grid of a whole cost map.

        Parameters
        ----------
        cost : (H, W) float
            For ``paper`` T from 0, impassable from 1 up; for ``length`` a weight from
            `LEAST_WEIGHT` to `MOST_WEIGHT`, impassable where infinite. NaN and masked cells are
            impassable in both.
        """
        cost = as_map(cost, "cost")
        rows, cols = cost.shape
        grid = cls(rows, cols, model, corner_cutting, bordered(rows, cols))
        limits = grid._limits
        low, high, below = fill_costs(cost, tuple(limits), grid.weights, grid.stride)
        lowest, highest = np.array((low, high), np.int32).view(np.float32)
        too_low = below or bool(lowest < limits.floor)
        if too_low or highest > limits.most:
            passable = cost[cost < limits.ceiling]
            model.refuse(float(passable.min() if too_low else passable.max()))
        if lowest < math.inf:
            grid.set_bounds(float(lowest * limits.scale), float(highest * limits.scale))
        return grid

    def drive_by(self, robot: Robot) -> None:
        """From now on this robot drives on the map, by default a point; the weights remain what
        coarse levels are made of.
        """
        self.robot = robot
        """Where it may stand, and what its steps cost."""
        self.packed: Packed = (*self._record, robot.price.edges())
        """As kernels take it, `records.GridRecord`."""
        self.set_bounds(self.least, self.greatest)

    def least_cost(self, start: Cell, goal: Cell) -> float:
        """Least cost of a path between two cells, which may lie outside the map."""
        straight = float(octile.py_func(*start, *goal, *self.prices))
        both = self.holds(start) and self.holds(goal)
        return straight + float(self.robot.price.worth(start, goal)) if both else straight

    def complete(self, deadline: Deadline = NEVER) -> None:
        """See to it that all weights are there, and all poses checked; OutOfTimeError at the
        deadline.
        """
        if self.tiles is not None:
            self.tiles.complete(deadline)
        self.robot.stance.complete()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self.rows, self.cols

    def set_bounds(self, least: float, greatest: float) -> None:
        """No passable cell weighs less than `least`, inf as long as there is none, and none more
        than `greatest`.
        """
        self._measured = least, greatest
        self.least = least
        self.greatest = greatest
        vars(self).pop("bounds", None)

    @cached_property
    def bounds(self) -> tuple[float, float, float]:
        """As `Price.bounds`."""
        return self.robot.price.bounds(self, self.robot.moves.shortest)

    @property
    def prices(self) -> tuple[float, float]:
        """Cost of getting a straight and a diagonal step closer."""
        return self.bounds[:2]

    @property
    def step_ratio(self) -> float:
        """Cost of the dearest step, in times of the cheapest."""
        return self.bounds[2] / self.bounds[0]

    def measure_bounds(self) -> None:
        """Set the bounds to what the weights are."""
        greatest = self.weights.max(where=self.weights < np.inf, initial=0.0)
        self.set_bounds(float(self.weights.min()), float(greatest))

    def update(
        self,
        cost: Float2D,
        origin: Cell = (0, 0),
        *,
        keep_old_weights: bool = False,
        seen: Bool | None = None,
        weights: bool = False,
    ) -> Change:
        """Put new costs (h, w), as for `of`, or `weights`, into a rectangle of the map, whose first
        cell is `origin`.

        The bounds on the weights widen; they are measured anew where they have become much wider,
        and a cell at one of them has changed. `seen` are the cells that get new costs, by default
        all; with `keep_old_weights` the change says what the changed cells weighed before.
        InvalidMapError where the rectangle does not lie inside the map or a cost is out of range:
        the map is as it was.
        """
        cost = as_map(cost, "patch")
        row, col, rows, cols = patch_at(origin, cost.shape, self.shape)
        whole = cost.shape == self.shape and seen is None
        bounds = (math.inf, -math.inf) if whole else (self.least, self.greatest)
        nodes = NO_NODES
        old = NO_WEIGHTS
        if keep_old_weights:
            nodes = np.empty(rows * cols, np.int32)
            old = np.empty(rows * cols, np.float32)
        refused, cells, cheaper, area, widened, at_bound = write_costs(
            cost,
            ALL_SEEN if seen is None else seen,
            tuple(_OF_WEIGHTS if weights else self._limits),
            self.node(row, col),
            self.stride,
            self.weights,
            bounds,
            nodes,
            old,
        )
        least, greatest = widened
        if refused < math.inf:
            self.model.refuse(refused)
        before = (self.least, self.greatest)
        low, high = self._measured
        lengths = self.model.kind is StepCost.LENGTH
        if math.isfinite(least):
            self.set_bounds(least, greatest)
        if not whole:
            self._measured = low, high
            if lengths and at_bound and (least < _FAR * low or _FAR * greatest > high):
                self.measure_bounds()
        rescaled = lengths and before != (self.least, self.greatest)
        top, left, changed_rows, changed_cols = rectangle_of(area)
        part = (row + top, col + left, changed_rows, changed_cols)
        if keep_old_weights:
            nodes = nodes[:cells].copy()
            old = old[:cells].copy()
        return Change(part, cells, cheaper, rescaled, nodes, old)

    def as_traversability(self) -> tuple[float, float]:
        """Scale and offset from a weight to a traversability cost T in [0, 1].

        In the ``length`` model a cell of the cheapest weight counts as T = 0, and one of 1 +
        2·255·ω times that weight as T = 1: so straight steps cost alike, up to a factor, in both
        models.
        """
        if self.model.kind is StepCost.PAPER:
            return (1.0 / self.model.scale if self.model.scale else 0.0), 0.0
        span = 2.0 * GREY_LEVELS * PAPER_OMEGA
        return 1.0 / (span * max(self.least, LEAST_WEIGHT)), -1.0 / span

    def map(self) -> Float2D:
        """(rows, cols) float32, the weights of the map's own cells; a view."""
        self.complete()
        return self.inner(self.weights)

    def inner(self, nodes: NDArray[Number]) -> NDArray[Number]:
        """(rows, cols) of numbers by node, those of the map's own cells; a view."""
        return nodes.reshape(self.rows + 2, self.stride)[1:-1, 1:-1]

    def node(self, row: int, col: int) -> int:
        """Flat index of a cell."""
        return (row + 1) * self.stride + col + 1

    def nodes(self, part: Rectangle) -> Int64:
        """(rows, cols) flat indices of a rectangle's cells."""
        row, col, rows, cols = part
        down = self.stride * np.arange(rows)
        nodes: Int64 = self.node(row, col) + down[:, None] + np.arange(cols)
        return nodes

    def cell(self, node: int) -> Cell:
        """The cell at a flat index."""
        return node // self.stride - 1, node % self.stride - 1

    def holds(self, cell: Cell) -> bool:
        """Whether a cell lies inside the map."""
        return 0 <= cell[0] < self.rows and 0 <= cell[1] < self.cols

    def walk(self, path: Cells, first: int, costs: Floats) -> int:
        """Write what a path (N, 2) inside the map costs from its cell `first` to each later one
        into `costs` (N,).

        Returns the number of the first cell, from `first` on, that cannot be stepped on; -1 if all
        can. InvalidQueryError where the path leaves the map, or `costs` has too little room.
        """
        self._check(path)
        if len(costs) < len(path):
            raise InvalidQueryError(f"wanted room for {len(path)} costs, got {len(costs)}")
        return self.robot.price.walk(self, path, first, costs)

    def costs_of(self, path: Cells) -> tuple[float, float, float]:
        """Cost, length in cells and CC of a path, summed in float64; inf for an empty one.

        InvalidQueryError where it leaves the map.
        """
        self._check(path)
        return self.robot.price.costs_of(self, path)

    def _check(self, path: Cells) -> None:
        """InvalidQueryError for a path that leaves the map: kernels would read what lies there."""
        if not ((path[:, :2] >= 0) & (path[:, :2] < self.shape)).all():
            raise InvalidQueryError(f"a path must lie on the map of {self.shape} cells")

    def is_passable(self, cell: Cell) -> bool:
        """Whether a cell of the map can be stood on."""
        return self.robot.stance.stands_at(self, cell)[0]


def bordered(rows: int, cols: int, *, small: bool = False) -> Float32s:
    """Room for a map's weights within an impassable border. Pages of it that nobody touches take no
    time.

    With `small` pages no memory either, but under the border.
    """
    nodes = (rows + 2) * (cols + 2)
    padded = virtual_zeros(nodes, np.float32) if small else np.empty(nodes, np.float32)
    close_border(padded, rows, cols)
    return padded
