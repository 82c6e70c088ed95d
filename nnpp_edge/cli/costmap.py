"""`nnpp-edge costmap`: what crossing each cell of an elevation map costs."""

import io
import math
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import TerrainOptions
from nnpp_edge.cli.text import aligned, tell

if TYPE_CHECKING:
    from collections.abc import Iterator

    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.terrain.dem import Dem, DemWindows

_RASTERS = (".tif", ".tiff")
_ENDINGS = (*_RASTERS, ".npy", ".npz")
_BYTES_PER_CELL = 32
"""At the peak of writing a whole map: 28 measured."""
_MOST_PIXELS = 2000
"""Of the picture's longer side: as many as are drawn of any map."""


@options.command("costmap")
def command(
    dem: Annotated[Path, options.MAP],
    /,
    output: Annotated[Path, "-o", options.NEW_FILE, ".tif, .npy or .npz."],
    terrain: TerrainOptions,
    memory: options.Memory = None,
    as_json: options.AsJson = False,
) -> None:
    """Write the traversability cost of an elevation map, and a PNG picture of it.

    Costs lie in [0, 1). A GeoTIFF keeps the DEM's georeference; its impassable cells are NaN,
    declared as nodata. In .npy and .npz (arrays cost, cell_size_m, cell_width_m) they are inf. In
    the picture, browner is costlier and impassable cells are dark.

    A raster too large for the memory that is free, or for --memory, is read by windows; its cost
    map is written as a GeoTIFF, a band after another.

    \b
    nnpp-edge costmap dem.tif -o cost.tif --workload limit20
    """
    if output.suffix.lower() not in _ENDINGS:
        raise click.UsageError(f"--output must end in {', '.join(_ENDINGS)}, got {output.name!r}")
    picture = output.with_suffix(".png")
    options.check_outputs(("--output", output), ("--output", picture))
    terrain.limits()  # those that make no sense are refused before any work

    from nnpp_edge.cli.maps import reads_by_windows, size_in_words, size_of
    from nnpp_edge.runtime.errors import InvalidQueryError
    from nnpp_edge.terrain.dem import open_dem

    by_windows = reads_by_windows(dem, memory, _BYTES_PER_CELL)
    if by_windows and output.suffix.lower() not in _RASTERS:
        raise InvalidQueryError(
            f"--output must end in .tif for a map that is read by windows, got {output.name!r}"
        )
    opened = open_dem(dem, terrain.cell_size) if by_windows else nullcontext(terrain.read(dem))
    with opened as ground:
        share = _write(ground, terrain.limits(ground), output, picture)
    files = [str(output), str(picture)]
    lines = {
        "map": f"{dem.name}: {size_in_words(ground)}",
        "passable": f"{100 * share:.2f} % of cells",
        "written": ", ".join(files),
    }
    tell(
        as_json, size_of(ground) | {"passable_share": share, "files": files}, lambda: aligned(lines)
    )


def _write(
    ground: "Dem | DemWindows", limits: "Traversability", output: Path, picture: Path
) -> float:
    """Write cost map and picture; the share of cells that are passable.

    Of a map in memory both or none are written; one read by windows becomes a GeoTIFF, a band after
    another.
    """
    import numpy as np

    from nnpp_edge.cli.maps import chart_of, cost_of
    from nnpp_edge.files import staged, write_all, write_whole
    from nnpp_edge.progress import bar
    from nnpp_edge.runtime.errors import OutputError
    from nnpp_edge.runtime.reading import refused_as
    from nnpp_edge.terrain.dem import Dem
    from nnpp_edge.terrain.rasters import geotiff_stream, raster_bytes
    from nnpp_edge.viz.picture import Chart, png_bytes

    nodata = np.float32(np.nan)
    if isinstance(ground, Dem):
        cost = cost_of(ground, limits)
        content = io.BytesIO()
        if output.suffix.lower() in _RASTERS:
            content.write(raster_bytes(output, np.where(np.isfinite(cost), cost, nodata), ground))
        elif output.suffix.lower() == ".npy":
            np.save(content, cost)
        else:
            size = ground.cell_size_m
            width = ground.cell_width_m
            np.savez_compressed(content, cost=cost, cell_size_m=size, cell_width_m=width)
        drawn = chart_of(ground, cost).picture()
        write_all({output: content.getvalue(), picture: png_bytes(drawn)})
        return float(np.isfinite(cost).mean())
    passable = 0
    sampled = []
    heights = []
    step = -(-max(ground.shape) // _MOST_PIXELS)
    with staged(output) as temporary:
        with (
            refused_as(OutputError, f"{output}: could not be written"),
            bar("cost map", ground.shape[0]) as progress,
            geotiff_stream(temporary, ground.shape, ground.georeference) as write,
        ):
            for row, elevation, cost in _bands(ground, limits):
                write(row, np.where(np.isfinite(cost), cost, nodata))
                passable += int(np.isfinite(cost).sum())
                every = (slice(-row % step, None, step), slice(None, None, step))
                sampled.append(cost[every].copy())
                heights.append(elevation[every].copy())
                progress(row + len(cost))
        sides_m = (ground.cell_size_m * step, ground.cell_width_m * step)
        chart = Chart(np.concatenate(sampled), np.concatenate(heights), sides_m, ground.north_deg)
        drawn = chart.picture()
        write_whole(picture, png_bytes(drawn))
    return passable / math.prod(ground.shape)


def _bands(
    ground: "DemWindows", limits: "Traversability"
) -> "Iterator[tuple[int, Float2D, Float2D]]":
    """First row, heights and costs of bands of rows, from top to bottom; a cell's cost depends on
    its neighbours.
    """
    from nnpp_edge.runtime.terrain.traversability import traversability_cost

    sides = (ground.cell_size_m, ground.cell_width_m)
    for row, col, rows, cols in ground.bands():
        above = min(row, 1)
        below = min(ground.shape[0] - row - rows, 1)
        heights = ground.read((row - above, col, above + rows + below, cols))
        cost = traversability_cost(heights, sides[0], limits, cell_width_m=sides[1], warn=False)
        yield row, heights[above : above + rows], cost[above : above + rows]
