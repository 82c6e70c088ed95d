"""`nnpp-edge plan`: a path over an elevation map."""

import warnings
from pathlib import Path
from typing import Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import GroundOptions
from nnpp_edge.cli.requests import PlanRequest
from nnpp_edge.cli.text import tell
from nnpp_edge.runtime.compiled.notice import told_if_slow
from nnpp_edge.runtime.errors import optional_module
from nnpp_edge.runtime.options import PlanOptions, StepOptions

_FILES = ("path.geojson", "path.csv", "plan.png", "plan.json")
_BYTES_PER_CELL = 24
"""At the peak of planning on a whole map: 19 to 23 measured, the most by `nnpp`
(docs/decisions/maps.md).
"""


@options.command("plan")
def command(
    dem: Annotated[Path, options.MAP],
    /,
    request: PlanRequest,
    query: PlanOptions,
    steps: StepOptions,
    robot: GroundOptions,
    model: options.Model = "edge",
    output: Annotated[
        Path | None,
        "-o",
        options.PATH,
        "Folder for path.geojson, path.csv, plan.png and plan.json.",
    ] = None,
    memory: options.Memory = None,
    as_json: options.AsJson = False,
) -> None:
    """Plan a path over the elevation map DEM, a file or sample:NAME (such as moon_highlands or
    mars_victoria).

    Give start and goal as cells, in the map's coordinates, or as longitude and latitude. The time
    shown includes the stages `kernels`, loading compiled code, and `load`, waiting for the network,
    whose file is opened meanwhile; with --compare and --time-limit these are loaded first. Exit
    codes: 0 for a path, 1 for NO_PATH or TIMEOUT, 2 where start or goal lies outside the map or is
    impassable.

    A limit of slope is on the plane through a cell and its eight neighbours, not on a single step
    from cell to cell: a warning counts the steps of the path that are steeper.

    path.geojson is in the map's own coordinates, not in longitude and latitude; its properties say
    which. Without a georeference they are x = column and y = row, times the side of a cell, in
    metres.

    A raster too large for the memory that is free, or for --memory, is read by windows, and planned
    on by the corridor method alone.

    \b
    nnpp-edge plan dem.tif --start 20,30 --goal 380,360 --workload limit20 -o plan
    """
    robot.limits()  # those that make no sense are refused before any work
    names = [*_FILES]
    if request.gpkg:
        if output is None:
            raise click.UsageError("--gpkg needs -o")
        optional_module("pyogrio", "--gpkg", "vector")
        names.append("path.gpkg")
    if output is not None and not options.can_draw("plan.png"):
        names.remove("plan.png")
    paths = options.files_in(output, names)

    with told_if_slow("loading the package"):
        from nnpp_edge.cli.maps import reads_by_windows
        from nnpp_edge.cli.planning import plan_on
        from nnpp_edge.runtime.memory import DIRECTED_BYTES_PER_CELL

    directed = robot.step_cost != "paper"
    body = robot.body()
    per_cell = (
        _BYTES_PER_CELL + (body.bytes_per_cell if body else 0) + DIRECTED_BYTES_PER_CELL * directed
    )
    whole = directed or body is not None
    large = request.crop is None and reads_by_windows(dem, memory, per_cell, whole=whole)
    answer = plan_on(
        request, query, steps, dem, robot, model=model, drawn=output is not None, large=large
    )
    answer.warn_if_close()
    if model != "edge" and answer.plan.method != "nnpp":
        warnings.warn(
            f"--model {model} was not used, as the path is by {answer.plan.method}: --method nnpp "
            "runs the network",
            stacklevel=2,
        )
    with told_if_slow("drawing and writing"):
        files = answer.save(paths)
    tell(as_json, answer.figures(files), lambda: answer.text(files))
    if not answer.plan.ok:
        click.get_current_context().exit(1)
