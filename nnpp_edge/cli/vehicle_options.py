"""The options by which commands are given a vehicle."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli.options import Setting, SettingType, gathered, together

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.slope_cost import Mobility
    from nnpp_edge.runtime.terrain.vehicle import Vehicle
    from nnpp_edge.terrain.georeference import Place

_MOST_UNEQUAL_GRAVITY = 0.01
"""Share by which the map's gravity may differ from the file's before a warning says so."""


@dataclass(frozen=True)
class VehicleOptions:
    """A vehicle's name or file, and values in place of those in its file."""

    vehicle: str | None
    settings: tuple[Setting, ...]
    mobility_file: str | None

    def make(self) -> Vehicle | None:
        """The vehicle; None if nothing was given. VehicleError for values that make none."""
        values = {name: value for name, value in self._values().items() if name != "mobility"}
        if self.vehicle is None and not values:
            return None
        from nnpp_edge.terrain.vehicle_files import vehicle_of

        return vehicle_of(values, self.vehicle or "vehicle")

    def check_turns(self, refine: str | None) -> None:
        """Refuse a turning radius that was set for paths that stay on the grid."""
        if not refine and any("turning_radius_m" in setting.values for setting in self.settings):
            raise click.UsageError("turning_radius_m needs --refine any-angle: paths on the grid turn in a cell")

    def mobility(self, place: Place | None = None) -> Mobility:
        """How the vehicle gets up and down; a hiker's way where nothing is said.

        Energy goes by the gravity that was set, else by that of the map's body, else by the file's: a warning says
        where the map's differs from the file's.
        """
        from nnpp_edge.runtime.map.slope_cost import Mobility
        from nnpp_edge.terrain.coordinates import gravity_of
        from nnpp_edge.terrain.vehicle_files import mobility_of

        values, source = self._values(), Path(self.mobility_file or self.vehicle or "--set").name
        found = mobility_of(values["mobility"], source) if "mobility" in values else Mobility()
        if found.energy is None or place is None or any("gravity_m_s2" in each.word for each in self.settings):
            return found
        gravity, own = gravity_of(place), found.energy.gravity_m_s2
        if gravity is None:
            return found
        if abs(gravity / own - 1.0) > _MOST_UNEQUAL_GRAVITY:
            warnings.warn(
                f"energy goes by {gravity:g} m/s², the gravity of the map's body, not by the vehicle's own {own:g}; "
                "--set mobility.energy.gravity_m_s2=… gives another",
                stacklevel=2,
            )
        return found.under(gravity)

    def _values(self) -> dict[str, object]:
        """The file's values, with what was set in their place."""
        from nnpp_edge.terrain.vehicle_files import VehicleError, read_vehicle

        values = read_vehicle(self.vehicle) if self.vehicle else {}
        if self.mobility_file:
            other = read_vehicle(self.mobility_file)
            if "mobility" not in other:
                raise VehicleError(f"{Path(self.mobility_file).name}: wanted a table [mobility], got none")
            values["mobility"] = other["mobility"]
        for setting in self.settings:
            _merge(values, setting.values)
        return values


def _merge(into: dict[str, object], values: dict[str, object]) -> None:
    """Put values in place of others, table by table."""
    for key, value in values.items():
        inner = into.get(key)
        if isinstance(inner, dict) and isinstance(value, dict):
            _merge(inner, value)
        else:
            into[key] = value


def _keys() -> list[str]:
    from nnpp_edge.runtime.terrain.vehicle import Vehicle

    return [*(field.name for field in fields(Vehicle)), "mobility"]


vehicle = together(
    click.option("--vehicle", metavar="NAME|FILE", help="small-rover, large-rover, tracked, or a TOML file."),
    click.option(
        "--set",
        "settings",
        type=SettingType(_keys, "clearance_m=0.3"),
        multiple=True,
        help="Set a value of the vehicle's file, such as clearance_m=0.3 or mobility.energy.gravity_m_s2=1.62. "
        "radius_m=0.5 alone is a disc. May be repeated.",
    ),
    click.option(
        "--mobility", "mobility_file", metavar="NAME|FILE", help="Take the table [mobility] from another file."
    ),
    gathered("vehicle", VehicleOptions),
)
"""Which vehicle drives, and its values; the command is given them as `vehicle`."""
