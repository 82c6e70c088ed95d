"""The options by which commands are given a vehicle."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli.options import ANGLE, POSITIVE, gathered, together

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.slope_cost import Mobility
    from nnpp_edge.runtime.terrain.vehicle import Vehicle
    from nnpp_edge.terrain.georeference import Place


@dataclass(frozen=True)
class VehicleOptions:
    """A vehicle's name or file, and what the user has set of its values; None for what was not given."""

    vehicle: str | None
    mobility_of: str | None
    gravity: float | None
    length_m: float | None
    width_m: float | None
    clearance_m: float | None
    max_tilt_deg: float | None
    max_pitch_deg: float | None
    max_roll_deg: float | None
    max_step_m: float | None
    axles: int | None
    wheelbase_m: float | None
    track_m: float | None
    wheel_length_m: float | None
    wheel_width_m: float | None
    unknown_passes: bool | None
    turning_radius_m: float | None
    radius_m: float | None

    def make(self) -> Vehicle | None:
        """The vehicle with the values that were given in place of its own; None if nothing was given.

        Without --vehicle the values make one by themselves. VehicleError for what makes none.
        """
        given: dict[str, object] = {name: value for name, value in asdict(self).items() if value is not None}
        name, *_ = (given.pop(name, None) for name in ("vehicle", "mobility_of", "gravity"))
        if name is None and not given:
            return None
        from nnpp_edge.terrain.vehicle_files import read_vehicle, vehicle_of

        values = {} if name is None else read_vehicle(str(name))
        return vehicle_of(values | given, "vehicle" if name is None else str(name))

    def check_turns(self, refine: str | None) -> None:
        """Refuse --turning-radius for paths that stay on the grid."""
        if self.turning_radius_m is not None and not refine:
            raise click.UsageError("--turning-radius needs --refine any-angle: paths on the grid turn in a cell")

    def mobility(self, place: Place | None = None) -> Mobility:
        """How the vehicle gets up and down, as its file says, or another; a hiker's where nothing is said.

        Energy goes by the gravity that was given, else by that of the map's body, else by the file's: a warning says
        where the map's is another than the file's.
        """
        from nnpp_edge.runtime.map.slope_cost import Mobility
        from nnpp_edge.terrain.coordinates import gravity_of
        from nnpp_edge.terrain.vehicle_files import load_mobility, mobility_of, read_vehicle

        if self.mobility_of is not None:
            found = load_mobility(self.mobility_of)
        else:
            values = read_vehicle(self.vehicle) if self.vehicle else {}
            found = mobility_of(values["mobility"], str(self.vehicle)) if "mobility" in values else Mobility()
        if found.energy is None:
            return found
        gravity, own = self.gravity, found.energy.gravity_m_s2
        if (
            gravity is None
            and place is not None
            and (gravity := gravity_of(place))
            and abs(gravity / own - 1.0) > 0.01
        ):
            warnings.warn(
                f"energy goes by {gravity:g} m/s², the gravity of the map's body, not by the vehicle's own {own:g}; "
                "--gravity gives another",
                stacklevel=2,
            )
        return found if gravity is None else found.under(gravity)


vehicle = together(
    click.option("--vehicle", metavar="NAME|FILE", help="small-rover, large-rover, tracked, or a TOML file."),
    click.option(
        "--mobility",
        "mobility_of",
        metavar="NAME|FILE",
        help="Take the table [mobility] from another vehicle, or from a file that holds nothing else.",
    ),
    click.option(
        "--gravity", type=POSITIVE, help="For its energy, m/s². By default the map's body's, else as its file says."
    ),
    click.option("--vehicle-length", "length_m", type=POSITIVE, help="Of the body along its heading, metres."),
    click.option("--vehicle-width", "width_m", type=POSITIVE, help="Of the body, metres."),
    click.option(
        "--clearance", "clearance_m", type=POSITIVE, help="Of the belly above the wheels' contacts, metres."
    ),
    click.option("--max-tilt", "max_tilt_deg", type=ANGLE, help="Steepest inclination in any direction, degrees."),
    click.option("--max-pitch", "max_pitch_deg", type=ANGLE, help="… along the heading; by default the tilt's."),
    click.option("--max-roll", "max_roll_deg", type=ANGLE, help="… across the heading; by default the tilt's."),
    click.option("--max-step", "max_step_m", type=POSITIVE, help="Highest step under a wheel, metres."),
    click.option("--axles", type=click.IntRange(2, 8), help="How many pairs of wheels there are."),
    click.option("--wheelbase", "wheelbase_m", type=POSITIVE, help="From the first axle to the last, metres."),
    click.option(
        "--track", "track_m", type=POSITIVE, help="From the left wheels' middles to the right ones', metres."
    ),
    click.option("--wheel-length", "wheel_length_m", type=POSITIVE, help="Of a contact patch, metres."),
    click.option("--wheel-width", "wheel_width_m", type=POSITIVE, help="Of a contact patch, metres."),
    click.option(
        "--unknown-passes/--unknown-fails",
        default=None,
        help="Whether the vehicle may stand on unknown cells. By default as the vehicle's file says, else not.",
    ),
    click.option(
        "--turning-radius",
        "turning_radius_m",
        type=POSITIVE,
        help="Of the sharpest turn of a line freed from the grid (--refine any-angle), metres.",
    ),
    click.option("--radius", "radius_m", type=POSITIVE, help="Of a disc, of which no more is known, metres."),
    gathered("vehicle", VehicleOptions),
)
"""Which vehicle drives, and its values; the command is given them as `vehicle`."""
