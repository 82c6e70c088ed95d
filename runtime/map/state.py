"""A map that is planned on: its layers, its grid, its coarse levels, and the log of its changes."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Rectangle, patch_at, slices, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.runtime.kernels.any_angle import NO_DISC
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.kernels.records import Packed, Room
from nnpp_edge.runtime.map.along import Along, Line, crossings, heights_at
from nnpp_edge.runtime.map.changes import Change, ChangeLog, ChangeReader
from nnpp_edge.runtime.map.grid import ALL_SEEN, Grid, bordered
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.pyramid import Pyramid, coarse_shapes
from nnpp_edge.runtime.map.tiles import Tiles
from nnpp_edge.runtime.map.unseen import Unseen
from nnpp_edge.runtime.memory import (
    DIRECTED_BYTES_PER_CELL,
    bytes_per_cell,
    check_planner_fits,
    virtual_zeros,
)
from nnpp_edge.runtime.robots.slope.cost import Mobility, slope_cost_of
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA, StepCost, StepModel
from nnpp_edge.runtime.terrain.traversability import (
    relative_heights,
    traversability_cost,
    warn_of_saturation,
)
from nnpp_edge.runtime.tuning import MOST_PRICE

_TOGETHER = 64
"""Cells of a path around which is looked at once, at most, for what is unknown."""
_PAPER = StepModel.of(StepCost.PAPER)


class MapState:
    """The newest map, in layers: heights, and costs that were told; a map without heights has the
    costs alone.

    Each patch changes its own layer. A cell of a map of heights costs the greater of what its
    heights make of it and of what was told, and is shut where either says so. To a body, and where
    steps cost by the slope (`shut_alone`), a cost below 1 says nothing but that the cell is not
    shut.

    Whoever keeps something that depends on it reads the log of changes when asked. Serves one
    thread at a time. Made by `map_state`.
    """

    def __init__(
        self,
        ground: Ground,
        omega: float,
        corner_cutting: bool,
        *,
        lazy: bool,
        tell_unknown: bool,
        shut_alone: bool = False,
    ) -> None:
        by_slope = ground.elevation is not None and ground.by_slope
        self.vehicle = ground.vehicle
        """Whose path it is; None for a point."""
        self.sides_m = None if ground.cell_size_m is None else ground.sides_m
        """Height and width of a cell; None where it is not known."""
        self.mobility = ground.mobility or Mobility()
        """By what time and energy along a path are computed."""
        self._limits = ground.limits
        self._lazy = lazy
        self._corner_cutting = corner_cutting
        self._slope_cost = slope_cost_of(ground.step_cost, ground.mobility) if by_slope else None
        self._model = StepModel.of(
            StepCost.PAPER if ground.cost is None else ground.step_cost, omega
        )
        self.unseen = Unseen(ground) if ground.factor > 1 else None
        """Blocks that are known by their means; None where cells are known, or nothing."""
        self.omega = omega
        self._heights, self._base = self._heights_of(ground)
        self.told: Float2D | None = None
        """(H, W) costs that were told, on a map of heights; None while none were. To be
        read only.
        """
        self._shut_alone = (
            shut_alone or by_slope or (ground.elevation is not None and ground.vehicle is not None)
        )
        self._unknown = (
            np.isnan(as_map(ground.cost, "cost"))
            if tell_unknown and ground.cost is not None
            else None
        )
        self._lay_out(ground.cost)

    def _heights_of(self, ground: Ground) -> tuple[Float2D | None, float]:
        """The map's own heights, and the height in metres that they are relative to; None for a map
        of costs.
        """
        if (dem := ground.elevation) is None:
            return None, 0.0
        if self.unseen is not None:
            rows, cols = ground.shape
            return virtual_zeros(rows * cols, np.float32).reshape(rows, cols), relative_heights(
                dem
            )[1]
        heights, base = relative_heights(dem)
        return heights.copy() if np.shares_memory(heights, np.asarray(dem)) else heights, base

    def _lay_out(self, cost: Float2D | None = None) -> None:
        """Begin anew with the layers, of which nothing has been computed; those of a map of costs
        are its grid.
        """
        self._make_grid(cost)
        if self._heights is not None and self.sides_m is not None:
            self._put_robot(self._heights, self.sides_m)
        self.log = ChangeLog()
        self._pyramid: Pyramid | None = None
        self._unpooled: ChangeReader | None = None
        if not self._lazy and self.unseen is None:
            self.grid.complete()

    def _make_grid(self, cost: Float2D | None) -> None:
        heights = self._heights
        sides = self.sides_m
        model = self._model
        if cost is not None:
            self.grid = Grid.of(cost, model, self._corner_cutting)
        elif heights is None or sides is None:
            self.grid.measure_bounds()
        else:
            rows, cols = heights.shape
            corner_cutting = self._corner_cutting
            rule = self._limits.rule(*sides, scale=model.scale)
            coarsest = FACTOR ** len(coarse_shapes(rows, cols))
            unseen = None if self.unseen is None else self.unseen.layers
            weights = bordered(rows, cols, small=unseen is not None)
            self.grid = Grid(rows, cols, model, corner_cutting, weights)
            self.grid.compute_by(
                Tiles(heights, rule, weights, corner_cutting, coarsest, self.told, unseen)
            )
            if unseen is not None:  # prices may be greater than any cost
                self.grid.set_bounds(self.grid.least, MOST_PRICE * model.scale)

    def _put_robot(self, heights: Float2D, sides_m: tuple[float, float]) -> None:
        """Put the robot on a map of heights; each kind's room is loaded where there is one."""
        if self.vehicle is not None and not self.vehicle.is_disc:
            from nnpp_edge.runtime.robots.body.poses import Poses
            from nnpp_edge.runtime.robots.body.robot import body_robot

            known = self.known_heights((0, 0, *self.shape))
            shut = None if self.told is None else self.told >= 1.0
            unseen = None if self.unseen is None else self.unseen.layers
            terms = self._limits.body_weights
            scale = self._model.scale
            poses = Poses(known, sides_m, self.vehicle, terms, scale, shut, unseen)
            self.grid.drive_by(body_robot(poses))
        if self._slope_cost is not None:
            from nnpp_edge.runtime.robots.slope.directed import SlopeRobot

            self.grid.drive_by(SlopeRobot(heights, sides_m, self._slope_cost, self.grid))

    def begin_anew(self) -> None:
        """Forget all but the layers. Whoever read the log must be made anew."""
        self._lay_out()

    def __getstate__(self) -> dict[str, object]:
        """The layers: a copy starts a log of its own."""
        anew = ("log", "_pyramid", "_unpooled", *(() if self._heights is None else ("grid",)))
        return {name: value for name, value in self.__dict__.items() if name not in anew}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._lay_out()

    @property
    def _tiles(self) -> Tiles:
        assert self.grid.tiles is not None
        return self.grid.tiles

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.grid.shape

    @property
    def pyramid(self) -> Pyramid:
        """The coarse levels, as the map is now. Made when first read, and brought up to date when
        read again.
        """
        return self.pyramid_by(NEVER)

    def pyramid_by(self, deadline: Deadline) -> Pyramid:
        """As `pyramid`; at the deadline OutOfTimeError, and the next call goes on from there."""
        if self._pyramid is None or self._unpooled is None:
            self._pyramid = Pyramid(self.grid)
            self._unpooled = self.log.reader()
            if not self._lazy:
                self.grid.complete(deadline)
        elif changes := self._unpooled.read():
            whole = (0, 0, *self.shape)
            for part in [whole] if any(c.rescaled for c in changes) else [c.part for c in changes]:
                self._pyramid.update(part)
        return self._pyramid.finish(deadline)

    def update(
        self, row: int, col: int, patch: Float2D, seen: NDArray[np.bool_] | None = None
    ) -> Change:
        """Put new costs (h, w) into the map at (row, col), and what that changed into the log.

        Where nothing is known (NaN) a map of costs becomes impassable, and on a map of heights
        nothing is told. `seen` are the cells that get new costs, by default all. InvalidMapError as
        for `Grid.update`; the map is as it was.
        """
        costs = as_map(patch, "patch")
        part = patch_at((row, col), costs.shape, self.shape)
        keeps = self.log.keeps_old_weights
        if self._heights is None:
            change = self.grid.update(costs, part[:2], keep_old_weights=keeps, seen=seen)
            if self._unknown is not None:
                np.copyto(
                    self._unknown[slices(part)],
                    np.isnan(costs),
                    where=True if seen is None else seen,
                )
            return self._noted(change, change.part)
        if _PAPER.refuses(costs):
            _PAPER.refuse(float(np.nanmin(costs)))
        if self.told is None:
            self.told = self._tiles.tell_from_now_on()
            for grid in (
                self.grid,
                *(level.grid for level in (self._pyramid.levels[1:] if self._pyramid else ())),
            ):
                grid.pack()
        known = ~np.isnan(costs) if seen is None else ~np.isnan(costs) & seen
        told = np.where(
            costs < 1.0, np.float32(0.0) if self._shut_alone else costs, np.float32(np.inf)
        )
        change, new = self._tiles.write(part, told, known, told=True, keeps=keeps)
        return self._noted(change, new)

    def update_elevation(
        self, row: int, col: int, patch: Float2D, seen: NDArray[np.bool_] | None = None
    ) -> Change:
        """Put new elevations into a map that was made from such, and what that changed into the
        log; as `update`.

        Metres, NaN where unknown; heights that the map has already change nothing.
        """
        if self._heights is None:
            raise InvalidMapError("wanted costs, as the map was made from such: update takes them")
        heights, _ = relative_heights(patch, self._base)
        part = patch_at((row, col), heights.shape, self.shape)
        change, new = self._tiles.write(
            part, heights, ALL_SEEN if seen is None else seen, keeps=self.log.keeps_old_weights
        )
        return self._noted(change, new, heights=True)

    def known_heights(self, part: Rectangle) -> Float2D:
        """Heights of a part of the map, NaN where they mean nothing."""
        assert self._heights is not None
        heights: Float2D = self._heights[slices(part)]
        return (
            heights
            if self.unseen is None
            else np.where(self.unknown(*slices(part)), np.float32(np.nan), heights)
        )

    def _noted(self, change: Change, part: Rectangle, *, heights: bool = False) -> Change:
        """Put a change into the log, once all that depends on it follows: `part` is where new
        heights, or else costs, were put.
        """
        if self.unseen is not None:
            self.unseen.note(part)
        change = self.grid.robot.follow(change, part, self, heights=heights)
        if change.cells:
            self.log.append(change)
        return change

    def cost(self) -> Float2D:
        """(H, W) float32, a copy of what each cell costs: inf where impassable, NaN where a map of
        costs is unknown.

        By Eq. 1 on a map of heights, whatever vehicle stands on it. Any thread may ask, while
        another changes the map or plans on it: then it is some of the old map and some of the new.
        """
        if self._heights is not None and self.sides_m is not None:
            (dy, dx), heights = self.sides_m, self.known_heights((0, 0, *self.shape)).copy()
            cost = traversability_cost(heights, dy, self._limits, cell_width_m=dx, warn=False)
            if self.unseen is not None:
                cost = np.where(np.isfinite(heights), cost, self.unseen.at())
            return cost if self.told is None else np.maximum(cost, self.told)
        weights = self.grid.map().copy()
        scale = self._model.scale
        cost = (
            weights / np.float32(scale)
            if scale
            else np.where(weights < np.inf, np.float32(0.0), weights)
        )
        return cost if self._unknown is None else np.where(self._unknown, np.float32(np.nan), cost)

    def elevation(self) -> Float2D | None:
        """(H, W) metres, NaN where unknown, a copy; None for a map of costs. Any thread may ask, as
        for `cost`.
        """
        if (heights := self._heights) is None:
            return None
        return np.where(self.unknown(), np.nan, heights + np.asarray(self._base, heights.dtype))

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> NDArray[np.bool_]:
        """Cells of which nothing is known, of the map or a part; a map of costs tells only if it
        was to keep them.
        """
        if self._heights is not None:
            unknown = ~np.isfinite(self._heights[rows, cols])
            return unknown if self.unseen is None else unknown | self.unseen.unknown(rows, cols)
        unknown = np.zeros(self.shape, np.bool_) if self._unknown is None else self._unknown
        return unknown[rows, cols].copy()

    def known_along(self, path: NDArray[np.int32]) -> int:
        """Number of the cells of a path (N, 2), from its first on, that are known, with all under a
        body.
        """
        if self.unseen is None or self._heights is None:
            return len(path)
        reach = self.grid.robot.reach
        known = 0
        together = _TOGETHER
        while known < len(path):  # as many cells as have nothing unknown around all of them
            some = path[known : known + together]
            top, left = some.min(0).tolist()
            bottom, right = some.max(0).tolist()
            around = (top, left, bottom - top + 1, right - left + 1)
            part = widened(around, reach, self.shape)
            if self.unseen.means(part) and np.isfinite(self._heights[slices(part)]).all():
                known += len(some)
                together = min(2 * together, _TOGETHER)
            elif together == 1:
                return known
            else:
                together //= 2
        return known

    @property
    def room(self) -> Packed:
        """Obstacles that lines must keep away from, see `records.Room`."""
        return NO_DISC

    @property
    def has_heights(self) -> bool:
        """Whether the map was made from heights."""
        return self._heights is not None

    @property
    def reach_cells(self) -> int:
        """From the vehicle's middle to its farthest corner; 0 for a point."""
        if self.vehicle is None or self.sides_m is None:
            return 0
        return math.ceil(self.vehicle.reach_m / min(self.sides_m))

    def along(self, line: Line, at: Line | None = None) -> Along | None:
        """Ground under a line (N, 2) inside the map; None on a map of costs, whose heights are not
        known.

        It is told at places `at` (M, 2), by default where the line crosses rows and columns of
        cells' middles.
        """
        if self._heights is None or self.sides_m is None:
            return None
        places = crossings(line) if at is None else at
        walker = (
            self._slope_cost if self._slope_cost is not None and self._slope_cost.function else None
        )
        heights = heights_at(self._heights, places)
        if self.unseen is not None:
            heights = self.unseen.heights_at(places, heights)
        return Along(places, heights + self._base, self.sides_m, self.mobility, walker)

    @property
    def checked(self) -> int:
        """Poses of a vehicle that have been checked so far."""
        return self.grid.robot.checks

    @property
    def costs_computed(self) -> float:
        """Share of the map's cells whose cost is there, in [0, 1]."""
        tiles = self.grid.tiles
        return 1.0 if tiles is None else tiles.cells_computed / self.grid.cells


