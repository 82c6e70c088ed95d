"""The map of costs, and the map of any ground."""

from dataclasses import replace

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Bool, Float2D, as_map
from nnpp_edge.runtime.cells import patch_at, slices
from nnpp_edge.runtime.errors import InvalidQueryError, users_line
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.memory import DIRECTED_BYTES_PER_CELL, bytes_per_cell, check_planner_fits
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA, StepCost, StepModel


class CostState(MapState):
    """A map of costs, which are its grid; with `tell_unknown` it keeps which cells are unknown."""

    def __init__(
        self, ground: Ground, model: StepModel, corner_cutting: bool, tell_unknown: bool
    ) -> None:
        cost = ground.costs()
        self._unknown = np.isnan(cost) if tell_unknown else None
        self.grid = Grid.of(cost, model, corner_cutting)
        super().__init__(ground)

    def begin_anew(self) -> None:
        """As `MapState.begin_anew`."""
        self.grid.measure_bounds()
        super().begin_anew()

    def update(self, row: int, col: int, patch: Float2D, seen: Bool | None = None) -> Change:
        """As `MapState.update`."""
        costs = as_map(patch, "patch")
        keeps = self.log.keeps_old_weights
        change = self.grid.update(costs, (row, col), keep_old_weights=keeps, seen=seen)
        if self._unknown is not None:
            here = slices(patch_at((row, col), costs.shape, self.shape))
            np.copyto(self._unknown[here], np.isnan(costs), where=True if seen is None else seen)
        return self._noted(change, change.part)

    def cost(self) -> Float2D:
        """As `MapState.cost`."""
        cost: Float2D = self.grid.map() / np.float32(self.grid.model.scale or 1.0)
        if self._unknown is not None:
            cost[self._unknown] = np.nan
        return cost

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> Bool:
        """As `MapState.unknown`."""
        unknown = np.zeros(self.shape, np.bool_) if self._unknown is None else self._unknown
        return unknown[rows, cols].copy()


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
    body_bytes = 0 if heights is None or vehicle is None else bytes_per_cell(vehicle)
    by_slope = heights is not None and ground.by_slope
    if ground.factor == 1 or body_bytes:  # else memory goes by what is seen
        check_planner_fits(ground.shape, DIRECTED_BYTES_PER_CELL * by_slope + body_bytes)
    if warn and heights is not None and ground.factor == 1:
        from nnpp_edge.runtime.terrain.traversability import relative_heights, warn_of_saturation

        relative, _ = relative_heights(heights)
        level = 1 + users_line()
        warn_of_saturation(relative, ground.limits, ground.sides_m, stacklevel=level)
    # each kind of map is loaded where there is one
    if vehicle is not None and vehicle.is_disc:
        from nnpp_edge.runtime.map.disc import DiscState

        point = replace(
            ground, vehicle=None, step_cost=StepCost.PAPER if by_slope else ground.step_cost
        )
        of_point = map_state(point, omega, corner_cutting, lazy=False, tell_unknown=True)
        return DiscState(ground, of_point)
    if heights is None:
        model = StepModel.of(ground.step_cost, omega)
        return CostState(ground, model, corner_cutting, tell_unknown)
    model = StepModel.of(StepCost.PAPER, omega)
    if ground.factor == 1:
        from nnpp_edge.runtime.map.heights import HeightState

        return HeightState(ground, model, corner_cutting, lazy)
    from nnpp_edge.runtime.map.coarse import CoarseState

    return CoarseState(ground, model, corner_cutting)
