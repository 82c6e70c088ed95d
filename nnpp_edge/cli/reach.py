"""`nnpp-edge reach`: what can be reached from a place within a cost, a time or an energy."""

from __future__ import annotations

import json
import re
from pathlib import Path

import click

from nnpp_edge.cli import options, vehicle_options
from nnpp_edge.cli.ends import Where
from nnpp_edge.cli.options import TerrainOptions
from nnpp_edge.cli.requests import ReachRequest
from nnpp_edge.cli.vehicle_options import VehicleOptions

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def _duration(word: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d*)?)\s*(s|min|h)?", word)
    if found is None or not 0.0 < (seconds := float(found[1]) * _SECONDS[found[2] or "s"]) <= options.LARGEST:
        raise ValueError
    return seconds


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
@options.gathered("request", ReachRequest)
def command(
    dem: Path,
    request: ReachRequest,
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

    from nnpp_edge.cli import reaching

    found = reaching.reach(request, dem, terrain, vehicle)
    files = found.save(paths, hillshade=hillshade)
    click.echo(json.dumps(found.figures(files)) if as_json else found.text(files))
