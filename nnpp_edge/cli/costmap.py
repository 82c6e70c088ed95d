"""`nnpp-edge costmap`: what crossing each cell of an elevation map costs."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import TerrainOptions
from nnpp_edge.cli.text import aligned, tell

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
    memory: options.Memory = None,
    as_json: options.AsJson = False,
) -> None:
    """Write the traversability cost of an elevation map, and a PNG picture of it.

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
    picture = output.with_suffix(".png")
    options.check_outputs(("--output", output), ("--output", picture))
    limits = terrain.limits()

    from nnpp_edge.cli.costmap_files import write_cost_map
    from nnpp_edge.cli.maps import reads_by_windows, size_in_words, size_of
    from nnpp_edge.runtime.errors import InvalidQueryError

    by_windows = reads_by_windows(dem, memory, _BYTES_PER_CELL)
    if by_windows and output.suffix.lower() not in _RASTERS:
        raise InvalidQueryError(f"--output must end in .tif for a map that is read by windows, got {output.name!r}")
    with terrain.open(dem) if by_windows else nullcontext(terrain.read(dem)) as ground:
        share = write_cost_map(ground, limits, output, picture)
    files = [str(output), str(picture)]
    lines = {
        "map": f"{dem.name}: {size_in_words(ground)}",
        "passable": f"{100 * share:.2f} % of cells",
        "written": ", ".join(files),
    }
    tell(as_json, size_of(ground) | {"passable_share": share, "files": files}, lambda: aligned(lines))
