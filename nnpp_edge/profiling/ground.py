"""Elevations that maps are made of, and planners of such a map that has just arrived."""

from dataclasses import dataclass

import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.map.ground import Ground as RobotsGround
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.map.slope_cost import Mobility
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import Vehicle

Patch = tuple[int, int, Float2D]
"""Row and column of the first cell, and heights in metres."""
_PATCH_SIDE = 64


def patch_side(shape: tuple[int, ...]) -> int:
    """Cells to a side of the patches that a map of this shape gets: 64, on small maps a quarter of its side."""
    return min(_PATCH_SIDE, max(min(shape) // 4, 1))


@dataclass(frozen=True)
class Ground:
    """Elevations, and how they become costs."""

    elevation: Float2D
    """(H, W) float32, metres; C-contiguous."""
    cell_size_m: float
    cell_width_m: float
    limits: Traversability
    vehicle: Vehicle | None = None
    """The body whose poses cost; None for a point."""
    step_cost: str = "paper"
    """As for `Planner.of_elevation`."""
    mobility: Mobility | None = None

    def cost(self) -> Float2D:
        """The whole cost map, (H, W) float32; with a vehicle that of each cell's best pose, inf where all fail."""
        if self.vehicle is not None:
            size, width = self.cell_size_m, self.cell_width_m
            poses = pose_costs(self.elevation, size, self.vehicle, cell_width_m=width, traversability=self.limits)
            best: Float2D = poses.min(0)
            return best
        return self.robot().costs()

    def planner(self, model: str | NetworkModel = "edge", *, lazy: bool = True) -> Planner:
        """A planner of its own."""
        return Planner(self.robot(), model=model, lazy=lazy)

    @property
    def is_directed(self) -> bool:
        """Whether steps cost by the slope they lead up or down."""
        return self.step_cost != "paper"

    def state(self, *, lazy: bool = True) -> MapState:
        """The map alone."""
        return self.robot().state(lazy=lazy)

    def robot(self) -> RobotsGround:
        """The same for the runtime."""
        return RobotsGround.of_elevation(
            self.elevation,
            self.cell_size_m,
            self.limits,
            cell_width_m=self.cell_width_m,
            vehicle=self.vehicle,
            step_cost=self.step_cost,
            mobility=self.mobility,
        )

    def with_hill(self, cell: Cell) -> Patch:
        """A square patch around a cell in which a hill stands that is too steep for most rovers: 42°."""
        shape = self.elevation.shape
        side = patch_side(shape)
        row, col = (min(max(at - side // 2, 0), n - side) for at, n in zip(cell, shape, strict=True))
        along = (np.arange(side) - 0.5 * (side - 1)) / (side / 6.0)
        bump = np.exp(-0.5 * (along[:, None] ** 2 + along**2))
        height_m = 1.5 * side / 6.0 * self.cell_size_m
        heights = self.elevation[row : row + side, col : col + side] + height_m * bump
        return row, col, heights.astype(np.float32)

    def cut_out(self, patch: Patch) -> Patch:
        """The elevations as they are where a patch lies."""
        row, col, heights = patch
        rows, cols = heights.shape
        return row, col, self.elevation[row : row + rows, col : col + cols]
