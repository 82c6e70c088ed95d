"""`nnpp-edge reach`: what can be reached from a place within a cost, a time or an energy."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options, vehicle_options
from nnpp_edge.cli.ends import End, Where
from nnpp_edge.cli.maps import cost_of, ground_of, priced, size_in_words, size_of
from nnpp_edge.cli.options import TerrainOptions
from nnpp_edge.cli.plan_answer import duration
from nnpp_edge.cli.refusal import Near, refuse
from nnpp_edge.cli.vehicle_options import VehicleOptions

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.slope_cost import Mobility
    from nnpp_edge.terrain.reach import Reach

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def _duration(word: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d*)?)\s*(s|min|h)?", word)
    if found is None or not 0.0 < (seconds := float(found[1]) * _SECONDS[found[2] or "s"]) <= options.LARGEST:
        raise ValueError
    return seconds


@dataclass(frozen=True)
class Request:
    """From where, and how far: the options' values, as given."""

    start: End
    within_cost: float | None
    within_time: float | None
    within_energy: float | None
    levels: int
    step_cost: str
    omega: float
    corner_cutting: bool

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        from nnpp_edge.runtime.map.slope_cost import unit_of

        if sum(most is not None for most in (self.within_cost, self.within_time, self.within_energy)) != 1:
            raise click.UsageError("give one of --within-cost, --within-time and --within-energy")
        measure, _ = self.most
        in_seconds = measure == "time" and unit_of(self.step_cost) == "s"
        if measure != "cost" and "step_cost" in options.given_options() and not in_seconds:
            raise click.UsageError(
                f"--within-{measure} counts {measure} already: leave out --step-cost, or give --within-cost with it; "
                "one in seconds goes with --within-time"
            )

    @property
    def most(self) -> tuple[str, float]:
        """What is counted, and the most of it."""
        within = {"cost": self.within_cost, "time": self.within_time, "energy": self.within_energy}
        return next((measure, most) for measure, most in within.items() if most is not None)

    def priced_by(self, mobility: Mobility) -> str:
        """The step cost by which it is counted."""
        from nnpp_edge.runtime.map.slope_cost import unit_of

        if self.within_time is not None and unit_of(self.step_cost) != "s":
            return "time" if mobility.time else "tobler"
        return self.step_cost if self.within_energy is None else "energy"


