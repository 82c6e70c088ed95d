"""The ground of a simulated drive: as it is, as the robot knows it at first, and what stands where,
by costs or by heights.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from nnpp_edge.profiling.suites import whole_cost
from nnpp_edge.runtime import Ground, MapPatch
from nnpp_edge.runtime.arrays import Cells, Float2D
from nnpp_edge.runtime.cells import Cell, Sides
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.obstacles import OBSTACLE

_ROUNDING = 1e-4
"""Share of a limit by which a pose may exceed it: its heights are rounded otherwise than in the
loop.
"""
_SPIKE = 100.0
"""Height of an obstacle over all ground, in sides of a cell, on ground that is known coarsely."""
_LIMITS = ("clearance_m", "max_tilt_deg", "max_pitch_deg", "max_roll_deg", "max_step_m")


@dataclass(frozen=True, eq=False)
class SurveyedGround:
    """A terrain as it is, with the robot on it, and as a coarse survey has it.

    `values` is always a map (H, W) float32 of the kind that the ground holds: heights where the
    robot has a body or its steps cost by the slope, else costs. The scene moves values about and
    puts obstacles on them; what they mean to the robot is said here, of the map as it is given,
    apart from what a loop keeps of it: for a robot as large as a cell by each cell's cost, else by
    a grid that is made anew.
    """

    ground: Ground
    """As it is."""
    surveyed: Float2D
    """(H, W) of heights that are blurred, or lack the rocks; of the kind that the ground holds."""
    known: Ground | None = None
    """As means of blocks have it, known in place of a survey."""
    heights: Float2D | None = None
    """(H, W) true heights, for pictures."""
    north_deg: float | None = None
    """As `Place.north_deg`."""
    origin: Cell = (0, 0)
    """Cell of the file that is the first of this part of it; errors name the file's cells."""

    @classmethod
    def of(cls, ground: Ground, block: int, bare: Float2D | None = None) -> "SurveyedGround":
        """Of a ground; the survey has its heights blurred by a Gaussian of half a `block` of cells
        (1 knows all).

        Of ground with rocks the survey has the `bare` heights. To a body, the edge of what it has
        seen of ground that was much blurred is a step, and may shut it in. Points and discs whose
        steps do not cost by the slope drive by costs. InvalidQueryError where no cell's height is
        known; InvalidMapError for a disc whose steps cost by the slope.
        """
        assert ground.elevation is not None
        bare = ground.elevation if bare is None else bare
        surveyed = bare.copy() if block <= 1 else _blurred(bare, block / 2.0)
        if not ground.by_costs:
            if ground.vehicle and not ground.body:
                raise InvalidMapError(
                    "a disc drives by costs here: wanted step_cost='paper', or no vehicle"
                )
            return cls(ground, surveyed, heights=ground.elevation)
        costs = replace(ground, elevation=surveyed).costs()
        return cls(ground.priced(ground.costs()), costs, heights=ground.elevation)

    @classmethod
    def of_known(cls, ground: Ground, factor: int, prior: str) -> "SurveyedGround":
        """Of heights whose sides the factor divides, of which the robot knows the means
        of blocks.
        """
        unseen = np.full(ground.shape, np.nan, np.float32)
        return cls(ground, unseen, ground.by_blocks(factor, prior), ground.elevation)

    @property
    def reach(self) -> int:
        """Cells from the robot's own to the farthest that lies under it."""
        return reach_of(self.ground.vehicle, self.ground.sides_m)

    @property
    def true(self) -> Float2D:
        """(H, W) costs or heights, whichever the robot goes by."""
        heights = self.ground.elevation
        return self.ground.costs() if heights is None else heights

    def in_file(self, cell: Cell) -> Cell:
        """The file's cell."""
        return cell[0] + self.origin[0], cell[1] + self.origin[1]

    def costs(self) -> Float2D:
        """(H, W) true traversability costs; impassable from 1 up."""
        return self.costs_on(self.true)

    def obstacle(self, values: Float2D) -> float:
        """The value of an obstacle's cells: the paper's cost, or unknown ground.

        To a body it is higher above every cell than the body is long: no pose reaches from the
        ground onto it.
        """
        if self.ground.elevation is None:
            return OBSTACLE
        highest = float(np.nanmax(values))
        if body := self.ground.body:
            return highest + body.length_m + body.clearance_m + body.step_m
        return math.nan if self.known is None else highest + _SPIKE * max(self.ground.sides_m)

    def stands(self, values: Float2D, cell: Cell) -> bool:
        """Whether the robot may be in a cell of the map, in one heading at least."""
        if self.ground.vehicle is None:
            return bool(self.costs_on(values)[cell] < OBSTACLE)
        return self._grid(values).is_passable(cell)

    def steps(self, values: Float2D, path: Cells) -> int:
        """Number of steps that it may take of a path (N, 2) on the map, from its first cell on."""
        if self.ground.vehicle is None:
            rows, cols = path[1:].T
            free = self.costs_on(values)[rows, cols] < OBSTACLE
            return int(free.cumprod().sum())
        blocked = self._grid(values).walk(path, 0, np.empty(len(path)))
        return len(path) - 1 if blocked < 0 else max(blocked - 1, 0)

    def costs_on(self, values: Float2D) -> Float2D:
        """(H, W) traversability cost of each cell, to a body in its best heading; impassable from 1
        up.
        """
        if self.ground.elevation is None:
            return values
        ground = replace(self.ground, elevation=values)
        if ground.vehicle is not None:
            return whole_cost(ground)
        costs = ground.costs()
        if self.known is None:
            return costs
        known = np.isfinite(values).astype(np.uint8)
        inner = cv2.erode(known, np.ones((3, 3), np.uint8))
        return np.where(inner, costs, np.float32(0.0))

    def as_told(self, values: Float2D) -> Ground:
        """What the loop is given at first: the map, or the means of blocks."""
        if self.ground.elevation is None:
            return replace(self.ground, cost=values)
        return self.known or replace(self.ground, elevation=values)

    def patch(self, row: int, col: int, values: Float2D) -> MapPatch:
        """The message that tells the loop of values."""
        if self.ground.elevation is None:
            return MapPatch(row, col, cost=values)
        return MapPatch(row, col, elevation=values)

    @cached_property
    def _eased(self) -> Ground:
        """As it is, with limits of the body that the rounding of heights does not break."""
        body = self.ground.body
        if body is None:
            return self.ground
        limits = {name: getattr(body, name) for name in _LIMITS if getattr(body, name)}
        eased = {name: limit * (1.0 + _ROUNDING) for name, limit in limits.items()}
        return replace(self.ground, vehicle=replace(body, **eased))

    def _grid(self, values: Float2D) -> Grid:
        if self.ground.elevation is None:
            return map_state(replace(self.ground, cost=values)).grid
        if self.known is None:
            return map_state(replace(self._eased, elevation=values)).grid
        state = map_state(replace(self.known, vehicle=self._eased.vehicle))
        state.update(0, 0, values, np.isfinite(values), "heights")
        return state.grid


def reach_of(vehicle: Vehicle | None, sides_m: Sides) -> int:
    """Cells from a robot's own to the farthest that lies under it."""
    if vehicle is None:
        return 0
    return math.ceil(vehicle.reach_m / min(sides_m)) + 1


def _blurred(elevation: Float2D, sigma: float) -> Float2D:
    """Heights blurred by a Gaussian of so many cells; InvalidQueryError if none is known."""
    known = np.isfinite(elevation)
    if not known.any():
        raise InvalidQueryError("wanted an elevation map, got no cell with a known height")
    filled = np.where(known, elevation, elevation[known].mean()).astype(np.float32)
    blurred = cv2.GaussianBlur(filled, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return np.where(known, blurred, np.nan).astype(np.float32)
