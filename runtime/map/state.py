"""A map that is planned on: its layers, the grid they make, its coarse levels, and the log of its
changes.
"""

import math
from collections.abc import Sequence
from pkgutil import resolve_name
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Bool, Cells, Float2D
from nnpp_edge.runtime.cells import Rectangle, enclosing, holding, patch_at, slices, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.runtime.kernels.records import Packed
from nnpp_edge.runtime.map.changes import Change, ChangeLog, ChangeReader
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.layers import Costs, Layer, Lowest
from nnpp_edge.runtime.memory import (
    DIRECTED_BYTES_PER_CELL,
    check_planner_fits,
    is_filed,
)
from nnpp_edge.runtime.robots.robot import Robot
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA, StepCost, StepModel

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.along import Along, Line
    from nnpp_edge.runtime.map.heights import Heights
    from nnpp_edge.runtime.map.pyramid import Pyramid

_MADE = ("grid", "point", "log", "_pyramid", "_unpooled")
"""Made from the layers: a copy makes its own."""
_TOGETHER = 64
"""Cells of a path around which is looked at once, at most, for what is unknown."""


class MapState:
    """The newest map, a stack of layers, made by `map_state`. Serves one thread at a time.

    Whoever keeps something that depends on it reads the log of changes when asked. `layers` are
    lowest first: that makes the grid. With a disc's vehicle cells are shut too where it would touch
    an obstacle.
    """

    def __init__(self, ground: Ground, layers: Sequence[Layer], *, lazy: bool = True) -> None:
        self.layers = {layer.name: layer for layer in layers}
        """By the name by which their patches come."""
        self._lowest: Lowest = layers[0]  # type: ignore[assignment]  # as for the class
        self.heights: Heights | None = self.layers.get("heights")  # type: ignore[assignment]
        """The layer of heights; None on a map of costs."""
        self.unseen = None if self.heights is None else self.heights.unseen
        """Blocks that are known by their means; None where cells are known, or nothing."""
        self.vehicle = ground.vehicle
        """Whose path it is; None for a point."""
        self.sides_m = ground.sides_m
        """Height and width of a cell; 1 where it is not known."""
        self._lazy = lazy
        self._mobility = ground.mobility
        self._slope_cost = ground.slope_cost
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget all but the layers. Whoever read the log must be made anew."""
        grid = self._lowest.begin()
        self.grid = self.point = grid
        """The robot's, and a point's: one, unless the robot's stance or price weighs cells anew."""
        robot = Robot()
        if self.vehicle is not None:
            robot = resolve_name(self.vehicle.kind.robot)(self, self.vehicle, self.sides_m)
        self._put(robot, grid.model)
        if self._slope_cost is not None:
            from nnpp_edge.runtime.robots.slope.directed import price_of

            price = price_of(self, self._slope_cost, self.sides_m)
            robot = robot._replace(price=price)
            if not price.directed:
                self._put(robot, StepModel.of(StepCost.LENGTH))
            self.grid.drive_by(robot)
        if not self._lazy:
            self.grid.complete()
        self.log = ChangeLog()
        self._pyramid: Pyramid | None = None
        self._unpooled: ChangeReader = self.log.reader()

    def _put(self, robot: Robot, model: StepModel) -> None:
        """Put a robot on the map, with weights of its own if its stance or its price has any."""
        own = self._own_weights(robot, (0, 0, *self.shape))
        if own is not None:
            self.grid = Grid(*self.shape, model, self.point.corner_cutting)
            self.grid.update(own, weights=True)
        self.grid.drive_by(robot)

    def _own_weights(self, robot: Robot, part: Rectangle) -> Float2D | None:
        """(h, w) weights of a part by a robot's stance and price; None where a point's serve."""
        shut = robot.stance.shut(self.point, part)
        priced = robot.price.weights(part)
        if shut is None and priced is None:
            return None
        weights = self.point.map()[slices(part)]
        if priced is not None:
            weights = np.where(weights < np.inf, priced, weights)
        return weights if shut is None else np.where(shut, np.float32(np.inf), weights)

    def __getstate__(self) -> dict[str, object]:
        """The layers: a copy starts a log of its own."""
        return {name: value for name, value in vars(self).items() if name not in _MADE}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self.begin_anew()

    @property
    def room(self) -> Packed | None:
        """Obstacles that a disc's lines must keep away from, see `records.Room`."""
        return self.grid.robot.stance.room(self.point)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.grid.shape

    @property
    def pyramid(self) -> "Pyramid":
        """The coarse levels, as the map is now. Made when first read, and brought up to date when
        read again.
        """
        return self.pyramid_by(NEVER)

    def pyramid_by(self, deadline: Deadline) -> "Pyramid":
        """As `pyramid`; at the deadline OutOfTimeError, and the next call goes on from there."""
        changes = self._unpooled.read()
        if self._pyramid is None:
            from nnpp_edge.runtime.map.pyramid import Pyramid

            self._pyramid = Pyramid(self.grid)
            tiles = self.grid.tiles
            if not self._lazy:
                self.grid.complete(deadline)
            elif tiles is not None and is_filed(tiles.heights):
                # a file is read from its first row to its last, not where a search comes first
                tiles.pool(deadline)
        elif any(change.rescaled for change in changes):
            self._pyramid.update((0, 0, *self.shape))
        else:
            for change in changes:
                self._pyramid.update(change.part)
        return self._pyramid.finish(deadline)

    def update(
        self, row: int, col: int, patch: Float2D, seen: Bool | None = None, layer: str = "cost"
    ) -> Change:
        """Put new numbers (h, w) into a layer at (row, col), by default costs, and what that
        changed into the log.

        Where nothing is known (NaN) a map of costs becomes impassable, and on a map of heights
        nothing is told. ``heights`` are metres, NaN where unknown; those that the map has already
        change nothing. `seen` are the cells that get new numbers, by default all. InvalidMapError
        as for `Grid.update`, and without such a layer; the map is as it was.
        """
        if layer not in self.layers:
            raise InvalidMapError(f"wanted costs, or one of {', '.join(self.layers)}, got {layer}")
        changed = self.layers[layer]
        numbers = changed.read(patch)
        part = patch_at((row, col), numbers.shape, self.shape)
        keeps = self.log.keeps_old_weights
        one = self.grid is self.point
        change, new = changed.put(part, numbers, seen, keeps=keeps and one)
        if not one and (new[2] or change.cells):
            down, right = self.grid.robot.stance.reach
            touched = enclosing([each for each in (new, change.part) if each[2]])
            around = widened(touched, (down + 1, right + 1), self.shape)
            weights = self._own_weights(self.grid.robot, around)
            assert weights is not None
            change = self.grid.update(weights, around[:2], keep_old_weights=keeps, weights=True)
        if self.unseen is not None:
            self.unseen.note(new)
        change = self.grid.robot.follow(change, new, self, heights=changed is self.heights)
        if change.cells:
            self.log.append(change)
        return change

    def cost(self) -> Float2D:
        """(H, W) float32, a copy of what each cell costs: inf where impassable, NaN where a map of
        costs is unknown.

        By Eq. 1 on a map of heights, whatever vehicle stands on it. Any thread may ask, while
        another changes the map or plans on it: then it is some of the old map and some of the new.
        """
        cost = self._lowest.cost()
        heights = self.heights
        return np.maximum(cost, heights.told) if heights is not None and heights.tells else cost

    def elevation(self) -> Float2D | None:
        """(H, W) metres, NaN where unknown, a copy; None for a map of costs. Any thread may ask, as
        for `cost`.
        """
        heights = self.heights
        if heights is None:
            return None
        base = np.asarray(heights.base, heights.array.dtype)
        return np.where(self.unknown((0, 0, *self.shape)), np.nan, heights.array + base)

    def unknown(self, part: Rectangle) -> Bool:
        """(h, w) cells of a part of the map of which nothing is known; a map of costs tells only
        if it was to keep them.
        """
        return self._lowest.unknown(part)

    def known_along(self, path: Cells) -> int:
        """Number of the cells of a path (N, 2), from its first on, that are known, with all under a
        body.
        """
        if self.unseen is None or self.heights is None:
            return len(path)
        known = 0
        together = _TOGETHER
        while together and known < len(path):
            # as many cells as have nothing unknown around all of them
            some = path[known : known + together]
            part = widened(holding(some), self.grid.robot.stance.reach, self.shape)
            if self.unseen.means(part) and np.isfinite(self.heights.array[slices(part)]).all():
                known += len(some)
                together = min(2 * together, _TOGETHER)
            else:
                together //= 2
        return known

    def along(self, line: "Line", at: "Line | None" = None) -> "Along | None":
        """Ground under a line (N, 2) inside the map; None on a map of costs, whose heights are not
        known.

        It is told at places `at` (M, 2), by default at `along.places_along` of the line.
        """
        if self.heights is None:
            return None
        from nnpp_edge.runtime.map.along import UNTOLD, Along, places_along

        places = places_along(line) if at is None else at
        slope_cost = self._slope_cost
        walker = slope_cost if slope_cost is not None and slope_cost.function else None
        metres = self.heights.metres_at(places)
        return Along(places, metres, self.sides_m, self._mobility or UNTOLD, walker)

    @property
    def reach_cells(self) -> int:
        """From the vehicle's middle to its farthest corner; 0 for a point."""
        if self.vehicle is None:
            return 0
        return math.ceil(self.vehicle.reach_m / min(self.sides_m))

    @property
    def costs_computed(self) -> float:
        """Share of the map's cells whose cost is there, in [0, 1]."""
        tiles = self.grid.tiles
        return 1.0 if tiles is None else tiles.cells_computed / self.grid.cells


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
    heights = ground.elevation
    vehicle = ground.vehicle
    body_bytes = 0 if heights is None or vehicle is None else vehicle.bytes_per_cell
    if ground.factor == 1 or body_bytes:  # else memory goes by what is seen
        directed = ground.slope_cost is not None and not ground.slope_cost.symmetric
        more = DIRECTED_BYTES_PER_CELL * directed + body_bytes
        check_planner_fits(ground.shape, more, filed=is_filed(heights))
    if heights is None:
        model = StepModel.of(ground.step_cost, omega)
        costs = Costs(ground.costs(), model, corner_cutting, tell_unknown or vehicle is not None)
        return MapState(ground, [costs])
    from nnpp_edge.runtime.map.heights import Given, Heights, Told

    lowest = Heights(ground, StepModel.of(StepCost.PAPER, omega), corner_cutting)
    if warn and lowest.unseen is None:
        from nnpp_edge.runtime.terrain.traversability import warn_of_saturation

        warn_of_saturation(lowest.array, ground.limits, ground.sides_m)
    by_cells = ground.body is None and ground.slope_cost is None
    layers = [lowest, Told(lowest, shut_alone=not by_cells)]
    layers += [Given(lowest, name) for name in ground.layers]
    return MapState(ground, layers, lazy=lazy or lowest.unseen is not None)
