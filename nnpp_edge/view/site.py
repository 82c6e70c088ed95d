"""The map that all tabs look at, and the vehicles that can be put on it."""

from dataclasses import dataclass
from pathlib import Path

from nnpp_edge.runtime.map.slope_cost import Mobility
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.coordinates import gravity_of
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle, shipped_vehicles

POINT = "none"
"""Name of the vehicle that is none: a point."""
GIVEN = "as given"
"""Name of the vehicle that the command line describes."""


@dataclass(frozen=True)
class Reading:
    """How the elevation map is read: the arguments of `read_dem`, and the cells that it is rescaled to."""

    path: Path
    cell_size: float | None = None
    vertical_scale: float | None = None
    rescale: float | None = None
    allow_vrt: bool = False

    @property
    def options(self) -> list[str]:
        """As words of `nnpp-edge plan`."""
        named = (
            ("--cell-size", self.cell_size),
            ("--vertical-scale", self.vertical_scale),
            ("--rescale", self.rescale),
        )
        words = [word for name, value in named if value is not None for word in (name, f"{value:.10g}")]
        return [str(self.path.resolve()), *words, *(["--allow-vrt"] if self.allow_vrt else [])]

    @property
    def code(self) -> str:
        """In Python."""
        named = ("cell_size_m", self.cell_size), ("vertical_scale", self.vertical_scale)
        given = [f"{name}={value:.10g}" for name, value in named if value is not None]
        given += ["allow_vrt=True"] if self.allow_vrt else []
        read = f"read_dem({', '.join([repr(str(self.path.resolve())), *given])})"
        return read if self.rescale is None else f"{read}.rescaled({self.rescale:.10g})"


@dataclass(frozen=True)
class Body:
    """A vehicle to choose, None for a point, and how it is asked for elsewhere."""

    vehicle: Vehicle | None
    mobility: Mobility
    options: tuple[str, ...] = ()
    """Words of `nnpp-edge plan`."""
    vehicle_code: str = "None"
    mobility_code: str = "None"

    @classmethod
    def shipped(cls, name: str, gravity_m_s2: float | None = None) -> "Body":
        """One that travels with the package, under the gravity of the map's body where that is known."""
        own = "" if gravity_m_s2 is None else f", gravity_m_s2={gravity_m_s2:g}"
        codes = f"load_vehicle({name!r})", f"load_mobility({name!r}{own})"
        return cls(load_vehicle(name), load_mobility(name, gravity_m_s2), ("--vehicle", name), *codes)

    @classmethod
    def given(cls, vehicle: Vehicle | None, mobility: Mobility, options: tuple[str, ...]) -> "Body":
        """One that the command line describes, by these options."""
        return cls(vehicle, mobility, options, repr(vehicle), repr(mobility))

    @property
    def has_body(self) -> bool:
        """Whether poses are checked: it is neither a point nor a disc."""
        return self.vehicle is not None and not self.vehicle.is_disc


@dataclass(frozen=True, eq=False)
class Site:
    """An elevation map, how it was read, and the vehicles to choose from, by name."""

    dem: Dem
    reading: Reading
    bodies: dict[str, Body]

    @classmethod
    def of(cls, dem: Dem, reading: Reading, given: Body | None = None) -> "Site":
        """With the vehicles of the package, and that of the command line.

        A body without a vehicle, which has a mobility alone, takes the place of the point.
        """
        gravity = gravity_of(dem)
        bodies = {name: Body.shipped(name, gravity) for name in shipped_vehicles()}
        bodies = {POINT: Body(None, Mobility()), **bodies}
        if given is not None:
            bodies[POINT if given.vehicle is None else GIVEN] = given
        return cls(dem, reading, bodies)

    @property
    def sides_m(self) -> tuple[float, float]:
        """Height and width of a cell."""
        return self.dem.cell_size_m, self.dem.cell_width_m
