"""The files that `nnpp-edge costmap` writes, and what a cost map holds."""

import io
from pathlib import Path
from typing import Any

import numpy as np

from nnpp_edge.cli.maps import cost_of, size_in_words, size_of
from nnpp_edge.cli.text import aligned
from nnpp_edge.files import staged, write_all
from nnpp_edge.files import write_whole as write_file
from nnpp_edge.progress import bar
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.runtime.terrain.traversability import TERMS, Traversability, terrain_terms
from nnpp_edge.runtime.terrain.windows import CostWindows
from nnpp_edge.terrain.dem import Dem, DemWindows, raster_bytes
from nnpp_edge.terrain.georeference import Place
from nnpp_edge.terrain.rasters import geotiff_stream
from nnpp_edge.viz.picture import cost_map_picture, png_bytes

_SHARES = (0.1, 0.5, 0.9, 0.99)
"""Of the passable cells, whose greatest cost is told."""
_STEPS = 1 << 16
"""Costs are counted in so many steps from 0 to 1, for their quantiles."""
_MOST_PIXELS = 2000
"""Of the picture's longer side: as many as are drawn of any map."""


class Tally:
    """Counts of a cost map, band by band."""

    def __init__(self, place: Place, limits: Traversability) -> None:
        self.place = place
        self._limits = np.radians(limits.slope_limit_deg), limits.roughness_limit_m, limits.step_limit_m
        self._counts = np.zeros(_STEPS, np.int64)
        self._known, self._full = 0, np.zeros(len(TERMS), np.int64)

    def add(self, heights: Float2D, cost: Float2D) -> None:
        """Count a band. At its rim the terms are those of a patch cut in two."""
        passable = cost[np.isfinite(cost)]
        self._counts += np.bincount((passable * _STEPS).astype(np.int32), minlength=_STEPS)
        terms = terrain_terms(heights, self.place.cell_size_m, cell_width_m=self.place.cell_width_m)
        self._known += int(np.isfinite(terms[0]).sum())
        self._full += [int((term >= limit).sum()) for term, limit in zip(terms, self._limits, strict=True)]

    def figures(self) -> dict[str, Any]:
        """Share that is passable, costs that shares of these cells do not pass, and shares at a term's limit."""
        (rows, cols), below = self.place.shape, np.cumsum(self._counts)
        passable = int(below[-1])
        at = np.searchsorted(below, np.array(_SHARES) * (passable - 1), side="right")
        costs = [round((step + 0.5) / _STEPS, 6) if passable else None for step in at.tolist()]
        full = (self._full / max(self._known, 1)).round(6).tolist()
        return size_of(self.place) | {
            "passable_share": passable / (rows * cols),
            "cost_quantiles": {f"{share:g}": cost for share, cost in zip(_SHARES, costs, strict=True)},
            "saturated_share": dict(zip(TERMS, full, strict=True)),
        }

    def text(self, name: str, files: list[str]) -> str:
        found = self.figures()
        costs = ((100 * float(share), cost) for share, cost in found["cost_quantiles"].items() if cost is not None)
        cost = ", ".join(f"{share:.0f} % of cells up to {cost:.3f}" for share, cost in costs)
        full = (f"{term} {100 * share:.1f} %" for term, share in found["saturated_share"].items())
        lines = {
            "map": f"{name}: {size_in_words(self.place)}",
            "passable": f"{100 * found['passable_share']:.2f} % of cells",
            "cost": cost or "no cell is passable",
            "at limit": ", ".join(full),
            "written": ", ".join(files),
        }
        return aligned(lines)


def write_whole(dem: Dem, limits: Traversability, output: Path, picture: Path) -> Tally:
    """Write cost map and picture of a map in memory: both, or none."""
    cost, tally = cost_of(dem, limits), Tally(dem, limits)
    drawn = png_bytes(cost_map_picture(cost, cell_size_m=dem.cell_width_m))
    write_all({output: _content(output, cost, dem), picture: drawn})
    tally.add(dem.elevation, cost)
    return tally


def write_by_windows(ground: DemWindows, limits: Traversability, output: Path, picture: Path) -> Tally:
    """Write cost map, a GeoTIFF, and picture, a band after another."""
    tally, sampled = Tally(ground, limits), []
    step = -(-max(ground.shape) // _MOST_PIXELS)
    with staged(output) as temporary:
        with (
            refused_as(OutputError, f"{output}: could not be written"),
            bar("cost map", ground.shape[0]) as progress,
            geotiff_stream(temporary, ground.shape, ground.georeference) as write,
        ):
            for row, heights, cost in CostWindows(ground, limits).bands():
                write(row, _with_nodata(cost))
                tally.add(heights, cost)
                sampled.append(cost[-row % step :: step, ::step].copy())
                progress(row + len(cost))
        drawn = cost_map_picture(np.concatenate(sampled), cell_size_m=ground.cell_width_m * step)
        write_file(picture, png_bytes(drawn))
    return tally


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
