"""The options that make a ground: how its map is read, its limits, who drives there and at what
cost.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import click

from nnpp_edge.cli.options import (
    MANY,
    CellSize,
    Parsed,
    Rescale,
    Setting,
    SettingType,
    StepCost,
)
from nnpp_edge.runtime.options import LAYER_TERMS, PRIORS, TERMS

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.ground import Ground
    from nnpp_edge.runtime.robots.slope.cost import Mobility
    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.runtime.terrain.vehicle import Vehicle
    from nnpp_edge.terrain.dem import Dem
    from nnpp_edge.terrain.georeference import Place

_CELLS_A_BODY = 4.0
_LEAST_CELLS_A_BODY = 0.5
_ENOUGH_CELLS_A_BODY = 6.0
"""Cells along a body below which a warning says so, below which it says that the map does not do,
and those along it on the finer map that it names.
"""
_ROUNDED_UP = 1.05
"""By how much a number may be larger than its first two digits."""
_MUCH_WIDER = 1.1
"""Times as wide as the vehicle's radius that a map's arcs may be before a warning says so."""


def _named(kind: str) -> str:
    return ", ".join(getattr(term, kind) for term in (*TERMS, *LAYER_TERMS))


Limit = Annotated[
    tuple[Setting, ...],
    SettingType("nnpp_edge.runtime.terrain.traversability:Traversability", "hard_slope_deg=20"),
    MANY,
    f"Set a limit of the cost ({_named('limit')}), such as slope_limit_deg=20, or a weight "
    f"({_named('weight')}; their sum is 1). Cells beyond {_named('hard')} or, from cell to cell, "
    "hard_gradient_deg are impassable. May be repeated.",
]


@dataclass(frozen=True, kw_only=True)
class TerrainOptions:
    """How an elevation map is read, and by which limits it becomes a cost map."""

    cell_size: CellSize = None
    rescale: Rescale = None
    limit: Limit = ()
    workload: Annotated[
        str | None,
        "safe, the default without a body (cells and steps steeper than slope_limit_deg are "
        "impassable), soft (the paper's cost), or limitN (cells steeper than N degrees are).",
    ] = None

    def read(self, path: Path) -> "Dem":
        """The elevation map in a file."""
        from nnpp_edge.terrain.dem import read_dem

        return read_dem(path, self.cell_size)

    def limits(self, place: "Place | None" = None) -> "Traversability":
        """The limits of a map's costs; UsageError where the workload sets one that was given too.

        On ground that is judged as if it had other cells, lengths count as on these. The map
        itself stays the file's, so its coordinates, lengths, times and energies do.
        """
        from nnpp_edge.runtime.terrain.traversability import Traversability
        from nnpp_edge.terrain.workloads import SAFE, SOFT
        from nnpp_edge.terrain.workloads import workload as limits_of

        values = {name: value for each in self.limit for name, value in each.values.items()}
        limits = Traversability(**values)  # type: ignore[arg-type]  # it checks them
        name = self.workload or self._default_workload
        twice = [name for name in values if name in ("slope_limit_deg", "hard_slope_deg")]
        if twice and name not in (SAFE, SOFT):
            raise click.UsageError(
                f"--workload {name} sets the slope limits: leave out --limit {twice[0]}"
            )
        found = limits_of(name, limits)
        if self.rescale is None or place is None:
            return found
        return found.scaled(place.cell_size_m / self.rescale)

    @property
    def _default_workload(self) -> str:
        return "safe"


@dataclass(frozen=True, kw_only=True)
class VehicleOptions:
    """A vehicle's name or file with values in place of its own, and what a step costs it."""

    vehicle: Annotated[
        str | None, {"metavar": "NAME|FILE"}, "small-rover, large-rover, tracked, or a TOML file."
    ] = None
    settings: Annotated[
        tuple[Setting, ...],
        "--set",
        SettingType("nnpp_edge.runtime.terrain.vehicle:Vehicle", "clearance_m=0.3", "mobility"),
        MANY,
        "Set a value of the vehicle's file, such as clearance_m=0.3 or "
        "mobility.energy.gravity_m_s2=1.62. "
        "radius_m=0.5 alone is a disc. May be repeated.",
    ] = ()
    mobility_file: Annotated[
        str | None,
        "--mobility",
        {"metavar": "NAME|FILE"},
        "Take the table [mobility] from another file.",
    ] = None
    step_cost: StepCost = "paper"

    def body(self) -> "Vehicle | None":
        """The vehicle; None if nothing was given. VehicleError for values that make none."""
        values = {name: value for name, value in self._values().items() if name != "mobility"}
        if self.vehicle is None and not values:
            return None
        from nnpp_edge.terrain.vehicle_files import vehicle_of

        return vehicle_of(values, self.vehicle or "vehicle")

    @property
    def posed(self) -> "Vehicle | None":
        """The vehicle, if its poses are checked: neither a point nor a disc."""
        vehicle = self.body()
        return vehicle and vehicle.as_body

    def mobility(self, place: "Place | None" = None) -> "Mobility":
        """How the vehicle gets up and down.

        Energy goes by the gravity that was set, else by that of the map's body, else by the file's.
        """
        from nnpp_edge.runtime.robots.slope.cost import Mobility
        from nnpp_edge.terrain.coordinates import gravity_of
        from nnpp_edge.terrain.vehicle_files import mobility_of

        values = self._values()
        source = Path(self.mobility_file or self.vehicle or "--set").name
        found = mobility_of(values["mobility"], source) if "mobility" in values else Mobility()
        gravity = None if place is None else gravity_of(place)
        if found.energy and any("gravity_m_s2" in each.word for each in self.settings):
            gravity = found.energy.gravity_m_s2
        return found if gravity is None else found.under(gravity)

    def _values(self) -> dict[str, object]:
        """The file's values, with what was set in their place."""
        from nnpp_edge.terrain.vehicle_files import read_mobility, read_vehicle

        values = read_vehicle(self.vehicle) if self.vehicle else {}
        if self.mobility_file:
            values["mobility"] = read_mobility(self.mobility_file)
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


