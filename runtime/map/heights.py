"""A map of heights, and of costs that were told."""

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Float2D, Float32s, Floats, as_map
from nnpp_edge.runtime.cells import Rectangle, patch_at, slices
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.along import Along, Line, crossings, heights_at
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.grid import ALL_SEEN, Grid, bordered
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.pyramid import coarse_shapes
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.tiles import Tiles
from nnpp_edge.runtime.robots.slope.cost import Mobility, slope_cost_of
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.runtime.terrain.traversability import relative_heights, traversability_cost


class HeightState(MapState):
    """A map in two layers: heights, and costs that were told. Each patch changes its own layer.

    A cell costs the greater of what its heights make of it and of what was told, and is shut where
    either says so. To a body, and where steps cost by the slope, a cost below 1 says nothing but
    that the cell is not shut.
    """

    has_heights = True
    _made_anew = (*MapState._made_anew, "grid")
    _blocks: Float32s | None = None
    """(2, I, J) of blocks that are known, as `map.tiles.Tiles` takes them."""

    def __init__(
        self, ground: Ground, model: StepModel, corner_cutting: bool, lazy: bool = True
    ) -> None:
        self._model = model
        self._corner_cutting = corner_cutting
        self._lazy = lazy
        self._limits = ground.limits
        self._mobility = ground.mobility or Mobility()
        self._slope_cost = slope_cost_of(ground.step_cost, ground.mobility)
        self.shut_alone = ground.by_slope or ground.vehicle is not None
        self.heights, self._base = self._heights_of(ground)
        """(H, W) float32, relative to a height in metres; not finite where unknown. To be read
        only.
        """
        self._sides = ground.sides_m
        super().__init__(ground)
        self.begin_anew()

    def _heights_of(self, ground: Ground) -> tuple[Float2D, float]:
        """The map's own heights, and the height in metres that they are relative to."""
        dem = np.asarray(ground.elevation)
        heights, base = relative_heights(dem)
        return heights.copy() if np.shares_memory(heights, dem) else heights, base

    def begin_anew(self) -> None:
        """As `MapState.begin_anew`."""
        rows, cols = self.heights.shape
        model = self._model
        cutting = self._corner_cutting
        rule = self._limits.rule(*self._sides, scale=model.scale)
        coarsest = FACTOR ** len(coarse_shapes(rows, cols))
        weights = bordered(rows, cols, small=self._blocks is not None)
        self.grid = Grid(rows, cols, model, cutting, weights)
        self._tiles = Tiles(self.heights, rule, weights, cutting, coarsest, self.told, self._blocks)
        self.grid.compute_by(self._tiles)
        self._put_robot()
        super().begin_anew()
        if not self._lazy:
            self.grid.complete()

    def _put_robot(self) -> None:
        """Put the robot on the map; each kind's room is loaded where there is one."""
        if self.vehicle is not None:
            from nnpp_edge.runtime.robots.body.poses import Poses
            from nnpp_edge.runtime.robots.body.robot import body_robot

            known = self.known_heights((0, 0, *self.shape))
            shut = None if self.told is None else self.told >= 1.0
            terms = self._limits.body_weights
            scale = self._model.scale
            poses = Poses(known, self._sides, self.vehicle, terms, scale, shut, self._blocks)
            self.grid.drive_by(body_robot(poses))
        if self._slope_cost is not None:
            from nnpp_edge.runtime.robots.slope.directed import SlopeRobot

            slope_robot = SlopeRobot(self.heights, self._sides, self._slope_cost, self.grid)
            self.grid.drive_by(slope_robot)

    def update(self, row: int, col: int, patch: Float2D, seen: Bool | None = None) -> Change:
        """As `MapState.update`."""
        costs = as_map(patch, "patch")
        part = patch_at((row, col), costs.shape, self.shape)
        if self._model.refuses(costs):
            self._model.refuse(float(np.nanmin(costs)))
        if self.told is None:
            self.told = self._tiles.tell_from_now_on()
            self.grid.pack()
            for level in self._pyramid.levels[1:] if self._pyramid else ():
                level.grid.pack()
        known = ~np.isnan(costs)
        if seen is not None:
            known &= seen
        below = np.float32(0.0) if self.shut_alone else costs
        told = np.where(costs < 1.0, below, np.float32(np.inf))
        keeps = self.log.keeps_old_weights
        change, new = self._tiles.write(part, told, known, told=True, keeps=keeps)
        return self._noted(change, new)

    def update_elevation(
        self, row: int, col: int, patch: Float2D, seen: Bool | None = None
    ) -> Change:
        """As `MapState.update_elevation`."""
        heights, _ = relative_heights(patch, self._base)
        part = patch_at((row, col), heights.shape, self.shape)
        known = ALL_SEEN if seen is None else seen
        change, new = self._tiles.write(part, heights, known, keeps=self.log.keeps_old_weights)
        return self._noted(change, new, heights=True)

    def known_heights(self, part: Rectangle) -> Float2D:
        """As `MapState.known_heights`."""
        heights: Float2D = self.heights[slices(part)]
        return heights

    def cost(self) -> Float2D:
        """As `MapState.cost`."""
        cost = self._cost_by_heights()
        return cost if self.told is None else np.maximum(cost, self.told)

    def _cost_by_heights(self) -> Float2D:
        dy, dx = self._sides
        heights = self.known_heights((0, 0, *self.shape)).copy()
        return traversability_cost(heights, dy, self._limits, cell_width_m=dx, warn=False)

    def elevation(self) -> Float2D:
        """As `MapState.elevation`."""
        base = np.asarray(self._base, self.heights.dtype)
        return np.where(self.unknown(), np.nan, self.heights + base)

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> Bool:
        """As `MapState.unknown`."""
        unknown: Bool = ~np.isfinite(self.heights[rows, cols])
        return unknown

    def along(self, line: Line, at: Line | None = None) -> Along:
        """As `MapState.along`."""
        places = crossings(line) if at is None else at
        metres = self._heights_at(places) + self._base
        slope_cost = self._slope_cost
        walker = slope_cost if slope_cost is not None and slope_cost.function else None
        return Along(places, metres, self._sides, self._mobility, walker)

    def _heights_at(self, places: Line) -> Floats:
        """(N,) heights at places (N, 2)."""
        return heights_at(self.heights, places)
