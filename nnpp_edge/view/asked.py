"""A complete question: ends, method, limits, step cost, vehicle, obstacles; and the map that it is
asked of.
"""

import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.options import CornerCutting, Heading, Omega, PlanOptions
from nnpp_edge.runtime.planners.plan import Method
from nnpp_edge.runtime.robots.slope.cost import Mobility
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.coordinates import gravity_of
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle, shipped_vehicles

POINT = "none"
GIVEN = "as given"
"""Names of the vehicle that is none, and of the one that the command line describes."""
Obstacles = Annotated[tuple[Rectangle, ...], Meta(max_length=200)]
Positive = Annotated[float, Meta(ge=0.0)]


@dataclass(frozen=True)
class Body:
    """A vehicle to choose, None for a point, and the words of `nnpp-edge plan` that describe it."""

    vehicle: Vehicle | None
    mobility: Mobility
    options: tuple[str, ...] = ()

    @property
    def posed(self) -> Vehicle | None:
        """The vehicle, if its poses are checked: neither a point nor a disc."""
        return self.vehicle and self.vehicle.as_body

    @property
    def has_arcs(self) -> bool:
        """Whether it drives arcs."""
        return self.posed is not None and self.posed.turning_radius_m is not None


@dataclass(frozen=True, eq=False)
class Site:
    """An elevation map, how it was read, and the vehicles to choose from, by name."""

    dem: Dem
    path: Path
    reading: Mapping[str, float]
    """Options of `nnpp-edge plan` that were given: ``cell_size``."""
    bodies: Mapping[str, Body]
    model: str = "edge"
    """The network of the method ``nnpp``."""

    @classmethod
    def of(
        cls,
        dem: Dem,
        path: Path,
        reading: Mapping[str, float],
        given: Body | None = None,
        model: str = "edge",
    ) -> "Site":
        """With the package's vehicles, under the map's gravity where that is known, and that of the
        command line.

        A body without a vehicle, which has a mobility alone, takes the place of the point.
        """
        gravity = gravity_of(dem)
        bodies = {POINT: Body(None, Mobility() if gravity is None else Mobility().under(gravity))}
        for name in shipped_vehicles():
            bodies[name] = Body(
                load_vehicle(name), load_mobility(name, gravity), ("--vehicle", name)
            )
        if given is not None:
            bodies[POINT if given.vehicle is None else GIVEN] = given
        return cls(replace(dem, source=Path(path.name)), path, reading, bodies, model)


class Asked(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One question. Cells are (row, col)."""

    start: Cell
    goal: Cell
    via: Annotated[tuple[Cell, ...], Meta(max_length=50)] = ()
    """Places between, in the order in which they are visited."""
    method: Method = Method.AUTO
    refine: bool = False
    """Whether the path is freed from the grid."""
    step_cost: str = "paper"
    """One of `STEP_COSTS`."""
    omega: Omega = PAPER_OMEGA
    corner_cutting: CornerCutting = True
    limits: Traversability = Traversability.safe()
    """Hard limits of slope bound a body's tilt too, unless they are the default."""
    body: str = POINT
    clearance_m: Positive | None = None
    """In place of the vehicle's own, as is `max_tilt_deg`; of no effect on a point or a disc."""
    max_tilt_deg: Positive | None = None
    obstacles: Obstacles = ()
    start_heading_deg: Heading | None = None
    """Clockwise from up the rows, of a body that drives arcs; None for any, as is
    `goal_heading_deg`.
    """
    goal_heading_deg: Heading | None = None

    @property
    def of_the_map(self) -> "Asked":
        """What decides the map and its planner: without places, method and obstacles."""
        kept = ("step_cost", "omega", "corner_cutting", "limits", "body", "clearance_m")
        values = {name: getattr(self, name) for name in (*kept, "max_tilt_deg")}
        return Asked(start=(0, 0), goal=(0, 0), **values)

    @property
    def freed(self) -> str | None:
        """How the path is refined; steps that cost by their slope leave it on the grid."""
        return "any-angle" if self.refine and self.step_cost == "paper" else None

    def chosen(self, site: Site) -> Body:
        """The body; InvalidQueryError if there is none of that name."""
        if self.body not in site.bodies:
            raise InvalidQueryError(
                f"vehicle must be one of {', '.join(site.bodies)}, got {self.body!r}"
            )
        return site.bodies[self.body]

    def changes(self, site: Site) -> dict[str, float]:
        """Values that were set in place of the vehicle's own."""
        if self.chosen(site).posed is None:
            return {}
        named = {"clearance_m": self.clearance_m, "max_tilt_deg": self.max_tilt_deg}
        return {name: value for name, value in named.items() if value is not None}

    def headings(self, site: Site) -> PlanOptions:
        """Of the ends, where the body drives arcs."""
        given: PlanOptions = {}
        if self.chosen(site).has_arcs:
            if self.start_heading_deg is not None:
                given["start_heading_deg"] = self.start_heading_deg
            if self.goal_heading_deg is not None:
                given["goal_heading_deg"] = self.goal_heading_deg
        return given

    def ground(self, site: Site) -> Ground:
        """Choices that decide the map, but for obstacles; NnppEdgeError for what makes none."""
        body = self.chosen(site)
        vehicle = body.vehicle
        if vehicle is not None:
            vehicle = replace(vehicle, **self.changes(site))  # type: ignore[arg-type]
        dem = site.dem
        unset = self.limits.of_terms("hard") == Traversability.safe().of_terms("hard")
        return Ground.of_elevation(
            dem.elevation,
            dem.cell_size_m,
            self.limits.soft() if body.posed and unset else self.limits,
            cell_width_m=dem.cell_width_m,
            vehicle=vehicle,
            step_cost=self.step_cost,
            mobility=body.mobility,
        )


def command_of(site: Site, asked: Asked) -> str:
    """A line for a shell that plans the same path; without painted obstacles, which no option
    describes.
    """
    words = ["nnpp-edge", "plan", str(site.path)]
    for name, value in site.reading.items():
        words += [f"--{name.replace('_', '-')}", _number(value)]
    via = [("--via", at) for at in asked.via]
    for name, cell in (("--start", asked.start), *via, ("--goal", asked.goal)):
        place = "{},{}".format(*cell)
        words += [f"{name}={place}"] if min(cell) < 0 else [name, place]
    words += ["--method", asked.method]
    for name, value in _given(asked.limits).items():
        words += ["--limit", f"{name}={_number(value)}"]
    if asked.step_cost != "paper":
        words += ["--step-cost", asked.step_cost]
    elif asked.omega != PAPER_OMEGA:
        words += ["--omega", _number(asked.omega)]
    if not asked.corner_cutting:
        words.append("--no-corner-cutting")
    if site.model != "edge":
        words += ["--model", site.model]
    words += asked.chosen(site).options
    for name, heading in asked.headings(site).items():
        option = f"--{name.removesuffix('_deg').replace('_', '-')}"
        words += [option, _number(heading)]  # type: ignore[arg-type]  # a number
    for name, value in asked.changes(site).items():
        words += ["--set", f"{name}={_number(value)}"]
    return shlex.join([*words, *(["--refine", asked.freed] if asked.freed else [])])


def _given(limits: Traversability) -> dict[str, float]:
    """The values of `Traversability.safe` that make these limits."""
    given = limits.soft().changed
    for name, value in asdict(limits).items():
        if name.startswith("hard_") and value != getattr(Traversability.safe(**given), name):
            given[name] = value
    return given


def _number(value: float) -> str:
    """As a user writes it, and without loss."""
    return repr(int(value)) if float(value).is_integer() else repr(value)
