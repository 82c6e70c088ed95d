"""A map that is planned on: its grid, its coarse levels, and the log of its changes."""

import math
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Cell, Rectangle, patch_at
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels.any_angle import NO_DISC
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.along import Along, Heights, Line, crossings, heights_at
from nnpp_edge.runtime.map.changes import Change, ChangeLog, ChangeReader
from nnpp_edge.runtime.map.directed import DirectedSteps
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.poses import Poses, term_weights
from nnpp_edge.runtime.map.pyramid import Pyramid, coarse_shapes
from nnpp_edge.runtime.map.slope_cost import Mobility, SlopeCost, SpeedCost
from nnpp_edge.runtime.map.step_cost import StepCost, StepModel
from nnpp_edge.runtime.map.tiles import Tiles
from nnpp_edge.runtime.terrain.traversability import (
    Traversability,
    relative_heights,
    traversability_cost,
    warn_of_saturation,
)
from nnpp_edge.runtime.terrain.vehicle import Vehicle

Room = tuple[NDArray[np.float32], int, int, float, float, float, float]
_PAPER = StepModel.of(StepCost.PAPER)


class _Elevation(NamedTuple):
    """All that a map of elevations is laid out from."""

    heights: Float2D
    base: float
    """Height in metres that `heights` are relative to."""
    rule: NDArray[np.float64]
    model: StepModel
    corner_cutting: bool
    lazy: bool
    sides_m: tuple[float, float]
    traversability: Traversability
    vehicle: Vehicle | None
    slope_cost: SlopeCost | None