class Blocks(NamedTuple):
    """Of what a coarse map has the means, and how ground that was not seen is priced."""

    factor: int
    prior: str = PRIORS[0]

    @classmethod
    def parsed(cls, word: str) -> "Blocks":
        """From ``N`` or ``N:PRIOR``."""
        factor, colon, prior = word.partition(":")
        if not 2 <= int(factor) <= 64 or (colon and prior not in PRIORS):
            raise ValueError
        return cls(int(factor), prior or PRIORS[0])


Known = Annotated[
    Blocks | None,
    Parsed("N[:PRIOR]", f"N from 2 to 64, or N:PRIOR with {', '.join(PRIORS)}", Blocks.parsed),
    "The map has means of N × N cells only; unseen ground costs what PRIOR estimates: a network "
    "(the default), or the coarse slope.",
]


@dataclass(frozen=True, kw_only=True)
class GroundOptions(VehicleOptions, TerrainOptions):
    """A map, and who drives on it at what cost."""

    def limits(self, place: "Place | None" = None) -> "Traversability":
        """As `TerrainOptions.limits`; UsageError for a body that is to stand on other cells."""
        if self.rescale is not None and self.posed is not None:
            raise click.UsageError(
                "--rescale changes how cells are priced, and a body is checked on the ground "
                "itself: leave it out (evaluate and simulate shrink the ground)"
            )
        return super().limits(place)

    @property
    def _default_workload(self) -> str:
        """A body's own limits decide where it may go."""
        return "safe" if self.posed is None else "soft"

    def of(self, dem: "Dem", blocks: Blocks | None = None) -> "Ground":
        """The ground of an elevation map, or of one whose cells are means of blocks of finer ones;
        a warning says where cells are too coarse for the vehicle.
        """
        from nnpp_edge.runtime.map.ground import Ground

        factor, prior = blocks or Blocks(1)
        if factor == 1:
            self.warn_if_coarse(dem)
        return Ground.of_coarse(
            dem.elevation,
            dem.cell_size_m,
            factor,
            self.limits(dem),
            prior=prior,
            cell_width_m=dem.cell_width_m,
            vehicle=self.body(),
            step_cost=self.step_cost,
            mobility=self.mobility(dem),
        )

    def warn_if_coarse(self, dem: "Dem") -> None:
        """Warn of cells on which the vehicle cannot turn as sharply as it may, and of those beside
        which it is so short that little is known of the ground below it.
        """
        body = self.posed
        if body is None:
            return
        if body.turning_radius_m:
            _warn_if_wide(body.turning_radius_m, dem)
        side = max(dem.cell_size_m, dem.cell_width_m)
        if body.length_m >= _CELLS_A_BODY * side:
            return
        finer = _resampled(body.length_m / _ENOUGH_CELLS_A_BODY)
        advice = f"{finer} let it be checked between them, but add no detail"
        if body.length_m < _LEAST_CELLS_A_BODY * side:
            advice = "too coarse to check it, take a finer map"
        size = f"{body.length_m:g} × {body.width_m:g} m"
        warnings.warn(
            f"cells of {side:.4g} m are coarse for a body of {size} with a step limit of "
            f"{body.step_m:g} m: a rock narrower than a cell is not seen, and a kerb is taken "
            f"for a ramp as long as a cell; {advice}",
            stacklevel=2,
        )


def _warn_if_wide(radius_m: float, dem: "Dem") -> None:
    """Warn where the arcs that join a map's cells are wider than this radius."""
    from nnpp_edge.runtime.robots.body.primitives import sharpest_m

    sharpest = sharpest_m(radius_m, (dem.cell_size_m, dem.cell_width_m))
    if sharpest > _MUCH_WIDER * radius_m:
        finer = _resampled(_ROUNDED_UP * dem.cell_size_m * radius_m / sharpest)
        warnings.warn(
            f"arcs that join cells of {dem.cell_size_m:.4g} m have a radius of at least "
            f"{sharpest:.3g} m, not {radius_m:g} m: {finer} come close",
            stacklevel=2,
        )


def _resampled(cell_size_m: float) -> str:
    """Finer cells, and how to make them."""
    return f"cells of {cell_size_m:.2g} m (gdalwarp -r bilinear -tr)"
