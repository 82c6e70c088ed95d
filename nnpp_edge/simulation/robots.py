"""What a robot is to the simulation: a point that goes by costs, or a body that stands on heights.

A map of the simulation holds the values that its robot goes by. The scene moves values about and puts obstacles on
them; what they mean, its robot says.
"""

import math
from typing import Protocol, TypedDict

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.loop.messages import MapPatch
from nnpp_edge.runtime.loop.world import Terrain, World
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.map.slope_cost import Mobility
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import HEADINGS, Vehicle
from nnpp_edge.simulation.pose_check import PoseCheck, headings_of
from nnpp_edge.terrain.obstacles import OBSTACLE


class Surface(TypedDict):
    """Arguments of `Planner.of_elevation` and `World.of_elevation`."""

    cell_size_m: float
    cell_width_m: float
    traversability: Traversability
    vehicle: Vehicle | None
    step_cost: str
    mobility: Mobility | None


class Robot(Protocol):
    """What a scene asks of its robot. `values` is a map, (H, W) float32."""

    @property
    def vehicle(self) -> Vehicle | None:
        """Its body, to be drawn; None for a point."""

    @property
    def sides_m(self) -> tuple[float, float]:
        """Height and width of a cell, which a point need not know."""

    @property
    def reach(self) -> int:
        """Cells from its own to the farthest that lies under it."""

    def obstacle(self, values: Float2D) -> float:
        """The value of an obstacle's cells on this map."""

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """Whether it may be in a cell of the map."""

    def steps(self, values: Float2D, path: NDArray[np.int32]) -> NDArray[np.bool_]:
        """(N - 1,) whether it may take each step of a path inside the map, of neighbouring cells."""

    def costs(self, values: Float2D) -> Float2D:
        """(H, W) traversability cost of each cell; impassable from 1 up."""

    def planner(self, values: Float2D) -> Planner:
        """A planner of the map."""

    def world(self, values: Float2D) -> World:
        """The onboard loop's map."""

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """The message that tells the loop of values."""


class Point:
    """A robot as large as a cell. Values are traversability costs."""

    vehicle = None
    sides_m = 1.0, 1.0
    reach = 0

    def obstacle(self, values: Float2D) -> float:
        """The paper's."""
        return OBSTACLE

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """On passable cells."""
        return bool(values[cell] < OBSTACLE)

    def steps(self, values: Float2D, path: NDArray[np.int32]) -> NDArray[np.bool_]:
        """To passable cells."""
        return np.asarray(values[path[1:, 0], path[1:, 1]] < OBSTACLE)

    def costs(self, values: Float2D) -> Float2D:
        """The values."""
        return values

    def planner(self, values: Float2D) -> Planner:
        """Of costs."""
        return Planner(values)

    def world(self, values: Float2D) -> World:
        """Of costs."""
        return World(values)

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """A patch of costs."""
        return MapPatch(row, col, cost=values)


class OnHeights:
    """What robots have in common that go by heights, in metres, NaN where unknown.

    Parameters
    ----------
    terrain : Terrain
        The sides of the cells, the limits, and what steps cost.
    """

    def __init__(self, terrain: Terrain) -> None:
        self.sides_m, self._terrain = terrain.sides_m, terrain

    def planner(self, values: Float2D) -> Planner:
        """Of heights."""
        return Planner.of_elevation(values, warn=False, **self._surface)

    def world(self, values: Float2D) -> World:
        """Of heights."""
        return World.of_elevation(values, **self._surface)

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """A patch of heights."""
        return MapPatch(row, col, elevation=values)

    @property
    def _surface(self) -> Surface:
        size, width = self.sides_m
        return {
            "cell_size_m": size,
            "cell_width_m": width,
            "traversability": self._terrain.traversability,
            "vehicle": self._terrain.vehicle,
            "step_cost": self._terrain.step_cost,
            "mobility": self._terrain.mobility,
        }


class PointOnSlopes(OnHeights):
    """A robot as large as a cell whose steps cost by the slope. Values are heights in metres, NaN where unknown."""

    vehicle = None
    reach = 0

    def obstacle(self, values: Float2D) -> float:
        """Unknown, and so impassable."""
        return math.nan

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """On passable cells."""
        return bool(self.costs(values)[cell] < OBSTACLE)

    def steps(self, values: Float2D, path: NDArray[np.int32]) -> NDArray[np.bool_]:
        """To passable cells."""
        return np.asarray(self.costs(values)[path[1:, 0], path[1:, 1]] < OBSTACLE)

    def costs(self, values: Float2D) -> Float2D:
        """Traversability."""
        return self._terrain.costs(values)


class Body(OnHeights):
    """A robot with a body. Values are heights in metres, NaN where unknown.

    Parameters
    ----------
    terrain : Terrain
        The sides of the cells, the vehicle, and the weights of its poses' cost.

    Raises
    ------
    InvalidMapError
        There is no vehicle, or it is a disc.
    """

    def __init__(self, terrain: Terrain) -> None:
        if terrain.vehicle is None or terrain.vehicle.is_disc:
            raise InvalidMapError("wanted a vehicle with length, width and clearance, got none or a disc")
        super().__init__(terrain)
        self.vehicle: Vehicle = terrain.vehicle
        self._check = PoseCheck(terrain.vehicle, terrain.sides_m)
        self.reach = self._check.reach

    def obstacle(self, values: Float2D) -> float:
        """Higher above every cell than the body is long: no pose reaches from the ground onto it."""
        return float(np.nanmax(values)) + self.vehicle.length_m + self.vehicle.clearance_m + self.vehicle.step_m

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """In one heading at least."""
        cells = np.array([cell])
        return any(self._check.stands(values, cells, heading)[0] for heading in range(len(HEADINGS)))

    def steps(self, values: Float2D, path: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Where both ends' poses pass in the step's heading."""
        headings, passes = headings_of(path), np.ones(len(path) - 1, np.bool_)
        for heading in np.unique(headings).tolist():
            own = np.flatnonzero(headings == heading)
            for end in (path[:-1], path[1:]):
                passes[own] &= self._check.stands(values, end[own], heading)
        return passes

    def costs(self, values: Float2D) -> Float2D:
        """Of each cell's best pose; inf where all fail."""
        (size, width), rule = self.sides_m, self._terrain.traversability
        best: Float2D = pose_costs(values, size, self.vehicle, cell_width_m=width, traversability=rule).min(0)
        return best
