"""What a robot is to the simulation: a point that goes by costs, or a body that stands on heights.

A map of the simulation holds the values that its robot goes by. The scene moves values about and puts obstacles on
them; what they mean, its robot says.
"""

import math
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.loop.messages import MapPatch
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.terrain.vehicle import HEADINGS, Vehicle
from nnpp_edge.simulation.pose_check import PoseCheck, headings_of
from nnpp_edge.terrain.obstacles import OBSTACLE


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

    def ground(self, values: Float2D) -> Ground:
        """Itself on the map, for planners and the onboard loop."""

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """The message that tells the loop of values."""


class Point:
    """A robot as large as a cell. Values are traversability costs."""

    vehicle: Vehicle | None = None
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

    def ground(self, values: Float2D) -> Ground:
        """Of costs."""
        return Ground(values)

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """A patch of costs."""
        return MapPatch(row, col, cost=values)


class Disc(Point):
    """A robot of which a radius is known. Values are a point's traversability costs.

    Parameters
    ----------
    ground : Ground
        The sides of the cells and the vehicle; its map counts for nothing.
    """

    def __init__(self, ground: Ground) -> None:
        assert ground.vehicle is not None and ground.vehicle.radius_m is not None
        self.sides_m, self._ground, self.radius_m = ground.sides_m, ground, ground.vehicle.radius_m
        self.vehicle: Vehicle = ground.vehicle
        self.reach = math.ceil(self.radius_m / min(self.sides_m)) + 1

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """Where it touches no impassable cell."""
        return self.clearance_m(values, np.array([cell], np.float64)) >= self.radius_m

    def steps(self, values: Float2D, path: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Where it touches none on the way."""
        legs = zip(path[:-1].astype(np.float64), path[1:].astype(np.float64), strict=True)
        clear = [self.clearance_m(values, np.linspace(*leg, 9)) >= self.radius_m for leg in legs]
        return np.array(clear, np.bool_)

    def clearance_m(self, values: Float2D, places: NDArray[np.float64]) -> float:
        """Metres from places (N, 2), in cells, to the nearest point of an impassable cell; at most some radius."""
        room = self.reach + 1
        blocked = np.pad(~(values < OBSTACLE), room, constant_values=True)
        nearest = math.inf
        offsets = np.arange(-room, room + 1)
        for place in places:
            row, col = np.rint(place).astype(int)
            around = blocked[row : row + 2 * room + 1, col : col + 2 * room + 1]
            down, along = (
                np.maximum(np.abs(at + offsets - exact) - 0.5, 0.0) * side
                for at, exact, side in zip((row, col), place, self.sides_m, strict=True)
            )
            nearest = min(nearest, float(np.hypot(down[:, None], along).min(where=around, initial=math.inf)))
        return nearest

    def ground(self, values: Float2D) -> Ground:
        """Of costs."""
        return replace(self._ground, cost=values, elevation=None)


class OnHeights:
    """What robots have in common that go by heights, in metres, NaN where unknown.

    Parameters
    ----------
    ground : Ground
        The sides of the cells, the limits, the vehicle, and what steps cost; its heights count for nothing.
    """

    def __init__(self, ground: Ground) -> None:
        self.sides_m, self._ground = ground.sides_m, ground

    def ground(self, values: Float2D) -> Ground:
        """Of heights."""
        return replace(self._ground, elevation=values)

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """A patch of heights."""
        return MapPatch(row, col, elevation=values)


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
        return self.ground(values).costs()


class Body(OnHeights):
    """A robot with a body. Values are heights in metres, NaN where unknown.

    Parameters
    ----------
    ground : Ground
        As for `OnHeights`, with a vehicle.

    Raises
    ------
    InvalidMapError
        There is no vehicle, or it is a disc.
    """

    def __init__(self, ground: Ground) -> None:
        if ground.vehicle is None or ground.vehicle.is_disc:
            raise InvalidMapError("wanted a vehicle with length, width and clearance, got none or a disc")
        super().__init__(ground)
        self.vehicle: Vehicle = ground.vehicle
        self._check = PoseCheck(ground.vehicle, ground.sides_m)
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
        (size, width), rule = self.sides_m, self._ground.traversability
        best: Float2D = pose_costs(values, size, self.vehicle, cell_width_m=width, traversability=rule).min(0)
        return best
