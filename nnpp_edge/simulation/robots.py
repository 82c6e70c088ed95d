"""A robot in the simulation: what stands where, by costs or by heights. Its ground is the runtime's `Ground`."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.loop.messages import MapPatch
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.terrain.vehicle import HEADINGS
from nnpp_edge.simulation.pose_check import PoseCheck, headings_of
from nnpp_edge.terrain.obstacles import OBSTACLE


class Robot:
    """A robot as large as a cell. `values` is always a map (H, W) float32 of the kind that its ground holds.

    Costs, or heights in metres where steps cost by the slope. The scene moves values about and puts obstacles on
    them; what they mean, its robot says.
    """

    reach = 0
    """Cells from its own to the farthest that lies under it."""

    def __init__(self, ground: Ground) -> None:
        self._ground, self.vehicle, self.sides_m = ground, ground.vehicle, ground.sides_m
        self._layer = "cost" if ground.elevation is None else "elevation"

    def obstacle(self, values: Float2D) -> float:
        """The value of an obstacle's cells: the paper's cost, or unknown ground."""
        return OBSTACLE if self._layer == "cost" else math.nan

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """Whether it may be in a cell of the map."""
        return bool(self.costs(values)[cell] < OBSTACLE)

    def steps(self, values: Float2D, path: NDArray[np.int32]) -> NDArray[np.bool_]:
        """(N - 1,) whether it may take each step of a path inside the map, of neighbouring cells."""
        return np.asarray(self.costs(values)[path[1:, 0], path[1:, 1]] < OBSTACLE)

    def costs(self, values: Float2D) -> Float2D:
        """(H, W) traversability cost of each cell; impassable from 1 up."""
        return values if self._layer == "cost" else self.ground(values).costs()

    def ground(self, values: Float2D) -> Ground:
        """Itself on the map, for planners and the onboard loop."""
        cost, heights = (values, None) if self._layer == "cost" else (None, values)
        return replace(self._ground, cost=cost, elevation=heights)

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """The message that tells the loop of values."""
        cost, heights = (values, None) if self._layer == "cost" else (None, values)
        return MapPatch(row, col, heights, cost)


class Disc(Robot):
    """A robot of which a radius is known, on costs."""

    def __init__(self, ground: Ground) -> None:
        super().__init__(ground)
        assert self.vehicle is not None and self.vehicle.radius_m is not None
        self.radius_m = self.vehicle.radius_m
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


class Body(Robot):
    """A robot with a body, on heights; judged by `PoseCheck`."""

    def __init__(self, ground: Ground) -> None:
        super().__init__(ground)
        assert ground.vehicle is not None
        self._check = PoseCheck(ground.vehicle, ground.sides_m)
        self.reach = self._check.reach

    def obstacle(self, values: Float2D) -> float:
        """Higher above every cell than the body is long: no pose reaches from the ground onto it."""
        assert self.vehicle is not None
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
        assert self.vehicle is not None
        (size, width), rule = self.sides_m, self._ground.traversability
        best: Float2D = pose_costs(values, size, self.vehicle, cell_width_m=width, traversability=rule).min(0)
        return best


def robot_on(ground: Ground) -> Robot:
    """The robot that drives there."""
    if ground.vehicle is None:
        return Robot(ground)
    return Disc(ground) if ground.vehicle.is_disc else Body(ground)