class MapState:
    """The newest map, in layers: heights, and costs that were told; a map without heights has the costs alone.

    Each patch changes its own layer. A cell of a map of heights costs the greater of what its heights make of it and
    of what was told, and is shut where either says so. To a body, and where steps cost by the slope, a cost below 1
    says nothing but that the cell is not shut.

    Whoever keeps something that depends on it reads the log of changes when asked. Serves one thread at a time.
    `cost` as for `Grid.of`; with `tell_unknown` it is kept which cells are unknown, apart from those that are
    impassable.
    """

    mobility = Mobility()
    """By what time and energy along a path are computed."""

    def __init__(
        self, cost: Float2D, model: StepModel, *, corner_cutting: bool = True, tell_unknown: bool = False
    ) -> None:
        self._elevation: _Elevation | None = None
        self._unknown = np.isnan(as_map(cost, "cost")) if tell_unknown else None
        self.grid = Grid.of(cost, model, corner_cutting)
        self._forget()

    @classmethod
    def of_elevation(
        cls,
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
    ) -> "MapState":
        """The state of an elevation map, (H, W) float in metres, NaN where unknown; copied.

        With a vehicle, steps cost by its poses. Weights are computed and poses checked where a search first looks,
        or, unless `lazy`, all at once. `sides_m` are the height and the width of a cell. Raises InvalidMapError for
        what is no such map, for one that the vehicle is larger than, or for the ``length`` model, whose weights may
        not be 0. With a `slope_cost` steps cost by it, and all weights are computed at once.
        """
        if model.kind is not StepCost.PAPER:
            raise InvalidMapError(
                "a map of elevations is planned on in the paper's step costs, wanted step_cost='paper'"
            )
        heights, base = relative_heights(dem)
        if heights is dem or np.shares_memory(heights, np.asarray(dem)):
            heights = heights.copy()
        state = cls.__new__(cls)
        rule = traversability.rule(*sides_m, scale=model.scale)
        if warn:
            warn_of_saturation(heights, rule, stacklevel=8)  # whoever called `Planner.of_elevation`
        state._unknown = None
        surface = sides_m, traversability, vehicle, slope_cost
        state._lay_out(_Elevation(heights, base, rule, model, corner_cutting, lazy, *surface))
        return state

    def _lay_out(self, elevation: "_Elevation", told: Float2D | None = None) -> None:
        """Begin with heights, and costs told, of which nothing has been computed."""
        heights, _, rule, model, corner_cutting, lazy, sides_m, traversability, vehicle, slope_cost = elevation
        self._elevation = elevation
        coarsest = FACTOR ** len(coarse_shapes(*heights.shape))
        self.grid = Grid.of_heights(heights, rule, model, corner_cutting, coarsest)
        if told is not None:
            self._tiles.tell(0, 0, told)
        if vehicle is not None:
            terms, shut = term_weights(traversability), None if told is None else told >= 1.0
            self.grid.stand_by(Poses(heights, sides_m, vehicle, terms, model.scale, shut))
        if slope_cost is not None:
            if vehicle is None and self.grid.tiles is not None:
                self.grid.tiles.complete()
            weights = self.grid.weights if vehicle is None else None
            self.grid.go_by(DirectedSteps(heights, sides_m, slope_cost, weights, corner_cutting))
        self._forget()
        if not lazy:
            self.grid.complete()

    def __getstate__(self) -> dict[str, object]:
        """The weights, or the heights: a copy starts a log of its own."""
        kept = {"_elevation": self._elevation, "mobility": self.mobility, "_unknown": self._unknown}
        return {"grid": None if self._elevation else self.grid, "told": self._told_so_far(), **kept}

    def __setstate__(self, state: dict[str, object]) -> None:
        told = cast("Float2D | None", state.pop("told"))
        self.__dict__.update(state)
        if self._elevation is not None:
            self._lay_out(self._elevation, told)
        self._forget()

    def _told_so_far(self) -> Float2D | None:
        """(H, W) the costs told to a map of heights; None where none were."""
        tiles = self.grid.tiles
        return np.array(tiles.told) if tiles is not None and tiles.has_told else None

    @property
    def _tiles(self) -> Tiles:
        assert self.grid.tiles is not None
        return self.grid.tiles

    def begin_anew(self) -> None:
        """Forget all but the weights, or the heights. Whoever read the log must be made anew."""
        if self._elevation is not None:
            self._lay_out(self._elevation, self._told_so_far())
            return
        self.grid.measure_bounds()
        self._forget()

    def _forget(self) -> None:
        self.log = ChangeLog()
        self._pyramid: Pyramid | None = None
        self._unpooled: ChangeReader | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.grid.shape

    @property
    def pyramid(self) -> Pyramid:
        """The coarse levels, as the map is now. Made when first read, and brought up to date when read again."""
        return self.pyramid_by(NEVER)

    def pyramid_by(self, deadline: Deadline) -> Pyramid:
        """As `pyramid`; at the deadline OutOfTimeError, and the next call goes on from there."""
        if self._pyramid is None or self._unpooled is None:
            self._pyramid, self._unpooled = Pyramid(self.grid, later=True), self.log.reader()
            if self._elevation is not None and not self._elevation.lazy:
                self.grid.complete(deadline)
        elif self._unpooled.behind:
            changes = self._unpooled.read()
            whole = (0, 0, *self.shape)
            for part in [whole] if any(c.rescaled for c in changes) else [c.part for c in changes]:
                self._pyramid.update(part, later=True)
        self._pyramid.finish(deadline)
        return self._pyramid

    def update(self, row: int, col: int, patch: Float2D, seen: NDArray[np.bool_] | None = None) -> Change:
        """Put new costs (h, w) into the map at (row, col), and what that changed into the log.

        Where nothing is known (NaN) a map of costs becomes impassable, and on a map of heights nothing is told.
        `seen` are the cells that get new costs, by default all. InvalidMapError as for `Grid.update`; the map is as
        it was.
        """
        costs = as_map(patch, "patch")
        row, col, rows, cols = part = patch_at((row, col), costs.shape, self.shape)
        if self._elevation is None:
            keeps = self.log.keeps_old_weights
            change = self.grid.update(costs, (row, col), keep_old_weights=keeps, seen=seen)
            if self._unknown is not None:
                here = self._unknown[row : row + rows, col : col + cols]
                np.copyto(here, np.isnan(costs), where=True if seen is None else seen)
            return self._noted(change, change.part)
        if _PAPER.refuses(costs):
            _PAPER.refuse(float(np.nanmin(costs)))
        tiles, poses = self._tiles, self.grid.poses
        before = tiles.told[row : row + rows, col : col + cols]
        told = costs_told(before, costs, seen, shut_alone=self.grid.steps.by_poses or self.grid.steps.by_slope)
        part = trimmed(part, told != before)
        if not part[2]:
            return Change(part, 0)
        told = told[part[0] - row : part[0] - row + part[2], part[1] - col : part[1] - col + part[3]]
        change = tiles.tell(part[0], part[1], told, keep_old_weights=self.log.keeps_old_weights)
        if poses is not None:
            heights = self._elevation.heights[part[0] : part[0] + part[2], part[1] : part[1] + part[3]]
            change = _of_poses(poses.write(part[0], part[1], heights, told >= 1.0))
        return self._noted(change, (*part[:2], 0, 0))

    def _noted(self, change: Change, heights: Rectangle) -> Change:
        """Put a change into the log, once directed steps follow it and that of the heights in a rectangle."""
        if isinstance(self.grid.directed, DirectedSteps):
            change = self.grid.directed.follow(change, heights)
        if change.cells:
            self.log.append(change)
        return change

    def update_elevation(self, row: int, col: int, patch: Float2D, seen: NDArray[np.bool_] | None = None) -> Change:
        """Put new elevations into a map that was made from such, and what that changed into the log; as `update`.

        Metres, NaN where unknown; heights that the map has already change nothing.
        """
        if self._elevation is None:
            raise InvalidMapError("wanted costs, as the map was made from such: update takes them")
        heights, _ = relative_heights(patch, self._elevation.base)
        part, heights = new_heights(self._elevation.heights, (row, col), heights, seen)
        if not part[2]:
            return Change(part, 0)
        row, col, rows, cols = part
        change = self._tiles.write_heights(row, col, heights, keep_old_weights=self.log.keeps_old_weights)
        if self.grid.poses is not None:
            shut = self._tiles.told[row : row + rows, col : col + cols] >= 1.0 if self._tiles.has_told else None
            change = _of_poses(self.grid.poses.write(row, col, heights, shut))
        return self._noted(change, part)

    def cost(self) -> Float2D:
        """(H, W) float32, a copy of what each cell costs: inf where impassable, NaN where a map of costs is unknown.

        By Eq. 1 on a map of heights, whatever vehicle stands on it. Any thread may ask, while another changes the map
        or plans on it: then it is some of the old map and some of the new.
        """
        if self._elevation is None:
            weights, scale = self.grid.map().copy(), self.grid.model.scale
            cost: Float2D = (
                weights / np.float32(scale) if scale else np.where(weights < np.inf, np.float32(0.0), weights)
            )
            return cost if self._unknown is None else np.where(self._unknown, np.float32(np.nan), cost)
        (dy, dx), limits = self._elevation.sides_m, self._elevation.traversability
        cost = traversability_cost(self._elevation.heights.copy(), dy, limits, cell_width_m=dx, warn=False)
        told = self._told_so_far()
        return cost if told is None else with_told(cost, told)

    def elevation(self) -> Float2D | None:
        """(H, W) metres, NaN where unknown, a copy; None for a map of costs. Any thread may ask, as for `cost`."""
        if (ground := self._ground()) is None:
            return None
        return np.where(np.isfinite(ground[0]), ground[0] + np.asarray(ground[1], ground[0].dtype), np.nan)

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> NDArray[np.bool_]:
        """Cells of which nothing is known, of the map or a part; a map of costs tells only if it was to keep them."""
        if (ground := self._ground()) is not None:
            return ~np.isfinite(ground[0][rows, cols])
        return (
            np.zeros(self.shape, np.bool_)[rows, cols] if self._unknown is None else self._unknown[rows, cols].copy()
        )

    @property
    def room(self) -> Room:
        """Obstacles that lines must keep away from, see `kernels.any_angle`."""
        return NO_DISC

    @property
    def has_heights(self) -> bool:
        """Whether the map was made from heights."""
        return self._ground() is not None

    @property
    def vehicle(self) -> Vehicle | None:
        """Whose path it is; None for a point."""
        return None if self._elevation is None else self._elevation.vehicle

    @property
    def reach_cells(self) -> int:
        """From the vehicle's middle to its farthest corner; 0 for a point."""
        if self.vehicle is None or self.sides_m is None:
            return 0
        return math.ceil(self.vehicle.reach_m / min(self.sides_m))

    @property
    def sides_m(self) -> tuple[float, float] | None:
        """Height and width of a cell; None where nobody has said."""
        return None if self._elevation is None else self._elevation.sides_m

    @property
    def turning_radius_m(self) -> float | None:
        """The vehicle's; None where any turn will do."""
        return None if self.vehicle is None else self.vehicle.turning_radius_m

    def along(self, line: Line, at: Line | None = None) -> Along | None:
        """Ground under a line (N, 2) inside the map; None on a map of costs, whose heights are not known.

        It is told at places `at` (M, 2), by default where the line crosses rows and columns of cells' middles.
        """
        if (ground := self._ground()) is None:
            return None
        (heights, base, sides_m), places = ground, crossings(line) if at is None else at
        cost = None if self._elevation is None else self._elevation.slope_cost
        walker = cost if isinstance(cost, SpeedCost) else None
        return Along(places, heights_at(heights, places) + base, sides_m, self.mobility, walker)

    def _ground(self) -> tuple[Heights, float, tuple[float, float]] | None:
        """Heights, what they are relative to, and a cell's sides."""
        if self._elevation is None:
            return None
        return self._elevation.heights, self._elevation.base, self._elevation.sides_m

    @property
    def checked(self) -> int:
        """Poses of a vehicle that have been checked so far."""
        return 0 if self.grid.poses is None else self.grid.poses.checked

    @property
    def costs_computed(self) -> float:
        """Share of the map's cells whose cost is there, in [0, 1]."""
        tiles = self.grid.tiles
        return 1.0 if tiles is None else tiles.cells_computed / self.grid.cells


