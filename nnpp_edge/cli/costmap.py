"""`nnpp-edge costmap`: what crossing each cell of an elevation map costs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.cost_summary import CostSummary
from nnpp_edge.cli.options import TerrainOptions

if TYPE_CHECKING:
    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.terrain.dem import Dem

_RASTERS = (".tif", ".tiff")
_ARRAYS = (".npy", ".npz")
_BYTES_PER_CELL = 32
"""At the peak of writing a whole map: 28 measured."""


@click.command(name="costmap")
@click.argument("dem", type=options.MAP)
@click.option("-o", "--output", type=options.NEW_FILE, required=True, help=".tif, .npy or .npz.")
@click.option("--picture", type=options.NEW_FILE, help="PNG; by default beside the output, under its name.")
@options.terrain
@options.memory
@options.as_json
def command(
    dem: Path, output: Path, picture: Path | None, as_json: bool, terrain: TerrainOptions, memory: float | None
) -> None:
    """Write the traversability cost of an elevation map, and a picture of it.

    Costs lie in [0, 1). A GeoTIFF keeps the DEM's georeference; its impassable cells are NaN, declared as
    nodata. In .npy and .npz (arrays cost, cell_size_m, cell_width_m) they are inf. In the picture, whiter is
    costlier and impassable cells are brown.

    A raster too large for the memory that is free, or for --memory, is read by windows; its cost map is written as a
    GeoTIFF, a band after another.

    \b
    nnpp-edge costmap dem.tif -o cost.tif --workload limit20
    """
    picture = _picture_of(output, picture)
    options.check_outputs(("--output", output), ("--picture", picture))
    limits = terrain.limits()

    from nnpp_edge.cli.windows import reads_by_windows

    if reads_by_windows(dem, terrain, memory, _BYTES_PER_CELL):
        from nnpp_edge.cli.costmap_windows import write_by_windows

        summary = write_by_windows(dem, terrain, limits, output, picture)
    else:
        summary = _write_whole_map(dem, terrain, limits, output, picture)
    files = [str(output), str(picture)]
    click.echo(json.dumps({**summary.figures(), "files": files}) if as_json else summary.text(dem, files))


def _write_whole_map(
    dem: Path, terrain: TerrainOptions, limits: Traversability, output: Path, picture: Path
) -> CostSummary:
    """Write cost map and picture of a map that is read into memory."""
    from nnpp_edge.cli.costmap_windows import Tally
    from nnpp_edge.files import write_all
    from nnpp_edge.viz.picture import cost_map_picture, png_bytes

    ground = terrain.read(dem)
    cost = cost_of(ground, limits)
    drawn = png_bytes(cost_map_picture(cost, cell_size_m=ground.cell_width_m))
    write_all({output: _content(output, cost, ground), picture: drawn})
    tally = Tally(ground, limits)
    tally.add(0, ground.elevation, cost)
    return tally.summary()


def cost_of(dem: Dem, limits: Traversability) -> Float2D:
    """The cost map of an elevation map."""
    from nnpp_edge.runtime.terrain.traversability import traversability_cost

    return traversability_cost(dem.elevation, dem.cell_size_m, limits, cell_width_m=dem.cell_width_m)


def _picture_of(output: Path, picture: Path | None) -> Path:
    """The picture's name; UsageError for names that say no format."""
    ending = output.suffix.lower()
    if ending not in _RASTERS + _ARRAYS:
        raise click.UsageError(f"--output must end in {', '.join(_RASTERS + _ARRAYS)}, got {output.name!r}")
    picture = picture or output.with_suffix(".png")
    if picture.suffix.lower() != ".png":
        raise click.UsageError(f"--picture must end in .png, got {picture.name!r}")
    return picture


def _content(output: Path, cost: Float2D, dem: Dem) -> bytes:
    """The cost in the format that the name's ending asks for."""
    import io

    import numpy as np

    from nnpp_edge.terrain.dem import raster_bytes

    if output.suffix.lower() in _RASTERS:
        return raster_bytes(output, np.where(np.isfinite(cost), cost, np.float32(np.nan)), dem)
    content = io.BytesIO()
    if output.suffix.lower() == ".npy":
        np.save(content, cost)
    else:
        np.savez_compressed(content, cost=cost, cell_size_m=dem.cell_size_m, cell_width_m=dem.cell_width_m)
    return content.getvalue()
