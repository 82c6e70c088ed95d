"""The files that `nnpp-edge costmap` writes."""

import io
import math
from pathlib import Path

import numpy as np

from nnpp_edge.cli.maps import cost_of
from nnpp_edge.files import staged, write_all, write_whole
from nnpp_edge.progress import bar
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.windows import CostWindows
from nnpp_edge.terrain.dem import Dem, DemWindows
from nnpp_edge.terrain.rasters import geotiff_stream, raster_bytes
from nnpp_edge.viz.picture import cost_map_picture, png_bytes

_MOST_PIXELS = 2000
"""Of the picture's longer side: as many as are drawn of any map."""


def write_cost_map(ground: Dem | DemWindows, limits: Traversability, output: Path, picture: Path) -> float:
    """Write cost map and picture; the share of cells that are passable.

    Of a map in memory both or none are written; one read by windows becomes a GeoTIFF, a band after another.
    """
    if isinstance(ground, Dem):
        cost = cost_of(ground, limits)
        drawn = cost_map_picture(cost, cell_size_m=ground.cell_width_m)
        write_all({output: _content(output, cost, ground), picture: png_bytes(drawn)})
        return float(np.isfinite(cost).mean())
    passable, sampled = 0, []
    step = -(-max(ground.shape) // _MOST_PIXELS)
    with staged(output) as temporary:
        with (
            refused_as(OutputError, f"{output}: could not be written"),
            bar("cost map", ground.shape[0]) as progress,
            geotiff_stream(temporary, ground.shape, ground.georeference) as write,
        ):
            for row, _, cost in CostWindows(ground, limits).bands():
                write(row, _with_nodata(cost))
                passable += int(np.isfinite(cost).sum())
                sampled.append(cost[-row % step :: step, ::step].copy())
                progress(row + len(cost))
        drawn = cost_map_picture(np.concatenate(sampled), cell_size_m=ground.cell_width_m * step)
        write_whole(picture, png_bytes(drawn))
    return passable / math.prod(ground.shape)


def _with_nodata(cost: Float2D) -> Float2D:
    return np.where(np.isfinite(cost), cost, np.float32(np.nan))


def _content(output: Path, cost: Float2D, dem: Dem) -> bytes:
    """The cost in the format that the name's ending asks for."""
    content, ending = io.BytesIO(), output.suffix.lower()
    if ending not in (".npy", ".npz"):
        return raster_bytes(output, _with_nodata(cost), dem)
    if ending == ".npy":
        np.save(content, cost)
    else:
        np.savez_compressed(content, cost=cost, cell_size_m=dem.cell_size_m, cell_width_m=dem.cell_width_m)
    return content.getvalue()