class DiscState(MapState):
    """The map of a disc: a point's, on which cells are shut too where the disc would touch an
    obstacle.

    So are those from which it would on its way to the cells beside them. What lies off the map is
    an obstacle. All costs are computed at once.
    """

    def __init__(
        self, ground: Ground, omega: float, corner_cutting: bool, *, lazy: bool, tell_unknown: bool
    ) -> None:
        assert ground.vehicle is not None and ground.vehicle.radius_m is not None
        point = replace(
            ground,
            vehicle=None,
            step_cost=StepCost.PAPER if ground.cost is None else ground.step_cost,
        )
        by_slope = ground.cost is None and ground.by_slope
        self._point = MapState(
            point, omega, corner_cutting, lazy=False, tell_unknown=True, shut_alone=by_slope
        )
        self._radius_m = ground.vehicle.radius_m
        dy, dx = ground.sides_m
        # a disc half a step away is within this of the cell, as far as it is not within it of the
        # next
        reach = math.hypot(self._radius_m, 0.5 * math.hypot(dy, dx))
        self._reach = rows, cols = math.ceil(reach / dy + 0.5), math.ceil(reach / dx + 0.5)
        down = np.maximum(np.abs(np.arange(-rows, rows + 1)) - 0.5, 0.0) * dy
        along = np.maximum(np.abs(np.arange(-cols, cols + 1)) - 0.5, 0.0) * dx
        self._touched = (np.hypot(down[:, None], along) < reach).astype(np.uint8)
        super().__init__(ground, omega, corner_cutting, lazy=lazy, tell_unknown=False)

    def _heights_of(self, _: Ground) -> tuple[Float2D | None, float]:
        return self._point._heights, self._point._base

    def begin_anew(self) -> None:
        """As `MapState.begin_anew`."""
        self._point.begin_anew()
        self._lay_out()

    def _make_grid(self, cost: Float2D | None) -> None:
        rows, cols = self._point.shape
        self.grid = Grid(rows, cols, self._model, self._corner_cutting)
        self.grid.update(self._shut((0, 0, rows, cols)), weights=True)

    def _shut(self, part: Rectangle) -> Float2D:
        """(h, w) weights of a part of the map, inf where the disc would touch an obstacle."""
        import cv2  # takes a tenth of a second to load

        weights = self._point.grid.map()
        row, col, rows, cols = part
        down, along = self._reach
        top, left, high, wide = seen = widened(part, self._reach, self.shape)
        obstacles = np.ones((rows + 2 * down, cols + 2 * along), np.uint8)
        obstacles[slices((top - row + down, left - col + along, high, wide))] = ~(
            weights[slices(seen)] < np.inf
        )
        touched = cv2.dilate(
            obstacles, self._touched, borderType=cv2.BORDER_CONSTANT, borderValue=1
        )
        return np.where(
            touched[down : down + rows, along : along + cols],
            np.float32(np.inf),
            weights[slices(part)],
        )

    @property
    def room(self) -> Packed:
        """The disc's own."""
        sides = self.sides_m or (1.0, 1.0)
        return tuple(Room(self._point.grid.weights, *self.shape, self._radius_m, *sides))

    def update(
        self, row: int, col: int, patch: Float2D, seen: NDArray[np.bool_] | None = None
    ) -> Change:
        """As `MapState.update`, of a point's costs."""
        change = self._point.update(row, col, patch, seen)
        return self._followed(change, (row, col, 0, 0), heights=False)

    def update_elevation(
        self, row: int, col: int, patch: Float2D, seen: NDArray[np.bool_] | None = None
    ) -> Change:
        """As `MapState.update_elevation`."""
        change = self._point.update_elevation(row, col, patch, seen)
        return self._followed(change, (row, col, *np.shape(patch)), heights=True)

    def _followed(self, change: Change, part: Rectangle, *, heights: bool) -> Change:
        """Bring up to date what the disc can stand on around a change of the point's map."""
        if change.cells:
            around = widened(change.part, self._reach, self.shape)
            keeps = self.log.keeps_old_weights
            change = self.grid.update(
                self._shut(around), around[:2], keep_old_weights=keeps, weights=True
            )
        return self._noted(change, part, heights=heights)

    def cost(self) -> Float2D:
        """As `MapState.cost`: a point's costs."""
        return self._point.cost()

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> NDArray[np.bool_]:
        """As `MapState.unknown`."""
        return self._point.unknown(rows, cols)


