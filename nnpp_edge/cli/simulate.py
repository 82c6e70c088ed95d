"""`nnpp-edge simulate`: a robot that drives through the onboard loop, over ground that its map
knows only roughly.
"""

from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import GroundOptions, Known
from nnpp_edge.cli.requests import PLACE, End, Start
from nnpp_edge.cli.text import Row, aligned, loop_lines, tell
from nnpp_edge.runtime.options import METHODS, StepOptions

if TYPE_CHECKING:
    from nnpp_edge.runtime.loop.connections import Sink
    from nnpp_edge.runtime.map.state import MapState
    from nnpp_edge.simulation.simulate import DriveOutcome

_SAMPLE = "moon_highlands"
_SAMPLE_RESCALE = 20.0
_CELLS_TO_A_BODY = 4.0
"""Cells of the sample along a vehicle."""


@options.command("simulate")
def command(
    robot: GroundOptions,
    steps: StepOptions,
    known: Known = None,
    dem: Annotated[
        Path | None, "--map", options.MAP, "Elevation map; by default the shipped lunar sample."
    ] = None,
    size: Annotated[
        int,
        click.IntRange(16, options.MOST),
        (
            "Side of the part of the map that is driven on, around --start and --goal, or where "
            "the seed puts it."
        ),
    ] = 256,
    start: Start | None = None,
    goal: Annotated[End | None, PLACE, "As --start; by default the seed picks both."] = None,
    method: Annotated[str, click.Choice([*METHODS])] = "auto",
    model: options.Model = "edge",
    rate: Annotated[float | None, options.RATE, "Ticks a second; else as fast as possible."] = None,
    ticks: Annotated[int, "At most."] = 5000,
    sight: Annotated[int, "Cells to each side, beyond the body, that it sees."] = 12,
    speed: Annotated[int, "Cells a tick."] = 1,
    rocks: Annotated[float, options.Real(0.0, 0.2), "Share of the ground under rocks."] = 0.0,
    seed: options.Seed = 1,
    endless: Annotated[bool, "Drive from goal to goal for all --ticks."] = False,
    log: Annotated[Path | None, "Write inputs and answers as MCAP with ROS 2 messages."] = None,
    picture: Annotated[Path | None, ".png of the way driven, or .gif of the drive."] = None,
    as_json: options.AsJson = False,
) -> None:
    """Drive a simulated robot to its goal through the onboard loop.

    The robot begins with a coarse survey of the terrain, sees the true cost of the cells around it,
    and walks along the newest path; obstacles of cost 1 appear, move and vanish. Every path is
    checked outside the loop, too. A vehicle sees heights instead, obstacles are higher than any
    step, and its body is checked wherever it goes. The survey shows no rocks. Exit codes: 0 at the
    goal, 1 where it was not reached or a path crossed a forbidden cell, 2 for wrong use.

    \b
    nnpp-edge simulate --workload limit20 --picture drive.gif --log drive.mcap
    nnpp-edge simulate --map dem.tif --vehicle small-rover --rocks 0.1 --picture drive.png
    """
    if (start is None) != (goal is None):
        raise click.UsageError("give both --start and --goal, or neither")

    from nnpp_edge.files import write_whole
    from nnpp_edge.robot.transports.mcap_log import McapLog
    from nnpp_edge.runtime.compiled.notice import told_if_slow
    from nnpp_edge.runtime.errors import InvalidQueryError
    from nnpp_edge.simulation.drive_picture import drive_picture, film_of
    from nnpp_edge.simulation.part import ground_of_part, part_of_map
    from nnpp_edge.simulation.scene import SimulationSettings
    from nnpp_edge.simulation.simulate import random_drive, simulate
    from nnpp_edge.terrain.dem import sample_path
    from nnpp_edge.viz.picture import encoded

    rescale = robot.rescale
    robot = replace(robot, rescale=None)  # the ground is shrunk itself
    robot.limits()  # those that make no sense are refused before any work
    settings = SimulationSettings(
        method,
        model,
        rate,
        ticks,
        sight=sight,
        speed=speed,
        seed=seed,
        endless=endless,
        steps=steps,
    )
    film = film_of(picture)
    options.check_outputs(("--log", log), ("--picture", picture), make_folders=True)
    if dem is None:
        cell_m = robot.posed.length_m / _CELLS_TO_A_BODY if robot.posed else _SAMPLE_RESCALE
        dem = sample_path(_SAMPLE)
        rescale = rescale or cell_m
    with told_if_slow(f"reading {dem}"):
        read = robot.read(dem)
        whole = read if rescale is None else read.rescaled(rescale)
    ends = None
    if start and goal:
        ends = (start(whole), goal(whole))
    with told_if_slow("preparing the ground"):
        part = part_of_map(whole, size, known.factor if known else 1, robot.body(), seed, ends)
        row, col, rows, cols = part
        ground = ground_of_part(whole, part, robot.of, rocks, seed, known)
        ground = replace(ground, origin=part[:2], north_deg=read.north_deg)
    if ends:
        begin, end = ((each[0] - row, each[1] - col) for each in ends)
    else:
        begin, end = random_drive(ground, seed)
    sinks: list[Sink] = []
    with told_if_slow("driving"), ExitStack() as stack:

        def make_sinks(state: "MapState") -> "list[Sink]":
            if log is not None:
                sinks.append(stack.enter_context(closing(McapLog(log, state))))
            return sinks

        try:
            drive = simulate(ground, begin, end, settings, make_sinks=make_sinks, watch=film)
        except InvalidQueryError as error:
            place = f"on the part of the map from cell ({row}, {col}) on"
            raise InvalidQueryError(f"{error}, {place}") from None
    files = [str(sink.path) for sink in sinks if isinstance(sink, McapLog)]
    if picture is not None:
        write_whole(picture, film.gif() if film else encoded(drive_picture(ground, drive)))
        files.append(str(picture))
    result = drive.summary() | {"row": row, "col": col, "rows": rows, "cols": cols, "files": files}
    for name, cell in (("start", drive.start), ("goal", drive.goal)):
        in_file = ground.in_file(cell)
        result |= {name: in_file, f"{name}_xy": whole.map_coordinates(*in_file)}
    tell(as_json, result, lambda: text(drive, result, whole.source.name))
    if drive.forbidden or not (drive.reached or endless):
        click.get_current_context().exit(1)


def text(drive: "DriveOutcome", result: Row, name: str) -> str:
    """The result for people, on a part of the map of this name."""
    from nnpp_edge.terrain.facts import lines_of

    ended = "goal reached" if drive.reached else "GOAL NOT REACHED"
    if drive.goals > 1:
        ended = f"{drive.goals} goals reached"
    place = "{rows} × {cols} cells of {name}, from cell ({row}, {col}) on"
    xy = "({:.9g}, {:.9g}) to ({:.9g}, {:.9g})"
    lines = {
        ended: f"{drive.method}, {result['start']} to {result['goal']}",
        "map": place.format(**result, name=name),
        "in x, y": xy.format(*result["start_xy"], *result["goal_xy"]),
        **loop_lines(drive.counters),
        "answer": "p50 {p50:.2f}, p99 {p99:.2f}, max {max:.2f} ms".format(**drive.planning_ms),
        **lines_of(drive.facts),
        "memory": ", ".join(f"{when} {size:.0f}" for when, size in drive.memory_mb.items()) + " MB",
        "written": ", ".join(result["files"]),
    }
    return aligned(lines)
