"""One ground that one robot plans on: heights or costs, the sides of a cell, limits, vehicle, and
what steps cost.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D, as_map, in_blocks, numbers
from nnpp_edge.runtime.cells import Sides
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.runtime.options import LAYER_TERMS, STEP_COSTS, TERMS, GroundOptions
from nnpp_edge.runtime.terrain.step_cost import StepCost, StepModel

if TYPE_CHECKING:
    from nnpp_edge.runtime.robots.slope.cost import Mobility, SlopeCost
    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.runtime.terrain.vehicle import Vehicle


@checked(InvalidMapError)
@dataclass(frozen=True, eq=False)
class Ground:
    """A map, and the robot that plans on it. The arrays are those given; planners and loops copy
    them.

    Raises
    ------
    InvalidMapError
        Not exactly one of `cost` and `elevation` is given, it is not two-dimensional or is empty;
        heights without a cell size; a body without heights.
    InvalidQueryError
        There is no such step cost, or its model needs a mobility.
    """

    cost: Float2D | None = None
    """(H, W) float, as `Planner` takes it."""
    elevation: Float2D | None = None
    """(H, W) float, metres; NaN where unknown."""
    cell_size_m: float | None = None
    """Side of a cell from row to row, metres. Needed with heights, and with a vehicle."""
    cell_width_m: float | None = None
    """Side of a cell from column to column, where cells are not square."""
    traversability: "Traversability | None" = None
    """How heights become costs, and where they are too steep; None for `Traversability.safe` and,
    with a body, for no limits but the body's own."""
    vehicle: "Vehicle | None" = None
    """A body, on heights: its poses, checked as searched, decide where the path may go and what
    it costs. A disc (`radius_m`): it may not touch impassable cells, nor leave the map. None for
    a point."""
    step_cost: str = StepCost.PAPER
    """``paper``: a step costs L + 255·omega·(T_i + T_j) (NNPP, Eq. 2-4). ``length``, of costs
    alone: L × the mean weight. With heights also by the slope that the step leads up or down:
    ``time``, ``energy``, ``tobler`` or ``linear``, see `robots.slope.cost`; limits or poses decide
    all the same where paths may go."""
    mobility: "Mobility | None" = None
    """Parameters of the step costs by the slope; ``time`` and ``energy`` have none by default."""
    factor: int = 1
    """Cells to the side of a block of which `elevation` (H, W) has the means: the map has H ·
    factor rows. Nothing of a cell's own elevation is known until a patch tells it."""
    prior: str = "network"
    """By what a cell is priced until then, see `network.priors`: ``network``, shown the coarse
    map; ``slope``, the coarse map's, calibrated on maps that are known finely."""
    prior_model: str | Path = "unseen"
    """That network: a shipped model's name, or a file."""
    layers: dict[str, Float2D] = field(default_factory=dict)
    """(H, W) float, numbers beside heights for the terms of `options.LAYER_TERMS`, by name."""

    def __post_init__(self) -> None:
        """Check what goes together; what only the map's values tell is checked by `state`."""
        if (self.cost is None) == (self.elevation is None):
            raise InvalidMapError("wanted either cost or elevation, got both or neither")
        _ = self.shape
        if self.elevation is not None:
            if self.cell_size_m is None:
                raise InvalidMapError("wanted cell_size_m, the side of a cell, with elevations")
            counted = [t.words for t in LAYER_TERMS if getattr(self.limits, t.weight) > 0.0]
            if not self.layers.keys() >= {*counted}:
                raise InvalidMapError(f"wanted layers of {counted}, got {[*self.layers]}")
            slope_cost = self.slope_cost  # refused now
            body = self.body
            if body is not None and self.traversability is not None:
                object.__setattr__(self, "vehicle", _within(body, self.traversability))
            if slope_cost is not None and body is not None and body.turning_radius_m:
                raise InvalidMapError(
                    f"arcs have the paper's cost: wanted step_cost='paper', got {self.step_cost!r}"
                )
            on_cells = self.vehicle is not None and body is None
            if self.factor > 1 and (slope_cost is not None or on_cells or self.layers):
                raise InvalidMapError(
                    "a coarse map is for points and bodies: wanted step_cost='paper', no layers "
                    "and no radius_m"
                )
            return
        if self.factor > 1:
            raise InvalidMapError("a coarse map has elevations: got costs")
        if self.step_cost != StepCost.PAPER and self.step_cost in STEP_COSTS:
            raise InvalidQueryError(
                f"step_cost={self.step_cost!r} needs heights: wanted a planner of elevations"
            )
        StepModel.of(self.step_cost)
        if self.vehicle is None:
            return
        kind = self.vehicle.kind
        if kind.by_heights:
            raise InvalidMapError(
                f"a {kind.name} needs elevations: wanted Planner.of_elevation, or a vehicle with "
                "radius_m"
            )
        if self.cell_size_m is None:
            raise InvalidMapError("wanted cell_size_m, the side of a cell, with a vehicle")

    @classmethod
    def of_elevation(
        cls,
        elevation: Float2D,
        cell_size_m: float,
        traversability: "Traversability | None" = None,
        **more: Unpack[GroundOptions],
    ) -> "Ground":
        """Of heights; arguments as the attributes."""
        return cls(None, elevation, cell_size_m, traversability=traversability, **more)

    @classmethod
    def of_coarse(
        cls,
        dem: Float2D,
        cell_size_m: float,
        factor: int,
        traversability: "Traversability | None" = None,
        *,
        model: str | Path = "unseen",
        **more: Unpack[GroundOptions],
    ) -> "Ground":
        """Of a coarse map: `dem` (H, W) has the means of `factor` × `factor` cells, blocks of
        `cell_size_m` by `cell_width_m`; else as the attributes.
        """
        if factor < 1:
            raise InvalidQueryError(f"factor must be at least 1, got {factor}")
        if (width := more.get("cell_width_m")) is not None:
            more["cell_width_m"] = width / factor
        return cls(
            None,
            dem,
            cell_size_m / factor,
            traversability=traversability,
            factor=factor,
            prior_model=model,
            **more,
        )

    @cached_property
    def sides_m(self) -> Sides:
        """Height and width of a cell, metres; 1 where none is known. InvalidMapError if one is no
        positive number.
        """
        from nnpp_edge.runtime.terrain.traversability import sides_of

        return sides_of(1.0 if self.cell_size_m is None else self.cell_size_m, self.cell_width_m)

    @property
    def body(self) -> "Vehicle | None":
        """The vehicle, if its poses decide where paths may go; None for a point or a disc."""
        return self.vehicle and self.vehicle.as_body

    @cached_property
    def limits(self) -> "Traversability":
        """By what cells are priced, and which are impassable; with a body none is, as its own
        limits decide.
        """
        from nnpp_edge.runtime.terrain.traversability import Traversability

        if self.body is None:
            return self.traversability or Traversability.safe()
        return (self.traversability or Traversability()).soft()

    @property
    def slope_cost(self) -> "SlopeCost | None":
        """What steps cost by the slope up or down; None where they cost by their cells, as on a map
        of costs. InvalidQueryError as for `Ground`.
        """
        if self.elevation is None or self.step_cost == StepCost.PAPER:
            return None
        from nnpp_edge.runtime.robots.slope.cost import Mobility

        return (self.mobility or Mobility()).model(self.step_cost)

    @property
    def by_costs(self) -> bool:
        """Whether cells' costs say all that paths go by, and heights nothing more."""
        stands_by_them = self.vehicle is not None and self.vehicle.kind.by_heights
        return not stands_by_them and self.slope_cost is None

    def by_blocks(self, factor: int, prior: str = "network") -> "Ground":
        """Itself as it is known by the means of blocks of `factor` × `factor` of its heights."""
        assert self.elevation is not None
        blocks = in_blocks(self.elevation, factor)
        means = blocks.mean((1, 3), dtype=np.float64).astype(np.float32)
        return replace(self, elevation=means, factor=factor, prior=prior)

    def priced(self, cost: Float2D) -> "Ground":
        """Itself with the cost (H, W) of each cell in place of heights, where these say no more."""
        return replace(self, cost=cost, elevation=None) if self.by_costs else self

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        values, name = (self.elevation, "dem") if self.cost is None else (self.cost, "cost")
        rows, cols = numbers(values, name).shape  # type: ignore[arg-type]  # one of them is there
        return rows * self.factor, cols * self.factor

    def costs(self, *, warn: bool = False) -> Float2D:
        """(H, W) float32, what each cell costs a point: as given, or by Eq. 1."""
        if self.elevation is None:
            assert self.cost is not None
            return as_map(self.cost, "cost")
        from nnpp_edge.runtime.terrain.traversability import traversability_cost

        size, width = self.sides_m
        return traversability_cost(
            self.elevation, size, self.limits, cell_width_m=width, warn=warn, layers=self.layers
        )


def _within(body: "Vehicle", limits: "Traversability") -> "Vehicle":
    """The body under the stricter of its own limits and the hard limits of cells.

    InvalidMapError for hard limits that mean nothing to a body.
    """
    for term in TERMS[1:]:  # the slope's is one of a body's tilt
        if getattr(limits, term.hard) < math.inf:
            raise InvalidMapError(
                f"{term.hard} is a limit of cells: wanted the body's own max_step_m and clearance_m"
            )
    steepest = min(limits.hard_slope_deg, limits.hard_gradient_deg)
    if steepest >= body.max_tilt_deg:
        return body
    pitch, roll, _ = body.tilts_deg
    return replace(
        body,
        max_tilt_deg=steepest,
        max_pitch_deg=min(pitch, steepest),
        max_roll_deg=min(roll, steepest),
    )
