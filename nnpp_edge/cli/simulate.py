"""`nnpp-edge simulate`: a robot that drives through the onboard loop, over ground that its map
knows only roughly.
"""

from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import GroundOptions, Known, TerrainOptions
from nnpp_edge.cli.requests import PLACE, End, Start
from nnpp_edge.cli.text import Row, aligned, tell
from nnpp_edge.robot.transports.wiring import View
from nnpp_edge.runtime.options import METHODS, StepOptions

if TYPE_CHECKING:
    from nnpp_edge.runtime.loop.connections import Sink
    from nnpp_edge.runtime.map.state import MapState
    from nnpp_edge.simulation.simulate import DriveOutcome

_SAMPLE = "moon_highlands"
_SAMPLE_RESCALE = 20.0
_CELLS_TO_A_BODY = 4.0
"""Cells of the sample along a vehicle."""
_SURVEY = 8
"""Cells over which a point's first map is blurred without --known."""
_SIZE = (
    "Side of the part of the map that is driven on; the seed picks one, which holds --start "
    "and --goal."
)
_GOAL = "As --start; by default the seed picks both."
_NOISE = "Standard deviation of the steering angle, degrees, of a vehicle that drives arcs."


@options.command("simulate")
def command(
    robot: GroundOptions,
    steps: StepOptions,
    known: Known = None,
    dem: Annotated[
        Path | None, "--map", options.MAP, "Elevation map; by default the shipped lunar sample."
    ] = None,
    size: Annotated[int, click.IntRange(16, options.MOST), _SIZE] = 256,
    start: Start | None = None,
    goal: Annotated[End | None, PLACE, _GOAL] = None,
    method: Annotated[str, click.Choice([*METHODS])] = "auto",
    model: options.Model = "edge",
    rate: Annotated[float | None, options.RATE, "Ticks a second; else as fast as possible."] = None,
    ticks: Annotated[int, "At most."] = 5000,
    sight: Annotated[int, "Cells to each side, beyond the body, that it sees."] = 12,
    speed: Annotated[int, "Cells a tick."] = 1,
    steering_noise: Annotated[float, options.Real(0.0, 45.0), _NOISE] = 0.0,
    rocks: Annotated[float, options.Real(0.0, 0.2), "Share of the ground under rocks."] = 0.0,
    seed: options.Seed = 1,
    endless: Annotated[bool, "Drive from goal to goal for all --ticks."] = False,
    log: Annotated[Path | None, "Write inputs and answers as MCAP with ROS 2 messages."] = None,
    view: View = None,
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

    import numpy as np

    from nnpp_edge.cli.maps import size_in_words
    from nnpp_edge.robot.transports.mcap_log import McapLog
    from nnpp_edge.robot.transports.rerun_view import RerunSink
    from nnpp_edge.runtime.compiled.notice import told_if_slow
    from nnpp_edge.runtime.errors import InvalidQueryError
    from nnpp_edge.simulation.drive_picture import Film, check_name, drive_picture
    from nnpp_edge.simulation.robots import reach_of
    from nnpp_edge.simulation.scene import SimulationSettings, SurveyedGround
    from nnpp_edge.simulation.simulate import random_drive, simulate
    from nnpp_edge.terrain.dem import sample_path
    from nnpp_edge.terrain.rocks import with_rocks
    from nnpp_edge.viz.picture import save_picture

    rescale = robot.rescale
    robot = replace(robot, rescale=None)  # the ground is shrunk itself
    robot.limits()  # those that make no sense are refused before any work
    body = robot.body()
    settings = SimulationSettings(
        method,
        model,
        rate,
        ticks,
        sight=sight,
        speed=speed,
        seed=seed,
        endless=endless,
        steering_noise_deg=steering_noise,
        steps=steps,
    )
    if picture is not None:
        check_name(picture)
    written = [str(file) for file in (log, picture) if file is not None]
    options.check_outputs(
        ("--log", log),
        ("--picture", picture),
        ("--view", options.view_file(view)),
        make_folders=True,
    )
    if dem is None:
        cell_m = robot.posed.length_m / _CELLS_TO_A_BODY if robot.posed else _SAMPLE_RESCALE
        dem = sample_path(_SAMPLE)
        rescale = rescale or cell_m
    with told_if_slow(f"reading {dem}"):
        read = TerrainOptions.read(robot, dem)
        whole = robot.made_finer(read if rescale is None else read.rescaled(rescale), "file")
    rng = np.random.default_rng([seed, 3])
    factor = known.factor if known else 1
    rows, cols = (min(size, side) // factor * factor for side in whole.shape)
    row, col = (
        int(rng.integers(side - kept + 1))
        for side, kept in zip(whole.shape, (rows, cols), strict=True)
    )
    if start and goal:
        ends = np.array([start.one_cell(whole, "--start"), goal.one_cell(whole, "--goal")])
        reach = reach_of(body, (whole.cell_size_m, whole.cell_width_m))
        last = np.subtract(whole.shape, 1)
        least = np.minimum(ends.max(0) + reach, last) - (rows - 1, cols - 1)
        most = np.maximum(ends.min(0) - reach, 0)
        if ((ends < 0) | (ends > last) | (least > most)).any():
            raise InvalidQueryError(
                f"--start and --goal, cells {ends.tolist()}, must not lie outside the map of "
                f"{size_in_words(whole)}, nor further apart than --size {size} holds with {reach} "
                "cells around each"
            )
        corner = np.array((row, col))
        if ((corner < least) | (corner > most)).any():
            corner = (least + most) // 2  # the ends lie around the part's middle
        row, col = np.clip(corner, 0, np.subtract(whole.shape, (rows, cols))).tolist()
    heights = np.ascontiguousarray(whole.elevation[row : row + rows, col : col + cols])
    true = heights
    if rocks:
        rng = np.random.default_rng([seed, 4])
        width = whole.cell_width_m
        true = with_rocks(heights, whole.cell_size_m, rocks, rng, cell_width_m=width)
    with told_if_slow("preparing the ground"):
        actual = robot.of(replace(whole, elevation=true, georeference=read.georeference))
        if known is None:
            ground = SurveyedGround.of(actual, _SURVEY if body is None else 1, heights)
        else:
            ground = SurveyedGround.of_known(actual, *known)
    ground = replace(ground, origin=(row, col), north_deg=read.north_deg)
    if start and goal:
        begin, end = map(tuple, (ends - (row, col)).tolist())
    else:
        begin, end = random_drive(ground, seed)
    film = Film() if picture is not None and picture.suffix.lower() == ".gif" else None

    with ExitStack() as stack:

        def make_sinks(state: "MapState") -> "list[Sink]":
            sinks: list[Sink] = []
            if log is not None:
                made = stack.enter_context(closing(McapLog(log, state)))
                written[0] = str(made.path)
                sinks.append(made)
            if view is not None:
                sinks.append(stack.enter_context(closing(RerunSink(view, state))))
            return sinks

        try:
            with told_if_slow("driving"):
                drive = simulate(ground, begin, end, settings, make_sinks=make_sinks, watch=film)
        except InvalidQueryError as error:
            raise InvalidQueryError(
                f"{error}, on the part of the map from cell ({row}, {col}) on"
            ) from None
    if picture is not None and film is not None:
        film.save(picture)
    elif picture is not None:
        save_picture(picture, drive_picture(ground, drive))
    part = {"row": row, "col": col, "rows": rows, "cols": cols}
    result = drive.summary() | part
    for name, cell in (("start", drive.start), ("goal", drive.goal)):
        in_file = ground.in_file(cell)
        result |= {name: in_file, f"{name}_xy": whole.map_coordinates(*in_file)}
    result["files"] = written
    tell(as_json, result, lambda: text(drive, result, whole.source.name))
    if drive.forbidden or not (drive.reached or endless):
        click.get_current_context().exit(1)


def text(drive: "DriveOutcome", result: Row, name: str) -> str:
    """The result for people, on a part of the map of this name."""
    ticks = drive.counters
    degraded = ", ".join(f"{count} {kind}" for kind, count in sorted(ticks.degraded.items()))
    ended = "goal reached" if drive.reached else "GOAL NOT REACHED"
    if drive.goals > 1:
        ended = f"{drive.goals} goals reached"
    excess = "" if drive.excess is None else f": driven {100.0 * drive.excess:+.1f} %"
    lines = {
        ended: f"{drive.method}, {result['start']} to {result['goal']}",
        "map": "{rows} × {cols} cells of {name}, from cell ({row}, {col}) on".format(
            **result, name=name
        ),
        "in x, y": "({:.9g}, {:.9g}) to ({:.9g}, {:.9g})".format(
            *result["start_xy"], *result["goal_xy"]
        ),
        "ticks": f"{ticks.ticks}: {ticks.planned} planned, {ticks.kept} kept their path, "
        f"{ticks.failed} without one",
        "degraded": f"{degraded or 'none'}; {ticks.overruns} late",
        "answer": "p50 {p50:.2f}, p99 {p99:.2f}, max {max:.2f} ms".format(**drive.planning_ms),
        "driven": f"{drive.cells} cells, cost {drive.driven_cost:.6g}; stood still {drive.waited} "
        "times",
        "optimum": f"{drive.optimal_cost:.6g} with all known and no obstacle{excess}",
        "forbidden": f"{drive.forbidden} of the paths published",
        "memory": ", ".join(f"{when} {size:.0f}" for when, size in drive.memory_mb.items()) + " MB",
        "errors": ", ".join(f"{count} in {place}" for place, count in sorted(ticks.errors.items())),
        "written": ", ".join(result["files"]),
    }
    return aligned(lines)
