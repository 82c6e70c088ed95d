"""A vehicle of which no more is known than a radius: cells that it cannot stand on without touching an obstacle.

Works on costs, so on ready cost maps too. What a passable cell costs is not changed.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Rectangle, patch_at
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.map.along import Heights
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.directed import DirectedSteps
from nnpp_edge.runtime.map.slope_cost import SlopeCost
from nnpp_edge.runtime.map.state import MapState, Room, costs_told, new_heights
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.terrain.traversability import Traversability, relative_heights, update_cost
from nnpp_edge.runtime.terrain.vehicle import Vehicle


class Disc:
    """The cells around each cell that a disc touches, on its way to the cells beside it too.

    A cell is an obstacle from the cost `ceiling` on; NaN is one, and so is what lies off the map.
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

    `cost` are a point's. `surface` is the elevations that these come from, copied, and what made costs of them; with
    it steps may cost by the slope.
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
        self._surface: _Surface | None = None
        if surface is not None:
            heights, base = relative_heights(surface[0])
            self._surface = _Surface(np.array(heights), base, surface[1], np.zeros(heights.shape, np.float32))
        rows, cols = self._bare.shape
        super().__init__(self._disc.costs(self._bare, (0, 0, rows, cols)), model, corner_cutting=corner_cutting)
        if slope_cost is not None and self._surface is not None:
            heights, weights = self._surface.heights, self.grid.weights
            self.grid.go_by(DirectedSteps(heights, sides_m, slope_cost, weights, corner_cutting))

    def __getstate__(self) -> dict[str, object]:
        """As of a `MapState`, and the point's costs."""
        own = {name: getattr(self, name) for name in ("_disc", "_sides", "_vehicle", "_bare", "_surface")}
        return super().__getstate__() | own

    @property
    def sides_m(self) -> tuple[float, float]:
        """Height and width of a cell."""
        return self._sides

    @property
    def vehicle(self) -> Vehicle:
        """The disc."""
        return self._vehicle

    @property
    def room(self) -> Room:
        """The disc's own."""
        rows, cols = self._bare.shape
        assert self._vehicle.radius_m is not None
        ceiling = self.grid.model.costs[2]
        return self._bare.reshape(-1), rows, cols, ceiling, self._vehicle.radius_m, *self._sides

    def update(self, row: int, col: int, patch: Float2D, seen: NDArray[np.bool_] | None = None) -> Change:
        """As `MapState.update`, of a point's costs."""
        costs, model = as_map(patch, "patch"), self.grid.model
        row, col, rows, cols = part = patch_at((row, col), costs.shape, self.shape)
        if model.refuses(costs):
            least, most, ceiling = model.costs
            model.refuse(float(costs[(costs < least) | ((costs > most) & (costs < ceiling))][0]))
        here = np.s_[row : row + rows, col : col + cols]
        if self._surface is None:
            np.copyto(self._bare[here], costs, where=True if seen is None else seen)
            return self._stand_on(part)
        told = self._surface.told
        told[here] = costs_told(told[here], costs, seen, shut_alone=self.grid.directed is not None)
        return self._weigh(part, (row, col, 0, 0))

    def update_elevation(self, row: int, col: int, patch: Float2D, seen: NDArray[np.bool_] | None = None) -> Change:
        """As `MapState.update_elevation`."""
        if self._surface is None:
            raise InvalidMapError("wanted costs, as the map was made from such: update takes them")
        heights, _ = relative_heights(patch, self._surface.base)
        part, heights = new_heights(self._surface.heights, (row, col), heights, seen)
        if not part[2]:
            return Change(part, 0)
        row, col, rows, cols = part
        self._surface.heights[row : row + rows, col : col + cols] = heights
        return self._weigh(part, part)

    def _weigh(self, part: Rectangle, changed: Rectangle) -> Change:
        """Bring a part's costs up to date, and those beside it, after a change of heights or of costs told."""
        assert self._surface is not None
        heights, _, limits, told = self._surface
        part = update_cost(self._bare, heights, part, self._sides[0], limits, cell_width_m=self._sides[1])
        row, col, rows, cols = part
        here = self._bare[row : row + rows, col : col + cols]
        np.maximum(here, told[row : row + rows, col : col + cols], out=here)
        return self._stand_on(part, changed)

    def cost(self) -> Float2D:
        """As `MapState.cost`: a point's costs."""
        return self._bare.copy()

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> NDArray[np.bool_]:
        """As `MapState.unknown`."""
        return np.isnan(self._bare[rows, cols]) if self._surface is None else super().unknown(rows, cols)

    def _ground(self) -> tuple[Heights, float, tuple[float, float]] | None:
        return None if self._surface is None else (self._surface.heights, self._surface.base, self._sides)

    def _stand_on(self, part: Rectangle, changed: Rectangle | None = None) -> Change:
        """Bring up to date what the disc can stand on around a part of the point's costs."""
        around = self._disc.around(part, self.shape)
        costs, keeps = self._disc.costs(self._bare, around), self.log.keeps_old_weights
        return self._noted(self.grid.update(costs, around[:2], keep_old_weights=keeps), changed or part)


class _Surface(NamedTuple):
    """Source of the costs of a map of heights."""

    heights: Float2D
    base: float
    """Height in metres that `heights` are relative to."""
    limits: Traversability
    told: Float2D
    """(H, W) as `costs_told` has them."""
