"""Elevations that maps are made of, and planners of such a map that has just arrived."""

from dataclasses import dataclass

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.loop.world import World
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.terrain.traversability import Traversability, sides_of, traversability_cost


@dataclass(frozen=True)
class Ground:
    """Elevations, and how they become costs."""

    elevation: Float2D
    """(H, W) float32, metres; C-contiguous."""
    cell_size_m: float
    cell_width_m: float
    limits: Traversability

    def cost(self) -> Float2D:
        """The whole cost map, (H, W) float32."""
        return traversability_cost(
            self.elevation, self.cell_size_m, self.limits, cell_width_m=self.cell_width_m, warn=False
        )

    def planner(self, model: str | NetworkModel = "edge", *, lazy: bool = True) -> Planner:
        """`Planner.of_elevation`."""
        return Planner.of_elevation(
            self.elevation,
            self.cell_size_m,
            self.limits,
            cell_width_m=self.cell_width_m,
            lazy=lazy,
            model=model,
            warn=False,
        )

    def state(self, *, lazy: bool = True) -> MapState:
        """The map alone, in the paper's step costs."""
        sides = sides_of(self.cell_size_m, self.cell_width_m)
        return MapState.of_elevation(self.elevation, sides, self.limits, StepModel.of("paper"), lazy=lazy)

    def world(self) -> World:
        """The map of an onboard loop."""
        return World.of_elevation(self.elevation, self.cell_size_m, self.limits, cell_width_m=self.cell_width_m)
