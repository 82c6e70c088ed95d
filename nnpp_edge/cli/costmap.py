"""`nnpp-edge costmap`: what crossing each cell of an elevation map costs."""

import io
from pathlib import Path
from typing import Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import TerrainOptions
from nnpp_edge.cli.text import aligned, tell

_RASTERS = (".tif", ".tiff")
_ENDINGS = (*_RASTERS, ".npy", ".npz")


@options.command("costmap")
def command(
    dem: Annotated[Path, options.MAP],
    /,
    output: Annotated[Path, "-o", options.NEW_FILE, ".tif, .npy or .npz."],
    terrain: TerrainOptions,
    as_json: options.AsJson = False,
) -> None:
    """Write the traversability cost of an elevation map, and a PNG picture of it.

    Costs lie in [0, 1). A GeoTIFF keeps the DEM's georeference; its impassable cells are NaN,
    declared as nodata. In .npy and .npz (arrays cost, cell_size_m, cell_width_m) they are inf. In
    the picture, browner is costlier and impassable cells are dark.

    \b
    nnpp-edge costmap dem.tif -o cost.tif --workload limit20
    """
    kind = output.suffix.lower()
    if kind not in _ENDINGS:
        raise click.UsageError(f"--output must end in {', '.join(_ENDINGS)}, got {output.name!r}")
    picture = output.with_suffix(".png")
    files = [output, picture]
    if not options.can_draw(picture):
        files.remove(picture)
    options.check_outputs(*(("--output", path) for path in files))
    terrain.limits()  # those that make no sense are refused before any work

    import numpy as np

    from nnpp_edge.cli.maps import chart_of, cost_of, size_in_words, size_of
    from nnpp_edge.files import write_all
    from nnpp_edge.terrain.rasters import raster_bytes
    from nnpp_edge.viz.picture import MapDrawing, encoded

    ground = terrain.read(dem)
    cost = cost_of(ground, terrain.limits(ground))
    passable = np.isfinite(cost)
    content = io.BytesIO()
    if kind in _RASTERS:
        nodata = np.float32(np.nan)
        content.write(raster_bytes(output, np.where(passable, cost, nodata), ground))
    elif kind == ".npy":
        np.save(content, cost)
    else:
        size = ground.cell_size_m
        width = ground.cell_width_m
        np.savez_compressed(content, cost=cost, cell_size_m=size, cell_width_m=width)
    contents = {output: content.getvalue()}
    if picture in files:
        contents[picture] = encoded(MapDrawing(chart_of(ground, cost)).finish())
    write_all(contents)

    share = float(passable.mean())
    written = [str(path) for path in files]
    figures = size_of(ground) | {"passable_share": share, "files": written}
    lines = {
        "map": f"{dem.name}: {size_in_words(ground)}",
        "passable": f"{100 * share:.2f} % of cells",
        "written": ", ".join(written),
    }
    tell(as_json, figures, lambda: aligned(lines))
