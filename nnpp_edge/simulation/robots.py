"""A robot in the simulation: what stands where, by costs or by heights. Its ground is the runtime's `Ground`."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, enclosing, slices, widened
from nnpp_edge.runtime.loop.messages import MapPatch
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.terrain.vehicle import HEADINGS, Vehicle, footprint
from nnpp_edge.terrain.obstacles import OBSTACLE

_ROUNDING = 1e-4
"""Share of a limit by which a pose may exceed it: its heights are rounded otherwise than in the loop."""
_LIMITS = ("clearance_m", "max_tilt_deg", "max_pitch_deg", "max_roll_deg", "max_step_m")


class Robot:
    """A robot as large as a cell. `values` is always a map (H, W) float32 of the kind that its ground holds.

    Costs, or heights in metres where steps cost by the slope. The scene moves values about and puts obstacles on
    them; what they mean, its robot says.
    """

    reach = 0
    """Cells from its own to the farthest that lies under it."""

    def __init__(self, ground: Ground) -> None:
        self._ground, self.vehicle, self.sides_m = ground, ground.vehicle, ground.sides_m
        self._by_costs = ground.elevation is None

    def obstacle(self, values: Float2D) -> float:
        """The value of an obstacle's cells: the paper's cost, or unknown ground."""
        return OBSTACLE if self._by_costs else math.nan

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """Whether it may be in a cell of the map."""
        return bool(self.costs(values)[cell] < OBSTACLE)

    def steps(self, values: Float2D, path: NDArray[np.int32]) -> NDArray[np.bool_]:
        """(N - 1,) whether it may take each step of a path inside the map, of neighbouring cells."""
        return np.asarray(self.costs(values)[path[1:, 0], path[1:, 1]] < OBSTACLE)

    def costs(self, values: Float2D) -> Float2D:
        """(H, W) traversability cost of each cell; impassable from 1 up."""
        return values if self._by_costs else self.ground(values).costs()

    def ground(self, values: Float2D) -> Ground:
        """Itself on the map, for planners and the onboard loop."""
        cost, heights = (values, None) if self._by_costs else (None, values)
        return replace(self._ground, cost=cost, elevation=heights)

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """The message that tells the loop of values."""
        return MapPatch(row, col, cost=values) if self._by_costs else MapPatch(row, col, elevation=values)


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
    """A robot with a body, on heights. Its poses are checked anew on the map given, apart from what a loop keeps."""

    def __init__(self, ground: Ground) -> None:
        super().__init__(ground)
        assert ground.vehicle is not None
        self._vehicle = ground.vehicle
        limits = {name: getattr(self._vehicle, name) for name in _LIMITS}
        eased = {name: limit * (1.0 + _ROUNDING) for name, limit in limits.items() if limit is not None}
        self._eased = replace(self._vehicle, **eased)
        prints = [footprint(self._vehicle, heading, *self.sides_m) for heading in range(len(HEADINGS))]
        self.reach = max(int(np.abs(cells).max()) for each in prints for cells in (*each.wheels, each.belly))

    def obstacle(self, values: Float2D) -> float:
        """Higher above every cell than the body is long: no pose reaches from the ground onto it."""
        body = self._vehicle
        return float(np.nanmax(values)) + body.length_m + body.clearance_m + body.step_m

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """In one heading at least."""
        passes, ((row, col),) = self._checked(values, np.array([cell]))
        return bool(passes[:, row, col].any())

    def steps(self, values: Float2D, path: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Where both ends' poses pass in the step's heading."""
        steps, (passes, cells) = np.diff(path, axis=0), self._checked(values, path)
        along = [(steps == way).all(1) | (steps == np.negative(way)).all(1) for way in HEADINGS]
        (rows, cols), headings = cells.T, np.argmax(along, axis=0)
        return np.asarray(passes[headings, rows[:-1], cols[:-1]] & passes[headings, rows[1:], cols[1:]])

    def costs(self, values: Float2D) -> Float2D:
        """Of each cell's best pose; inf where all fail."""
        best: Float2D = self._poses(values, self._vehicle).min(0)
        return best

    def _checked(self, values: Float2D, cells: NDArray[np.integer]) -> tuple[NDArray[np.bool_], NDArray[np.integer]]:
        """(4, h, w) which poses pass on the part of the map around cells (N, 2), and where in it these lie."""
        around = enclosing([(row, col, 1, 1) for row, col in cells.tolist()])
        part = widened(around, (2 * self.reach + 1, 2 * self.reach + 1), values.shape)
        return np.isfinite(self._poses(values[slices(part)], self._eased)), cells - np.array(part[:2])

    def _poses(self, values: Float2D, vehicle: Vehicle) -> NDArray[np.float32]:
        (height, width), rule = self.sides_m, self._ground.traversability
        return pose_costs(values, height, vehicle, cell_width_m=width, traversability=rule)


def robot_on(ground: Ground) -> Robot:
    """The robot that drives there."""
    if ground.vehicle is None:
        return Robot(ground)
    return Disc(ground) if ground.vehicle.is_disc else Body(ground)
