"""`nnpp-edge simulate`: a robot that drives through the onboard loop, over ground that its map knows only roughly."""

import json
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nnpp_edge.cli import options, vehicle_options
from nnpp_edge.cli.options import COUNT, TerrainOptions
from nnpp_edge.cli.vehicle_options import VehicleOptions
from nnpp_edge.runtime.cells import Cell

if TYPE_CHECKING:
    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.runtime.loop.messages import PathMessage
    from nnpp_edge.runtime.loop.sinks import Sink
    from nnpp_edge.runtime.map.state import MapState
    from nnpp_edge.simulation.simulate import Drive
    from nnpp_edge.terrain.dem import Dem

_SAMPLE, _SAMPLE_RESCALE = "moon_highlands.npz", 20.0
_SURVEY = 8
"""Cells over which a point's first map is blurred by default."""
_CELLS_TO_A_BODY = 4.0
"""Cells of the sample along a vehicle."""
_METHODS = ("auto", "astar", "dstar", "corridor", "corridor-dstar", "nnpp", "nnpp-dstar")


@click.command(name="simulate")
@click.option("--map", "dem", type=options.MAP, help="Elevation map; by default the shipped lunar sample.")
@click.option(
    "--size",
    type=click.IntRange(16, options.MOST),
    default=256,
    help="Side of the part of the map, picked by the seed.",
)
@click.option("--start", type=options.Cell(), help="Cell of that part, row first; by default picked by the seed.")
@click.option("--goal", type=options.Cell(), help="Likewise.")
@click.option("--method", type=click.Choice(_METHODS), default="auto")
@options.model
@click.option("--rate", type=options.RATE, help="Ticks a second; else as fast as possible.")
@click.option("--ticks", type=COUNT, default=5000, help="At most.")
@click.option(
    "--changes",
    type=click.IntRange(0, 1000),
    default=1,
    help="Obstacles that appear, move or vanish between two ticks.",
)
@click.option(
    "--survey",
    type=click.IntRange(1, 1000),
    help="Blur the first map's heights over so many cells; 1: none. By default 8, and 1 with a vehicle.",
)
@click.option("--sight", type=COUNT, default=12, help="Cells to each side, beyond the body, that it sees.")
@click.option("--speed", type=COUNT, default=1, help="Cells a tick.")
@options.terrain
@options.step_cost
@vehicle_options.vehicle
@click.option("--rocks", type=options.Real(0.0, 0.2), default=0.0, help="Share of the ground under rocks.")
@options.seed
@click.option("--log", type=options.NEW_FILE, help="Write inputs and answers as MCAP with ROS 2 messages.")
@options.view
@click.option("--picture", type=options.NEW_FILE, help=".png of the way driven, or .gif of the drive.")
@options.as_json
def command(
    dem: Path | None,
    size: int,
    start: Cell | None,
    goal: Cell | None,
    survey: int | None,
    terrain: TerrainOptions,
    vehicle: VehicleOptions,
    step_cost: str,
    rocks: float,
    rate: float | None,
    seed: int,
    log: Path | None,
    view: str | None,
    picture: Path | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Drive a simulated robot to its goal through the onboard loop.

    The robot begins with a coarse survey of the terrain, sees the true cost of the cells around it, and walks
    along the newest path; obstacles of cost 1 appear, move and vanish. Every path is checked apart from the loop.
    With a vehicle these are heights, obstacles are higher than any step, and the body must stand wherever it goes.
    The survey shows no rocks.
    Exit codes: 0 at the goal, 1 where it was not reached or a path crossed a forbidden cell, 2 for wrong use.

    \b
    nnpp-edge simulate --workload limit20 --picture drive.gif --log drive.mcap
    nnpp-edge simulate --map dem.tif --vehicle small-rover --rocks 0.1 --picture drive.png
    """
    if (start is None) != (goal is None):
        raise click.UsageError("give both --start and --goal, or neither")

    from nnpp_edge.robot.transports.mcap_log import McapLog
    from nnpp_edge.robot.transports.rerun_view import RerunSink
    from nnpp_edge.runtime.map.ground import Ground
    from nnpp_edge.simulation.drive_picture import Film, check_name, save_drive
    from nnpp_edge.simulation.scene import Scene, SurveyedGround
    from nnpp_edge.simulation.simulate import SimulationSettings, random_drive, simulate

    settings = SimulationSettings(rate_hz=rate, seed=seed, **given)
    limits, body = terrain.limits(), vehicle.make()
    if picture is not None:
        check_name(picture)
    written = [file for file in (log, picture) if file is not None]
    options.check_outputs(
        ("--log", log), ("--picture", picture), ("--view", options.view_file(view)), make_folders=True
    )
    if dem is None:
        dem = Path(str(files("nnpp_edge.terrain") / "samples" / _SAMPLE))
        cell_m = _SAMPLE_RESCALE if body is None or body.is_disc else body.length_m / _CELLS_TO_A_BODY
        terrain = replace(terrain, rescale=terrain.rescale or cell_m)
    part = _part(terrain.read(dem), size, seed)
    survey = survey or (_SURVEY if body is None else 1)
    heights = _with_rocks(part, rocks, seed)
    ground = SurveyedGround.of(
        Ground.of_elevation(
            heights,
            part.cell_size_m,
            limits,
            cell_width_m=part.cell_width_m,
            vehicle=body,
            step_cost=step_cost,
            mobility=vehicle.mobility(part),
        ),
        survey,
        part.elevation,
    )
    if start is None or goal is None:
        start, goal = random_drive(ground, seed)
    film = Film() if picture is not None and picture.suffix.lower() == ".gif" else None
    scenes: list[Scene] = []

    def watch(scene: Scene, message: "PathMessage") -> None:
        scenes[:] = [scene]
        if film is not None:
            film(scene, message)

    with ExitStack() as stack:

        def make_sinks(state: "MapState") -> "list[Sink]":
            sinks: list[Sink] = []
            if log is not None:
                sinks.append(stack.enter_context(McapLog(log, state=state, cell_size_m=part.cell_size_m)))
            if view is not None:
                sinks.append(stack.enter_context(RerunSink.at(view, state)))
            return sinks

        drive = simulate(ground, start, goal, settings, make_sinks=make_sinks, watch=watch)
    if picture is not None:
        save_drive(picture, scenes[0], drive, film)
    rows, cols = ground.true.shape
    result = {**drive.summary(), "rows": rows, "cols": cols, "files": [str(file) for file in written]}
    click.echo(json.dumps(result) if as_json else text(drive, (rows, cols), written))
    if not drive.reached or drive.forbidden:
        click.get_current_context().exit(1)


def text(drive: "Drive", shape: tuple[int, int], written: Sequence[Path]) -> str:
    """The result for people."""
    times = ", ".join(f"{name} {drive.planning_ms[name]:.2f}" for name in ("p50", "p99", "max"))
    degraded = ", ".join(f"{count} {kind}" for kind, count in sorted(drive.counters.degraded.items())) or "none"
    excess = "" if drive.excess is None else f": driven {100.0 * drive.excess:+.1f} %"
    ticks = drive.counters
    lines = {
        "goal reached" if drive.reached else "GOAL NOT REACHED": f"{drive.method}, {drive.start} to {drive.goal}",
        "map": f"{shape[0]} × {shape[1]} cells",
        "ticks": f"{ticks.ticks}: {ticks.planned} planned, {ticks.kept} kept their path, {ticks.failed} without one",
        "degraded": f"{degraded}; {ticks.overruns} late",
        "answer": f"{times} ms",
        "driven": f"{len(drive.driven)} cells, cost {drive.driven_cost:.6g}; stood still {drive.waited} times",
        "optimum": f"{drive.optimal_cost:.6g} with all known and no obstacle{excess}",
        "forbidden": f"{drive.forbidden} of the paths published",
    }
    if ticks.errors:
        lines["errors"] = ", ".join(f"{count} in {place}" for place, count in sorted(ticks.errors.items()))
    if written:
        lines["written"] = ", ".join(map(str, written))
    width = max(map(len, lines)) + 2
    return "\n".join(f"{name:<{width}}{value}" for name, value in lines.items())


def _part(dem: "Dem", size: int, seed: int) -> "Dem":
    """A random part of the terrain."""
    import numpy as np

    (height, width), rng = dem.shape, np.random.default_rng([seed, 3])
    rows, cols = min(size, height), min(size, width)
    row, col = int(rng.integers(height - rows + 1)), int(rng.integers(width - cols + 1))
    return replace(dem, elevation=np.ascontiguousarray(dem.elevation[row : row + rows, col : col + cols]))


def _with_rocks(dem: "Dem", cover: float, seed: int) -> "Float2D":
    """The terrain's heights with rocks on a share of it."""
    import numpy as np

    from nnpp_edge.terrain.rocks import with_rocks

    if not cover:
        return dem.elevation
    rng = np.random.default_rng([seed, 4])
    return with_rocks(dem.elevation, dem.cell_size_m, cover, rng, cell_width_m=dem.cell_width_m)
