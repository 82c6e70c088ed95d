"""A tab's question: ends, method, limits, step cost, vehicle, and the obstacles that were painted."""

import math
from dataclasses import replace
from typing import Literal

import msgspec

from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.view.site import POINT, Body, Site

METHODS = ("auto", "astar", "corridor", "nnpp")
SHORTEST = "length"
"""Of step costs, the paper's where the ground costs nothing: the shortest way that the hard limits leave."""


class Asked(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One question, complete. Lengths in metres, angles in degrees, cells (row, col); None is no limit."""

    start: Cell
    goal: Cell
    method: Literal["auto", "astar", "corridor", "nnpp"] = "auto"
    refine: bool = False
    """Whether the path is freed from the grid."""
    step_cost: Literal["paper", "length", "tobler", "irmischer", "linear", "time", "energy"] = "paper"
    omega: float = PAPER_OMEGA
    corner_cutting: bool = True
    slope_limit: float = 30.0
    roughness_limit: float = 0.6
    step_limit: float = 0.2
    hard_slope: float | None = None
    hard_roughness: float | None = None
    hard_step: float | None = None
    body: str = POINT
    clearance: float | None = None
    """In place of the vehicle's own, as is `max_tilt`; of no effect on a point or a disc."""
    max_tilt: float | None = None
    obstacles: tuple[Rectangle, ...] = ()

    @property
    def limits(self) -> Traversability:
        """Of the cost map; InvalidMapError for what is no limit."""

        def or_inf(limit: float | None) -> float:
            return math.inf if limit is None else limit

        return Traversability(
            self.slope_limit,
            self.roughness_limit,
            self.step_limit,
            hard_slope_deg=or_inf(self.hard_slope),
            hard_roughness_m=or_inf(self.hard_roughness),
            hard_step_m=or_inf(self.hard_step),
        )

    @property
    def weight(self) -> float:
        """ω of the paper's step costs."""
        return 0.0 if self.step_cost == SHORTEST else self.omega

    @property
    def slope_cost(self) -> str:
        """The step cost by the planner's name for it."""
        return "paper" if self.step_cost == SHORTEST else self.step_cost

    @property
    def freed(self) -> str | None:
        """How the path is refined; steps that cost by their slope leave it on the grid."""
        return "any-angle" if self.refine and self.slope_cost == "paper" else None

    def chosen(self, site: Site) -> Body:
        """The body to choose from those there are; InvalidQueryError if there is none of that name."""
        if self.body not in site.bodies:
            raise InvalidQueryError(f"vehicle must be one of {', '.join(site.bodies)}, got {self.body!r}")
        return site.bodies[self.body]

    def vehicle(self, site: Site) -> Vehicle | None:
        """The vehicle with the values that were set in place of its own; InvalidMapError for what is none."""
        vehicle = self.chosen(site).vehicle
        if vehicle is None or vehicle.is_disc:
            return vehicle
        clearance = vehicle.clearance_m if self.clearance is None else self.clearance
        tilt = vehicle.max_tilt_deg if self.max_tilt is None else self.max_tilt
        return replace(vehicle, clearance_m=clearance, max_tilt_deg=tilt)

    def changes(self, site: Site) -> dict[str, float]:
        """Values of the vehicle that were set, by their names."""
        named = {"clearance_m": self.clearance, "max_tilt_deg": self.max_tilt}
        body = self.chosen(site)
        return {name: value for name, value in named.items() if value is not None} if body.has_body else {}

    def ground(self, site: Site) -> Ground:
        """Choices that decide the map, but for obstacles."""
        dem = site.dem
        return Ground.of_elevation(
            dem.elevation,
            dem.cell_size_m,
            self.limits,
            cell_width_m=dem.cell_width_m,
            vehicle=self.vehicle(site),
            step_cost=self.slope_cost,
            mobility=self.chosen(site).mobility,
        )

    def same_map(self, other: "Asked") -> bool:
        """Whether both are asked of one planner, but for obstacles."""
        of_the_query = {"start": self.start, "goal": self.goal, "method": self.method, "refine": self.refine}
        return msgspec.structs.replace(other, **of_the_query, obstacles=self.obstacles) == self


def changed(asked: Asked, values: dict[str, object]) -> Asked:
    """The question with other values by their names; InvalidQueryError for what is no such value."""
    try:
        new = msgspec.convert({**msgspec.structs.asdict(asked), **values}, Asked)
    except msgspec.ValidationError as error:
        raise InvalidQueryError(f"a setting cannot be used: {error}") from None
    numbers = (new.omega, new.clearance, new.max_tilt)
    if any(number is not None and not 0.0 <= number < math.inf for number in numbers):
        raise InvalidQueryError(f"wanted numbers of at least 0, got {values}")
    return new