@checked(InvalidQueryError)
def map_state(
    ground: Ground,
    omega: float = PAPER_OMEGA,
    corner_cutting: bool = True,
    *,
    lazy: bool = True,
    warn: bool = False,
    tell_unknown: bool = False,
) -> MapState:
    """The map of a ground to plan on, whose arrays are its own.

    `omega`, `corner_cutting`, `lazy` and `warn` as in `PlannerOptions`; with `tell_unknown` it is
    kept which cells of a map of costs are unknown, apart from those that are impassable.
    InvalidMapError, InvalidQueryError as for `Planner`.
    """
    by_slope = ground.elevation is not None and ground.by_slope
    body_bytes = (
        0 if ground.elevation is None or ground.vehicle is None else bytes_per_cell(ground.vehicle)
    )
    if ground.factor == 1 or body_bytes:  # else memory goes by what is seen
        check_planner_fits(ground.shape, DIRECTED_BYTES_PER_CELL * by_slope + body_bytes)
    if warn and ground.elevation is not None and ground.factor == 1:
        heights = relative_heights(ground.elevation)[0]
        warn_of_saturation(
            heights, ground.limits, ground.sides_m, stacklevel=7
        )  # who called the planner
    kind = DiscState if ground.vehicle is not None and ground.vehicle.is_disc else MapState
    return kind(ground, omega, corner_cutting, lazy=lazy, tell_unknown=tell_unknown)