def _of_poses(part: Rectangle) -> Change:
    """A change of which no more is known than where poses may be other ones."""
    return Change(part, part[2] * part[3], cheaper=True)


def costs_told(
    before: Float2D, costs: Float2D, seen: NDArray[np.bool_] | None, *, shut_alone: bool = False
) -> Float2D:
    """Costs told after a patch, (h, w) like all of these: 0 where nothing was ever told, inf where a cell is shut.

    A cell that is NaN or not `seen` keeps what was told `before`. With `shut_alone` a cost below 1 opens the cell and
    says no more.
    """
    new = np.where(costs < 1.0, np.float32(0.0) if shut_alone else costs, np.float32(np.inf))
    kept = np.isnan(costs) if seen is None else np.isnan(costs) | ~seen
    told: Float2D = np.where(kept, before, new).astype(np.float32)
    return told


def with_told(cost: Float2D, told: Float2D) -> Float2D:
    """(h, w) the greater of the costs that heights make and of those told; unknown cells are impassable."""
    greater: Float2D = np.maximum(cost, told)
    return greater


def new_heights(
    known: Float2D, place: Cell, heights: Float2D, seen: NDArray[np.bool_] | None
) -> tuple[Rectangle, Float2D]:
    """The least part of a patch of heights that holds all that a map (H, W) does not have yet, and its heights.

    The patch lies at `place`; cells that are not `seen` keep their heights. No rows where nothing is new.
    """
    row, col, rows, cols = part = patch_at(place, heights.shape, (known.shape[0], known.shape[1]))
    old = known[row : row + rows, col : col + cols]
    new = heights if seen is None else np.where(seen, heights, old)
    part = trimmed(part, (new != old) & (np.isfinite(new) | np.isfinite(old)))
    top, left = part[0] - row, part[1] - col
    return part, new[top : top + part[2], left : left + part[3]]


def trimmed(part: Rectangle, changed: NDArray[np.bool_]) -> Rectangle:
    """The least rectangle of a part that holds its changed cells; no rows without any."""
    rows, cols = np.flatnonzero(changed.any(1)), np.flatnonzero(changed.any(0))
    if not len(rows):
        return part[0], part[1], 0, 0
    row, col = int(rows[0]), int(cols[0])
    return part[0] + row, part[1] + col, int(rows[-1]) - row + 1, int(cols[-1]) - col + 1
