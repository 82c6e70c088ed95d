"""Costs of a step between two cells, and where one may lead: for a point, and for a vehicle's
poses.

Those by the slope are in `directed`. All are asked by way of a `Grid`, which they do not keep.
Searches, standing paths and whoever prices a path ask alike, and never which they are. Another kind
of step is a class like these, and the kernels that take what it packs.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.kernels.lattice import KNIGHT
from nnpp_edge.runtime.kernels.paths import measure, walk
from nnpp_edge.runtime.map import motions
from nnpp_edge.runtime.map.poses import NO_EDGES, PackedPoses, Poses, Prices
from nnpp_edge.runtime.map.step_cost import SQRT2

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid

Edges = NDArray[np.float32]
States = tuple[PackedPoses, Edges, Prices]
"""A body's motions and what they cost, as `kernels.lattice.expand_states` takes them."""


class PointSteps:
    """Steps that cost by the weights of their ends, see `step_cost`."""

    by_poses = by_slope = False
    """Whether a vehicle's poses are checked; whether steps cost otherwise one way than
    the other.
    """
    states_a_node = 1
    columns = 2
    """Places of a search on a node; numbers of a place on a path, three where its state counts."""
    shortest = 1.0
    readiness = 0.0
    """Length of the shortest way over that by straight and diagonal steps; by how much a body on
    its way may have it cheaper than one that sets out from the same cell: as it need not turn
    round, or has the right gear in.
    """

    def edges(self, backwards: bool = False) -> Edges | None:
        """Costs of the steps, as searches take them; `backwards` of those that come to a cell, on a
        coarse level.

        None where steps cost by the weights of their ends.
        """
        return None

    def states(self) -> States | None:
        """A body's motions; None where a search goes over cells."""
        return None

    def stands_at(self, grid: "Grid", cell: Cell) -> bool:
        """Whether a cell of the map can be stood on."""
        if grid.tiles is not None:
            grid.tiles.open_at(*cell)
        return math.isfinite(grid.weights[grid.node(*cell)])

    def walk(
        self, grid: "Grid", path: NDArray[np.int32], first: int, costs: NDArray[np.float64]
    ) -> int:
        """As `Grid.walk`."""
        if grid.tiles is not None:
            grid.tiles.open_along(path[first:])
        return int(walk(grid.packed, path, first, costs))

    def costs_of(self, grid: "Grid", path: NDArray[np.int32]) -> tuple[float, float, float]:
        """Cost, length in cells and CC of a path, summed in float64; inf for an empty one."""
        if not len(path):
            return math.inf, math.inf, math.inf
        if grid.tiles is not None:  # a search may not have read all of it
            grid.tiles.open_along(path)
        straight, diagonal, by_straight, by_diagonal, total = measure(
            grid.weights, grid.stride, path
        )
        length_s, length_d, weight_s, weight_d = grid.model.steps
        cost = (
            length_s * straight
            + length_d * diagonal
            + weight_s * by_straight
            + weight_d * by_diagonal
        )
        scale = grid.model.scale
        return cost, straight + SQRT2 * diagonal, total / scale if scale else 0.0

    def worth_of_height(self, start: Cell, goal: Cell) -> float:
        """By how much a path between two cells costs more than its steps as searches take them."""
        return 0.0

    def with_heights(self, field: NDArray[np.float32], start: Cell) -> NDArray[np.float32]:
        """(H, W) costs from a cell to every other, given what a search sums up."""
        return field

    def greatest(self, grid: "Grid") -> float:
        """No step costs more."""
        return grid.model.step(0, 2.0 * grid.greatest)


class PoseSteps(PointSteps):
    """A body's legs and turns. A leg costs its length by what it is checked to be, a turn by its
    angle.
    """

    by_poses = True

    def __init__(self, poses: Poses) -> None:
        self.poses = poses
        vehicle = poses.vehicle
        by_turning = float(poses.prices[-1].max())
        by_gear = vehicle.gear_change_m / poses.sides_m[0]
        self.readiness = by_turning if vehicle.turning_radius_m is None else by_gear
        self.states_a_node = len(poses.prices[1])
        self.shortest = KNIGHT * poses.primitives.shortest
        self.columns = 2 if vehicle.turning_radius_m is None else 3

    def states(self) -> States:
        return self.poses.packed, NO_EDGES, self.poses.prices

    def stands_at(self, grid: "Grid", cell: Cell) -> bool:
        return self.poses.stands_at(cell)

    def walk(
        self, grid: "Grid", path: NDArray[np.int32], first: int, costs: NDArray[np.float64]
    ) -> int:
        blocked = self.poses.walk(path, first, costs)
        if (
            blocked < 0
            and first == len(path) - 1
            and not self.poses.stands_at((int(path[-1, 0]), int(path[-1, 1])))
        ):
            return first
        return blocked

    def costs_of(self, grid: "Grid", path: NDArray[np.int32]) -> tuple[float, float, float]:
        if not len(path):
            return math.inf, math.inf, math.inf
        costs = np.zeros(len(path))
        cost = math.inf if self.poses.walk(path, 0, costs) >= 0 else float(costs[-1])
        lengths, rated = self.poses.cost_along(path)
        return cost, float(lengths.sum()), float((lengths * rated).sum())

    def greatest(self, grid: "Grid") -> float:
        return max(math.hypot(*axis) for axis in motions.AXES) * (1.0 + 2.0 * grid.model.scale)
