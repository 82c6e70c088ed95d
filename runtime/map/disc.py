"""A vehicle of which no more is known than a radius: cells that it cannot stand on without touching an obstacle.

Works on costs, so on ready cost maps too. What a passable cell costs is not changed.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Rectangle, patch_at
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.map.along import Heights
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.directed import DirectedSteps
from nnpp_edge.runtime.map.slope_cost import SlopeCost
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.terrain.traversability import Traversability, sides_of, traversability_cost, update_cost
from nnpp_edge.runtime.terrain.vehicle import Vehicle


class Disc:
    """The cells around each cell that a disc touches, on its way to the cells beside it too.

    Parameters
    ----------
    radius_m : float
        Of the disc.
    sides_m : (float, float)
        Height and width of a cell.
    ceiling : float
        Cost from which on a cell is an obstacle; NaN is one, and so is what lies off the map.
    """

    def __init__(self, radius_m: float, sides_m: tuple[float, float], ceiling: float) -> None:
        dy, dx = sides_m
        reach = math.hypot(radius_m, 0.5 * math.hypot(dy, dx))
        """A disc half a step away is within that of the cell, as far as it is not within it of the next."""
        rows, cols = math.ceil(reach / dy + 0.5), math.ceil(reach / dx + 0.5)
        down = np.maximum(np.abs(np.arange(-rows, rows + 1)) - 0.5, 0.0) * dy
        along = np.maximum(np.abs(np.arange(-cols, cols + 1)) - 0.5, 0.0) * dx
        self._touched: NDArray[np.uint8] = (np.hypot(down[:, None], along) < reach).astype(np.uint8)
        self.reach = rows, cols
        """Rows and columns from a cell to those that the disc may touch."""
        self._ceiling = ceiling

    def around(self, part: Rectangle, shape: tuple[int, int]) -> Rectangle:
        """The rectangle of cells that a change in a part may matter to."""
        (row, col, rows, cols), (down, along) = part, self.reach
        row0, col0 = max(row - down, 0), max(col - along, 0)
        row1, col1 = min(row + rows + down, shape[0]), min(col + cols + along, shape[1])
        return row0, col0, row1 - row0, col1 - col0

    def costs(self, bare: Float2D, part: Rectangle) -> Float2D:
        """Costs of a part of a map, inf where the disc would touch an obstacle."""
        import cv2  # takes a tenth of a second to load

        (row, col, rows, cols), (down, along) = part, self.reach
        seen = np.ones((rows + 2 * down, cols + 2 * along), np.uint8)
        top, left = max(row - down, 0), max(col - along, 0)
        window = bare[top : row + rows + down, left : col + cols + along]
        first = top - (row - down), left - (col - along)
        seen[first[0] : first[0] + window.shape[0], first[1] : first[1] + window.shape[1]] = ~(window < self._ceiling)
        touched = cv2.dilate(seen, self._touched, borderType=cv2.BORDER_CONSTANT, borderValue=1)
        own = bare[row : row + rows, col : col + cols]
        inside = touched[down : down + rows, along : along + cols] != 0
        return np.where(inside, np.float32(np.inf), own).astype(np.float32)


class DiscState(MapState):
    """The map of a disc. Costs are all computed at once; those of cells that the disc cannot stand on are inf.

    Parameters
    ----------
    cost, model, corner_cutting
        As for `MapState`; the costs are a point's.
    vehicle : Vehicle
        The disc.
    sides_m : (float, float)
        Height and width of a cell.
    surface : (dem, Traversability)
        The elevations that the costs come from, copied, and what made costs of them; for `update_elevation`.
    slope_cost : SlopeCost
        With a surface: what ways up and down it cost.
    """

    def __init__(
        self,
        cost: Float2D,
        model: StepModel,
        vehicle: Vehicle,
        sides_m: tuple[float, float],
        *,
        corner_cutting: bool = True,
        surface: tuple[Float2D, Traversability] | None = None,
        slope_cost: SlopeCost | None = None,
    ) -> None:
        assert vehicle.radius_m is not None
        self._disc, self._sides, self._vehicle = Disc(vehicle.radius_m, sides_m, model.costs[2]), sides_m, vehicle
        self._bare = np.array(as_map(cost, "cost"))
        self._surface = surface and (np.array(as_map(surface[0], "dem", np.float64)), surface[1])
        rows, cols = self._bare.shape
        super().__init__(self._disc.costs(self._bare, (0, 0, rows, cols)), model, corner_cutting=corner_cutting)
        if slope_cost is not None and self._surface is not None:
            weights = self.grid.weights
            self.grid.go_by(DirectedSteps(self._surface[0], sides_m, slope_cost, weights, corner_cutting))

    def __getstate__(self) -> dict[str, object]:
        """As of a `MapState`, and the point's costs."""
        own = {name: getattr(self, name) for name in ("_disc", "_sides", "_vehicle", "_bare", "_surface")}
        return super().__getstate__() | own

    @property
    def sides_m(self) -> tuple[float, float]:
        """Height and width of a cell."""
        return self._sides

    @property
    def turning_radius_m(self) -> float | None:
        """As of a `MapState`."""
        return self._vehicle.turning_radius_m

    def update(self, row: int, col: int, patch: Float2D) -> Change:
        """As `MapState.update`, of a point's costs."""
        costs = as_map(patch, "patch")
        row, col, rows, cols = part = patch_at((row, col), costs.shape, self.shape)
        model = self.grid.model
        if model.refuses(costs):
            least, most, ceiling = model.costs
            model.refuse(float(costs[(costs < least) | ((costs > most) & (costs < ceiling))][0]))
        self._bare[row : row + rows, col : col + cols] = costs
        return self._stand_on(part)

    def update_elevation(self, row: int, col: int, patch: Float2D) -> Change:
        """As `MapState.update_elevation`."""
        if self._surface is None:
            raise InvalidMapError("wanted costs, as the map was made from such: update takes them")
        heights, (dem, limits) = as_map(patch, "dem", np.float64), self._surface
        row, col, rows, cols = part = patch_at((row, col), heights.shape, self.shape)
        dem[row : row + rows, col : col + cols] = heights
        return self._stand_on(update_cost(self._bare, dem, part, self._sides[0], limits, cell_width_m=self._sides[1]))

    def _ground(self) -> tuple[Heights, float, tuple[float, float]] | None:
        return None if self._surface is None else (self._surface[0], 0.0, self._sides)

    def _stand_on(self, part: Rectangle) -> Change:
        """Bring up to date what the disc can stand on around a part of the point's costs."""
        around = self._disc.around(part, self.shape)
        costs, keeps = self._disc.costs(self._bare, around), self.log.keeps_old_weights
        return self._noted(self.grid.update(costs, around[:2], keep_old_weights=keeps), part)