@click.command(name="reach")
@click.argument("dem", type=options.MAP)
@click.option(
    "--start", type=Where(), required=True, help="ROW,COL, xy:X,Y, lonlat:LON,LAT, or a vector file's point."
)
@click.option(
    "--within-cost", type=options.POSITIVE, help="The most that a path may cost, in the unit of --step-cost."
)
@click.option(
    "--within-time",
    type=options.Parsed("TIME", "a time such as 90, 90s, 30min or 2h", _duration),
    help="The longest that it may take: by --step-cost, else at the vehicle's speeds, else by Tobler's function.",
)
@click.option("--within-energy", type=options.POSITIVE, help="The most joules that it may draw, of a --vehicle.")
@click.option("--levels", type=click.IntRange(1, 24), default=4, help="Into how many areas that is divided.")
@options.terrain
@options.step_cost
@options.omega
@options.corner_cutting
@options.hillshade
@vehicle_options.vehicle
@click.option("-o", "--output", type=options.PATH, help="Folder for reach.tif, reach.geojson, reach.png, reach.json.")
@click.option(
    "--format", "formats", type=click.Choice(["gpkg"]), multiple=True, help="Write the areas as GeoPackage too."
)
@options.as_json
@options.gathered("request", Request)
def command(
    dem: Path,
    request: Request,
    terrain: TerrainOptions,
    hillshade: bool,
    vehicle: VehicleOptions,
    output: Path | None,
    formats: tuple[str, ...],
    as_json: bool,
) -> None:
    """Show what can be reached on the elevation map DEM from a place, within a cost, a time or an energy.

    The areas are nested: each holds the cells that can be reached within its share of what is allowed. reach.tif has
    the cost of getting to each cell, reach.geojson the areas in the map's own coordinates, along the cells' sides.

    \b
    nnpp-edge reach dem.tif --start 20,30 --within-time 30min --workload limit20 -o reach
    """
    if formats and output is None:
        raise click.UsageError("--format is of what is written: give -o too")
    names = ("reach.tif", "reach.geojson", "reach.png", "reach.json", *(f"reach.{name}" for name in formats))
    paths = [output / name for name in names] if output else []
    read = [] if request.start.file is None else [request.start.file]
    options.check_outputs(*(("--output", path) for path in paths), more_inputs=read, make_folders=True)

    import numpy as np

    from nnpp_edge.files import write_all
    from nnpp_edge.runtime import Planner
    from nnpp_edge.runtime.map.slope_cost import unit_of
    from nnpp_edge.runtime.planners.query import problem_with
    from nnpp_edge.terrain.dem import raster_bytes
    from nnpp_edge.terrain.reach import Reach
    from nnpp_edge.viz.picture import png_bytes
    from nnpp_edge.viz.reach_picture import reach_picture

    place, limits = terrain.read(dem), terrain.limits()
    cost, start = cost_of(place, limits), request.start.one_cell(place, "--start")
    step_cost = request.priced_by(vehicle.mobility(place))
    ground = ground_of(place, limits, vehicle, step_cost)
    planner = Planner(priced(ground, cost), omega=request.omega, corner_cutting=request.corner_cutting)
    if problem := problem_with(planner.state.grid, start, start):
        refuse(problem, start, start, Near(place, place.elevation, cost, limits, ground.vehicle))
    measure, most = request.most
    shares = tuple((most * np.arange(1, request.levels + 1) / request.levels).tolist())
    found = Reach(planner.reach(start, most), shares, measure, unit_of(step_cost), place)
    figures = {"start": start, **_figures(found), **({"files": [str(path) for path in paths]} if paths else {})}
    if output:
        shade = options.shade_of(place) if hillshade else None
        levels = [(level, _in_words(found, level)) for level in found.levels]
        picture = reach_picture(cost, found.field, levels, start, shade=shade, cell_size_m=place.cell_width_m)
        contents = (
            raster_bytes(paths[0], found.raster(), place),
            found.geojson(),
            png_bytes(picture),
            json.dumps(figures, indent=1).encode(),
            *(found.geopackage() for _ in formats),
        )
        write_all(dict(zip(paths, contents, strict=True)))
    click.echo(json.dumps(figures) if as_json else _text(found, figures))


def _figures(found: Reach) -> dict[str, object]:
    """Ready for JSON."""
    areas = [
        {"within": level, "cells": cells, "area_m2": round(area, 3)}
        for level, cells, area in zip(found.levels, found.cells, found.areas_m2, strict=True)
    ]
    return {"measure": found.measure, "unit": found.unit, "areas": areas, **size_of(found.dem)}


def _in_words(found: Reach, level: float) -> str:
    """A level for people, in ASCII."""
    if found.measure == "time":
        return f"within {duration(level)}"
    if found.measure == "energy":
        return f"within {level / 1000.0:.4g} kJ"
    return f"within a cost of {level:.6g} {found.unit}".rstrip()


def _text(found: Reach, figures: dict[str, object]) -> str:
    """For people."""
    lines = {"map": size_in_words(found.dem), "start": str(figures["start"])}
    for level, cells, area in zip(found.levels, found.cells, found.areas_m2, strict=True):
        size = f"{area / 1e6:.4g} km²" if area >= 1e5 else f"{area:.0f} m²"
        lines[_in_words(found, level)] = f"{cells} cells, {size}, {100.0 * cells / found.field.size:.1f} % of the map"
    if files := figures.get("files"):
        lines["written"] = ", ".join(files)  # type: ignore[arg-type]  # names
    wide = max(map(len, lines)) + 2
    return "\n".join(f"{name:<{wide}}{value}" for name, value in lines.items())
