"""`nnpp-edge reach`: what can be reached from a place within a cost, a time or an energy."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options, vehicle_options
from nnpp_edge.cli.cost_summary import MapSize
from nnpp_edge.cli.costmap import cost_of
from nnpp_edge.cli.ends import End, Where
from nnpp_edge.cli.options import TerrainOptions
from nnpp_edge.cli.plan_answer import Near, duration
from nnpp_edge.cli.refusal import refusal
from nnpp_edge.cli.vehicle_options import VehicleOptions

if TYPE_CHECKING:
    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.terrain.dem import Dem
    from nnpp_edge.terrain.reach import Reach

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
@click.option(
    "--corner-cutting/--no-corner-cutting", default=True, help="Allow diagonal steps beside impassable cells."
)
@click.option("--hillshade", is_flag=True, help="Draw the relief in place of the cost.")
@vehicle_options.vehicle
@click.option("-o", "--output", type=options.PATH, help="Folder for reach.tif, reach.geojson, reach.png, reach.json.")
@click.option(
    "--format", "formats", type=click.Choice(["gpkg"]), multiple=True, help="Write the areas as GeoPackage too."
)
@options.as_json
def command(
    dem: Path,
    start: End,
    within_cost: float | None,
    within_time: float | None,
    within_energy: float | None,
    levels: int,
    terrain: TerrainOptions,
    step_cost: str,
    omega: float,
    corner_cutting: bool,
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
    within = {"cost": within_cost, "time": within_time, "energy": within_energy}
    given = [(measure, most) for measure, most in within.items() if most is not None]
    if len(given) != 1:
        raise click.UsageError("give one of --within-cost, --within-time and --within-energy")
    if within_cost is None and "step_cost" in options.given_options():
        from nnpp_edge.runtime.map.slope_cost import unit_of

        if within_time is None or unit_of(step_cost) != "s":
            raise click.UsageError(
                f"--within-{given[0][0]} counts {given[0][0]} already: leave out --step-cost, or give --within-cost "
                "with it; one in seconds goes with --within-time"
            )
    if formats and output is None:
        raise click.UsageError("--format is of what is written: give -o too")
    names = ("reach.tif", "reach.geojson", "reach.png", "reach.json", *(f"reach.{name}" for name in formats))
    paths = [output / name for name in names] if output else []
    read = [] if start.file is None else [start.file]
    options.check_outputs(*(("--output", path) for path in paths), more_inputs=read, make_folders=True)
    ground = terrain.read(dem)
    cost = cost_of(ground, terrain.limits())
    cells = start.cells(ground)
    if len(cells) != 1:
        from nnpp_edge.runtime.errors import InvalidQueryError

        raise InvalidQueryError(f"--start must be one place, got {len(cells)}")
    (measure, most), cell = given[0], cells[0]
    wanted = measure, step_cost, most, levels
    found = _reach(ground, cost, cell, wanted, terrain, vehicle, omega, corner_cutting)
    figures = _figures(found, cell, [str(path) for path in paths])
    if output:
        _save(paths, found, figures, cost, cell, hillshade=hillshade)
    click.echo(json.dumps(figures) if as_json else _text(found, cell, [str(path) for path in paths]))


def _reach(
    ground: Dem,
    cost: Float2D,
    start: Cell,
    wanted: tuple[str, str, float, int],
    terrain: TerrainOptions,
    vehicle: VehicleOptions,
    omega: float,
    corner_cutting: bool,
) -> Reach:
    """Search from the start until all is known that lies within."""
    import numpy as np

    from nnpp_edge.runtime import Planner
    from nnpp_edge.runtime.errors import InvalidQueryError
    from nnpp_edge.runtime.map.slope_cost import unit_of
    from nnpp_edge.runtime.planners.query import problem_with
    from nnpp_edge.terrain.reach import Reach

    (measure, step_cost, most, levels), mobility, body = wanted, vehicle.mobility(ground), vehicle.make()
    if measure == "time" and unit_of(step_cost) != "s":
        step_cost = "time" if mobility.time else "tobler"
    elif measure == "energy":
        step_cost = "energy"
    if step_cost == "paper" and body is None:
        planner = Planner(cost, omega=omega, corner_cutting=corner_cutting)
    else:
        planner = Planner.of_elevation(
            ground.elevation,
            ground.cell_size_m,
            terrain.limits(),
            cell_width_m=ground.cell_width_m,
            omega=omega,
            corner_cutting=corner_cutting,
            warn=False,
            vehicle=body,
            step_cost=step_cost,
            mobility=mobility,
        )
    if problem := problem_with(planner.state.grid, start, start):
        raise InvalidQueryError(
            refusal(problem, start, ground, Near((0, 0), ground.elevation, cost), terrain.limits(), body)
        )
    shares = tuple((most * np.arange(1, levels + 1) / levels).tolist())
    return Reach(planner.reach(start, most), shares, measure, unit_of(step_cost), ground)


def _figures(found: Reach, start: Cell, files: list[str]) -> dict[str, object]:
    """Ready for JSON."""
    from dataclasses import asdict

    areas = [
        {"within": level, "cells": cells, "area_m2": round(area, 3)}
        for level, cells, area in zip(found.levels, found.cells, found.areas_m2, strict=True)
    ]
    figures = {"start": start, "measure": found.measure, "unit": found.unit, "areas": areas}
    return figures | asdict(MapSize.of(found.dem)) | ({"files": files} if files else {})


def _words(found: Reach, level: float) -> str:
    """A level for people, in ASCII."""
    if found.measure == "time":
        return f"within {duration(level)}"
    if found.measure == "energy":
        return f"within {level / 1000.0:.4g} kJ"
    return f"within a cost of {level:.6g} {found.unit}".rstrip()


def _text(found: Reach, start: Cell, files: list[str]) -> str:
    """For people."""
    size = found.field.size
    lines = {"map": str(MapSize.of(found.dem)), "start": str(start)}
    for level, cells, area in zip(found.levels, found.cells, found.areas_m2, strict=True):
        lines[_words(found, level)] = f"{cells} cells, {_area(area)}, {100.0 * cells / size:.1f} % of the map"
    if files:
        lines["written"] = ", ".join(files)
    wide = max(map(len, lines)) + 2
    return "\n".join(f"{name:<{wide}}{value}" for name, value in lines.items())


def _area(square_m: float) -> str:
    return f"{square_m / 1e6:.4g} km²" if square_m >= 1e5 else f"{square_m:.0f} m²"


def _save(
    paths: list[Path], found: Reach, figures: dict[str, object], cost: Float2D, start: Cell, *, hillshade: bool
) -> None:
    """Write the files, all or none."""
    from nnpp_edge.files import write_all
    from nnpp_edge.terrain.dem import raster_bytes
    from nnpp_edge.viz.picture import hillshade as shaded
    from nnpp_edge.viz.picture import png_bytes
    from nnpp_edge.viz.reach_picture import reach_picture

    ground = found.dem
    tif, geojson, png, json_file, *more = paths
    shade = shaded(ground.elevation, ground.cell_size_m, ground.cell_width_m) if hillshade else None
    levels = [(level, _words(found, level)) for level in found.levels]
    picture = reach_picture(cost, found.field, levels, start, shade=shade, cell_size_m=ground.cell_width_m)
    contents = {
        tif: raster_bytes(tif, found.raster(), ground),
        geojson: found.geojson(),
        png: png_bytes(picture),
        json_file: json.dumps(figures, indent=1).encode(),
    }
    write_all(contents | {path: found.geopackage() for path in more})
