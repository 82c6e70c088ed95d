"""`nnpp-edge costmap` on a map that is larger than memory: a band of rows after another."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.cli.cost_summary import SHARES, CostSummary, MapSize
from nnpp_edge.cli.options import TerrainOptions
from nnpp_edge.files import staged, write_whole
from nnpp_edge.progress import bar
from nnpp_edge.runtime.errors import InvalidQueryError, OutputError
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.runtime.terrain.traversability import TERMS, Traversability, terrain_terms
from nnpp_edge.runtime.terrain.windows import CostWindows
from nnpp_edge.terrain.rasters import geotiff_stream
from nnpp_edge.viz.picture import cost_map_picture, png_bytes

if TYPE_CHECKING:
    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.terrain.georeference import Place

_STEPS = 1 << 16
"""Costs are counted in so many steps from 0 to 1, for their quantiles."""
_MOST_PIXELS = 2000
"""Of the picture's longer side: as many as are drawn of any map."""


def write_by_windows(
    dem: Path, terrain: TerrainOptions, limits: Traversability, output: Path, picture: Path
) -> CostSummary:
    """Write cost map and picture; OutputError for what is no GeoTIFF."""
    if output.suffix.lower() not in (".tif", ".tiff"):
        raise InvalidQueryError(f"--output must end in .tif for a map that is read by windows, got {output.name!r}")
    with terrain.open(dem) as ground, staged(output) as temporary:
        costs, tally = CostWindows(ground, limits), Tally(ground, limits)
        with (
            refused_as(OutputError, f"{output}: could not be written"),
            bar("cost map", ground.shape[0]) as progress,
            geotiff_stream(temporary, ground.shape, ground.georeference) as write,
        ):
            for row, heights, cost in costs.bands():
                write(row, np.where(np.isfinite(cost), cost, np.float32(np.nan)))
                tally.add(row, heights, cost)
                progress(row + len(cost))
        drawn = cost_map_picture(tally.sample(), cell_size_m=ground.cell_width_m * tally.step)
        write_whole(picture, png_bytes(drawn))
    return tally.summary()


class Tally:
    """What a cost map holds, counted band by band.

    Parameters
    ----------
    place : Place
        The map.
    limits : Traversability
        At which its terms are full.
    """

    def __init__(self, place: Place, limits: Traversability) -> None:
        self._place = place
        self._limits = np.radians(limits.slope_limit_deg), limits.roughness_limit_m, limits.step_limit_m
        self._counts = np.zeros(_STEPS, np.int64)
        self._known, self._full = 0, np.zeros(len(TERMS), np.int64)
        self._sampled: list[Float2D] = []
        self.step = -(-max(place.shape) // _MOST_PIXELS)
        """Cells of the map to a pixel of the picture."""

    def add(self, row: int, heights: Float2D, cost: Float2D) -> None:
        """Count a band that begins at a row. At its rim the terms are those of a patch cut in two."""
        passable = cost[np.isfinite(cost)]
        self._counts += np.bincount((passable * _STEPS).astype(np.int32), minlength=_STEPS)
        self._sampled.append(cost[-row % self.step :: self.step, :: self.step].copy())
        size, width = self._place.cell_size_m, self._place.cell_width_m
        terms = terrain_terms(heights, size, cell_width_m=width)
        self._known += int(np.isfinite(terms[0]).sum())
        self._full += [int((term >= limit).sum()) for term, limit in zip(terms, self._limits, strict=True)]

    def sample(self) -> Float2D:
        """The cost of every so many-th cell, for a picture."""
        return np.concatenate(self._sampled)

    def summary(self) -> CostSummary:
        """Shares and quantiles; these are true to the step."""
        passable, cells = int(self._counts.sum()), self._place.shape[0] * self._place.shape[1]
        below = np.cumsum(self._counts)
        at = [int(np.searchsorted(below, share * (passable - 1), side="right")) for share in SHARES]
        quantiles = [round((step + 0.5) / _STEPS, 6) if passable else None for step in at]
        return CostSummary(
            MapSize.of(self._place),
            passable / cells,
            {f"{share:g}": quantile for share, quantile in zip(SHARES, quantiles, strict=True)},
            {name: round(int(n) / max(self._known, 1), 6) for name, n in zip(TERMS, self._full, strict=True)},
        )
