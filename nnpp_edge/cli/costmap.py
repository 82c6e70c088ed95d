"""`nnpp-edge costmap`: what crossing each cell of an elevation map costs."""

from pathlib import Path
from typing import Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import TerrainOptions
from nnpp_edge.cli.text import tell

_RASTERS = (".tif", ".tiff")
_ENDINGS = (*_RASTERS, ".npy", ".npz")
_BYTES_PER_CELL = 32
"""At the peak of writing a whole map: 28 measured."""


@options.command("costmap")
def command(
    dem: Annotated[Path, options.MAP],
    /,
    output: Annotated[Path, "-o", options.NEW_FILE, ".tif, .npy or .npz."],
    terrain: TerrainOptions,
    picture: Annotated[Path | None, options.NEW_FILE, "PNG; by default beside the output, under its name."] = None,
    memory: options.Memory = None,
    as_json: options.AsJson = False,
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
    if output.suffix.lower() not in _ENDINGS:
        raise click.UsageError(f"--output must end in {', '.join(_ENDINGS)}, got {output.name!r}")
    picture = picture or output.with_suffix(".png")
    if picture.suffix.lower() != ".png":
        raise click.UsageError(f"--picture must end in .png, got {picture.name!r}")
    options.check_outputs(("--output", output), ("--picture", picture))
    limits = terrain.limits()

    from nnpp_edge.cli.costmap_files import write_by_windows, write_whole
    from nnpp_edge.cli.maps import reads_by_windows
    from nnpp_edge.runtime.errors import InvalidQueryError

    if not reads_by_windows(dem, terrain, memory, _BYTES_PER_CELL):
        tally = write_whole(terrain.read(dem), limits, output, picture)
    elif output.suffix.lower() in _RASTERS:
        with terrain.open(dem) as ground:
            tally = write_by_windows(ground, limits, output, picture)
    else:
        raise InvalidQueryError(f"--output must end in .tif for a map that is read by windows, got {output.name!r}")
    files = [str(output), str(picture)]
    tell(as_json, tally.figures() | {"files": files}, lambda: tally.text(dem.name, files))
