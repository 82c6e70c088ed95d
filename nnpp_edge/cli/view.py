"""`nnpp-edge view`: a page on this machine to look at a map and to try planning on it."""

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import GroundOptions
from nnpp_edge.cli.requests import PLACE, End
from nnpp_edge.runtime.options import StepOptions

if TYPE_CHECKING:
    from nnpp_edge.terrain.dem import Dem
    from nnpp_edge.view.asked import Body


@options.command("view")
def command(
    dem: Annotated[Path, options.MAP],
    /,
    robot: GroundOptions,
    steps: StepOptions,
    model: options.Model = "edge",
    start: Annotated[End | None, PLACE, "Initial start of the path, as for plan."] = None,
    goal: Annotated[End | None, PLACE, "As --start."] = None,
    port: Annotated[int, click.IntRange(0, 65535), "Of the page on 127.0.0.1; 0 for any."] = 8765,
    no_browser: Annotated[bool, "Print the page's address and open no browser."] = False,
) -> None:
    """Open a page to look at the elevation map DEM, and to try planning on it.

    Click for a goal, set limits, step cost and vehicle, compare methods, paint obstacles, save the
    path, or copy what you see as a command. The page is served to this machine only, loads nothing
    from others, and ends with Ctrl-C.

    \b
    nnpp-edge view dem.tif --workload limit20
    """
    robot.limits()  # those that make no sense are refused before any work

    from msgspec.structs import replace

    from nnpp_edge.cli.maps import refuse_map
    from nnpp_edge.runtime.compiled import notice
    from nnpp_edge.view.answers import Answerer
    from nnpp_edge.view.asked import GIVEN, POINT, Asked, Site
    from nnpp_edge.view.landscape import likely_ends
    from nnpp_edge.view.server import PageServer

    def told(line: str) -> None:
        Answerer.notice = line
        click.echo(line, err=True)

    with PageServer(port) as server:
        notice.tell = told
        read = robot.read(dem)
        robot.warn_if_coarse(read)
        given = _given_body(robot, read)
        said = {} if robot.cell_size is None else {"cell_size": robot.cell_size}
        site = Site.of(read, dem.resolve(), said, given, model)
        asked = Asked(
            start=start(read) if start else (0, 0),
            goal=goal(read) if goal else (0, 0),
            step_cost=robot.step_cost,
            **steps,
            limits=robot.limits(read),
            body=robot.vehicle or POINT if given is None else GIVEN if given.vehicle else POINT,
        )
        server.answerer = answerer = Answerer(site, asked)
        landscape = answerer.landscape(asked)  # what cannot be planned on is refused here
        if (likely := likely_ends(landscape.cost, landscape.planner.is_passable)) is None:
            refuse_map(read)
        answerer.first = replace(
            asked,
            start=asked.start if start else likely[0],
            goal=asked.goal if goal else likely[1],
        )
        click.echo(server.address)
        if not no_browser:
            click.launch(server.address)
        signal.signal(
            signal.SIGINT, signal.default_int_handler
        )  # a shell has it ignored by what it starts with &
        server.serve()


def _given_body(robot: GroundOptions, place: "Dem") -> "Body | None":
    """The vehicle that the options describe, with the words that do so; None for none, or a shipped
    one.
    """
    from nnpp_edge.terrain.vehicle_files import shipped_vehicles
    from nnpp_edge.view.asked import Body

    words = []
    for option, name in (("--vehicle", robot.vehicle), ("--mobility", robot.mobility_file)):
        if name:
            words += [option, str(Path(name).resolve()) if Path(name).is_file() else name]
    words += [word for setting in robot.settings for word in ("--set", setting.word)]
    if not words or (len(words) == 2 and robot.vehicle in shipped_vehicles()):
        return None
    return Body(robot.body(), robot.mobility(place), tuple(words))