def state_of_costs(
    cost: Float2D,
    model: StepModel,
    *,
    corner_cutting: bool = True,
    vehicle: Vehicle | None = None,
    cell_size_m: float | None = None,
    cell_width_m: float | None = None,
) -> MapState:
    """The state of a cost map, of a point or a disc. InvalidMapError for a body, which needs elevations."""
    if vehicle is None:
        return MapState(cost, model, corner_cutting=corner_cutting)
    if vehicle.radius_m is None:
        raise InvalidMapError("a body stands on elevations: wanted Planner.of_elevation, or a vehicle with radius_m")
    if cell_size_m is None:
        raise InvalidMapError("wanted cell_size_m, the side of a cell, with a vehicle")
    sides = sides_of(cell_size_m, cell_width_m)
    return DiscState(cost, model, vehicle, sides, corner_cutting=corner_cutting)


def state_of_elevation(
    dem: Float2D,
    sides_m: tuple[float, float],
    traversability: Traversability,
    model: StepModel,
    *,
    corner_cutting: bool = True,
    lazy: bool = True,
    warn: bool = False,
    vehicle: Vehicle | None = None,
    slope_cost: SlopeCost | None = None,
) -> MapState:
    """As `MapState.of_elevation`, of a disc too, whose costs are computed at once."""
    if vehicle is None or vehicle.radius_m is None:
        return MapState.of_elevation(
            dem,
            sides_m,
            traversability,
            model,
            corner_cutting=corner_cutting,
            lazy=lazy,
            warn=warn,
            vehicle=vehicle,
            slope_cost=slope_cost,
        )
    cost = traversability_cost(dem, sides_m[0], traversability, cell_width_m=sides_m[1], warn=warn)
    surface = dem, traversability
    return DiscState(
        cost, model, vehicle, sides_m, corner_cutting=corner_cutting, surface=surface, slope_cost=slope_cost
    )
