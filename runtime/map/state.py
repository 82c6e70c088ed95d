"""A map that is planned on: its grid, its coarse levels, and the log of its changes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Rectangle, patch_at
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.along import Along, Heights, Line, crossings, heights_at
from nnpp_edge.runtime.map.changes import Change, ChangeLog, ChangeReader
from nnpp_edge.runtime.map.directed import DirectedSteps
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.poses import Poses, term_weights
from nnpp_edge.runtime.map.pyramid import Pyramid, coarse_shapes
from nnpp_edge.runtime.map.slope_cost import Mobility, SlopeCost, SpeedCost
from nnpp_edge.runtime.map.step_cost import StepCost, StepModel
from nnpp_edge.runtime.terrain.traversability import Traversability, relative_heights, warn_of_saturation
from nnpp_edge.runtime.terrain.vehicle import Vehicle


class _Elevation(NamedTuple):
    """What a map of elevations is laid out from."""

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
    """The newest map. Whoever keeps something that depends on it reads the log of changes when asked.

    Serves one thread at a time.

    Parameters
    ----------
    cost : (H, W) float
        As for `Grid.of`.
    model : StepModel
        What a step costs.
    corner_cutting : bool
        Whether a diagonal step may pass beside an impassable cell.

    Raises
    ------
    InvalidMapError
        The map is not two-dimensional, is empty, or holds a cost out of range.
    """

    mobility = Mobility()
    """By what time and energy along a path are computed."""

    def __init__(self, cost: Float2D, model: StepModel, *, corner_cutting: bool = True) -> None:
        self._elevation: _Elevation | None = None
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
            warn_of_saturation(heights, rule, stacklevel=5)  # whoever called `Planner.of_elevation`
        surface = sides_m, traversability, vehicle, slope_cost
        state._lay_out(_Elevation(heights, base, rule, model, corner_cutting, lazy, *surface))
        return state

    def _lay_out(self, elevation: "_Elevation") -> None:
        """Begin with heights of which nothing has been computed."""
        heights, _, rule, model, corner_cutting, lazy, sides_m, traversability, vehicle, slope_cost = elevation
        self._elevation = elevation
        coarsest = FACTOR ** len(coarse_shapes(*heights.shape))
        self.grid = Grid.of_heights(heights, rule, model, corner_cutting, coarsest)
        if vehicle is not None:
            terms = term_weights(traversability)
            self.grid.stand_by(Poses(heights, sides_m, vehicle, terms, model.scale))
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
        kept = {"_elevation": self._elevation, "mobility": self.mobility}
        return {"grid": None if self._elevation else self.grid, **kept}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        if self._elevation is not None:
            self._lay_out(self._elevation)
        self._forget()

    def begin_anew(self) -> None:
        """Forget all but the weights, or the heights. Whoever read the log must be made anew."""
        if self._elevation is not None:
            self._lay_out(self._elevation)
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
        """The same; at the deadline OutOfTimeError, and the next call goes on from there."""
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

    def update(self, row: int, col: int, patch: Float2D) -> Change:
        """Put new costs into the map, and what that changed into the log, unless it changed nothing.

        Parameters
        ----------
        row, col : int
            Where the patch's first cell goes.
        patch : (h, w) float
            New costs; must lie inside the map.

        Raises
        ------
        InvalidMapError
            As for `Grid.update`; the map is as it was.
        """
        if self._elevation is not None:
            raise InvalidMapError("wanted elevations, as the map was made from such: update_elevation takes them")
        change = self.grid.update(patch, (row, col), keep_old_weights=self.log.keeps_old_weights)
        return self._noted(change, change.part)

    def _noted(self, change: Change, heights: Rectangle) -> Change:
        """Put a change into the log, once directed steps follow it and that of the heights in a rectangle."""
        if isinstance(self.grid.directed, DirectedSteps):
            change = self.grid.directed.follow(change, heights)
        if change.cells:
            self.log.append(change)
        return change

    def update_elevation(self, row: int, col: int, patch: Float2D) -> Change:
        """Put new elevations into a map that was made from such, and what that changed into the log.

        Parameters
        ----------
        row, col : int
            Where the patch's first cell goes.
        patch : (h, w) float
            Metres, NaN where unknown; must lie inside the map.

        Raises
        ------
        InvalidMapError
            The patch does not lie inside the map, or this was made from costs. The map is as it was.
        """
        tiles = self.grid.tiles
        if self._elevation is None or tiles is None:
            raise InvalidMapError("wanted costs, as the map was made from such: update takes them")
        heights, _ = relative_heights(patch, self._elevation.base)
        row, col, _, _ = patch_part = patch_at((row, col), heights.shape, self.shape)
        cells, cheaper, part = tiles.write(row, col, heights)
        if self.grid.poses is not None:
            part = self.grid.poses.write(row, col, heights)
            cells, cheaper = part[2] * part[3], True
        return self._noted(Change(part, cells, cheaper), patch_part)

    @property
    def sides_m(self) -> tuple[float, float] | None:
        """Height and width of a cell; None where nobody has said."""
        return None if self._elevation is None else self._elevation.sides_m

    @property
    def turning_radius_m(self) -> float | None:
        """The vehicle's; None where any turn will do."""
        vehicle = None if self._elevation is None else self._elevation.vehicle
        return None if vehicle is None else vehicle.turning_radius_m

    def along(self, line: Line) -> Along | None:
        """What lies under a line (N, 2) inside the map; None on a map of costs, whose heights are not known."""
        if (ground := self._ground()) is None:
            return None
        (heights, base, sides_m), places = ground, crossings(line)
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
