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
    from nnpp_edge.view.site import Body


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

    from nnpp_edge.runtime.errors import InvalidMapError, optional_module

    for name in ("starlette", "uvicorn", "websockets"):
        optional_module(name, "nnpp-edge view", "view")

    from msgspec.structs import replace

    from nnpp_edge.cli.maps import size_in_words
    from nnpp_edge.view.asked import Asked
    from nnpp_edge.view.landscape import Landscape, likely_ends
    from nnpp_edge.view.server import listen, make_app, serve
    from nnpp_edge.view.site import GIVEN, POINT, Reading, Site
    from nnpp_edge.view.trial import Trial

    with listen(port) as listening:
        reading = Reading(dem, terrain.cell_size, terrain.vertical_scale, terrain.rescale, terrain.allow_vrt)
        read = terrain.read(dem)
        given = _given_body(vehicle, read)
        site = Site.of(read, reading, given)
        body = vehicle.vehicle or POINT if given is None else GIVEN if given.vehicle else POINT
        asked = Asked(
            start=start.one_cell(site.dem, "--start") if start else (0, 0),
            goal=goal.one_cell(site.dem, "--goal") if goal else (0, 0),
            step_cost=step_cost,  # type: ignore[arg-type]  # click has checked it
            omega=omega,
            slope_limit=limits.slope_limit_deg,
            roughness_limit=limits.roughness_limit_m,
            step_limit=limits.step_limit_m,
            hard_slope=_finite(limits.hard_slope_deg),
            hard_roughness=_finite(limits.hard_roughness_m),
            hard_step=_finite(limits.hard_step_m),
            body=body,
        )
        landscape = Landscape(site, asked)  # what cannot be planned on is refused here
        if (likely := likely_ends(landscape.cost, landscape.stands)) is None:
            raise InvalidMapError(f"{dem}: wanted a map to plan on, got {size_in_words(site.dem)}, all impassable")
        asked = replace(asked, start=asked.start if start else likely[0], goal=asked.goal if goal else likely[1])
        first = [Trial(site, asked, landscape)]
        address = f"http://127.0.0.1:{listening.getsockname()[1]}/"

        def make_trial() -> Trial:
            return first.pop() if first else Trial(site, asked)

        def when_ready() -> None:
            click.echo(address)
            if not no_browser:
                click.launch(address)

        serve(make_app(make_trial, when_ready), listening)


def _given_body(options_given: VehicleOptions, place: Dem) -> Body | None:
    """The vehicle that the options describe, with the words that do so; None for none, or a shipped one."""
    from nnpp_edge.terrain.vehicle_files import shipped_vehicles
    from nnpp_edge.view.site import Body

    names = {field.name for field in fields(VehicleOptions)}.intersection(options.given_options())
    if not names or (names == {"vehicle"} and options_given.vehicle in shipped_vehicles()):
        return None
    words: list[str] = []
    for each in click.get_current_context().command.params:
        if each.name in names:
            words += _words(each, getattr(options_given, str(each.name)))
    return Body.given(options_given.make(), options_given.mobility(place), tuple(words))


def _words(option: click.Parameter, value: object) -> list[str]:
    """An option with its value, as it is typed; files by their whole names."""
    if isinstance(value, tuple):
        return [word for setting in value for word in (option.opts[0], setting.word)]
    word = str(value)
    return [option.opts[0], str(Path(word).resolve()) if Path(word).is_file() else word]


def _finite(limit: float) -> float | None:
    """A limit, None for inf."""
    return limit if limit < float("inf") else None
