"""`nnpp-edge view`: a page on this machine to look at a map and to try planning on it."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options, vehicle_options
from nnpp_edge.cli.ends import Where
from nnpp_edge.cli.options import TerrainOptions
from nnpp_edge.cli.vehicle_options import VehicleOptions

if TYPE_CHECKING:
    from nnpp_edge.cli.ends import End
    from nnpp_edge.terrain.dem import Dem
    from nnpp_edge.view.asked import Body


@click.command(name="view")
@click.argument("dem", type=options.MAP)
@click.option("--start", type=Where(), help="Where the path begins at first, as for plan.")
@click.option("--goal", type=Where(), help="Likewise where it leads.")
@options.terrain
@options.step_cost
@options.omega
@vehicle_options.vehicle
@click.option("--port", type=click.IntRange(0, 65535), default=8765, help="Of the page on 127.0.0.1; 0 for any.")
@click.option("--no-browser", is_flag=True, help="Print the page's address and open no browser.")
def command(
    dem: Path,
    start: End | None,
    goal: End | None,
    terrain: TerrainOptions,
    step_cost: str,
    omega: float,
    vehicle: VehicleOptions,
    port: int,
    no_browser: bool,
) -> None:
    """Open a page to look at the elevation map DEM, and to try planning on it.

    Drag start and goal, set limits, step cost and vehicle, compare methods, paint obstacles, and copy what you see as
    a command or as Python. The page is served to this machine alone, asks nothing of any other, and ends with Ctrl-C.

    \b
    nnpp-edge view dem.tif --workload limit20
    """
    limits = terrain.limits()

    from msgspec.structs import replace

    from nnpp_edge.cli.maps import size_in_words
    from nnpp_edge.runtime.errors import InvalidMapError
    from nnpp_edge.view.answers import Answerer
    from nnpp_edge.view.asked import GIVEN, POINT, Asked, Site
    from nnpp_edge.view.landscape import likely_ends
    from nnpp_edge.view.server import PageServer

    with PageServer(port) as server:
        read = terrain.read(dem)
        given = _given_body(vehicle, read)
        reading = {"cell_size_m": terrain.cell_size, "vertical_scale": terrain.vertical_scale}
        reading |= {"rescale": terrain.rescale, "allow_vrt": terrain.allow_vrt or None}
        site = Site.of(read, dem, {name: value for name, value in reading.items() if value is not None}, given)
        asked = Asked(
            start=start.one_cell(site.dem, "--start") if start else (0, 0),
            goal=goal.one_cell(site.dem, "--goal") if goal else (0, 0),
            step_cost=step_cost,  # type: ignore[arg-type]  # click has checked it
            omega=omega,
            limits=limits,
            body=vehicle.vehicle or POINT if given is None else GIVEN if given.vehicle else POINT,
        )
        answerer = Answerer(site, asked)
        landscape = answerer.landscape(asked)  # what cannot be planned on is refused here
        if (likely := likely_ends(landscape.cost, landscape.planner.is_passable)) is None:
            raise InvalidMapError(f"{dem}: wanted a map to plan on, got {size_in_words(site.dem)}, all impassable")
        answerer.first = replace(
            asked, start=asked.start if start else likely[0], goal=asked.goal if goal else likely[1]
        )
        click.echo(server.address)
        if not no_browser:
            click.launch(server.address)
        server.serve(answerer)


def _given_body(options_given: VehicleOptions, place: Dem) -> Body | None:
    """The vehicle that the options describe, with the words that do so; None for none, or a shipped one."""
    from nnpp_edge.terrain.vehicle_files import shipped_vehicles
    from nnpp_edge.view.asked import Body

    names = {field.name for field in fields(VehicleOptions)}.intersection(options.given_options())
    if not names or (names == {"vehicle"} and options_given.vehicle in shipped_vehicles()):
        return None
    words: list[str] = []
    for each in click.get_current_context().command.params:
        if each.name in names:
            words += _words(each, getattr(options_given, str(each.name)))
    return Body(options_given.make(), options_given.mobility(place), tuple(words))


def _words(option: click.Parameter, value: object) -> list[str]:
    """An option with its value, as it is typed; files by their whole names."""
    if isinstance(value, tuple):
        return [word for setting in value for word in (option.opts[0], setting.word)]
    word = str(value)
    return [option.opts[0], str(Path(word).resolve()) if Path(word).is_file() else word]
