"""Bands of colour on the map by what it costs to get there. With OpenCV alone."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.viz.picture import IMPASSABLE, cost_picture, mixed, with_obstacles
from nnpp_edge.viz.sheet import INK, Colour, MapDrawing, Picture

_STRENGTH = 0.5
_SHARP = 800
"""Pixels of the longer side up to which a map is enlarged."""


def reach_picture(
    cost: Float2D,
    field: Float2D,
    levels: Sequence[tuple[float, str]],
    start: tuple[int, int],
    *,
    shade: NDArray[np.uint8] | None = None,
    cell_size_m: float | None = None,
) -> Picture:
    """Bands of what can be reached at what cost, the nearest first, on the cost or the relief.

    `field` is (H, W) float32, the cost of getting to each cell, inf where that is not possible; `levels` say where
    each band ends, ascending, and what the legend says of it (ASCII); `shade`, (H, W) uint8 from `hillshade`, is
    drawn in place of the cost.
    """
    passable = cost < 1.0
    ground = cost_picture(cost) if shade is None else with_obstacles(shade, passable)
    band = np.searchsorted([level for level, _ in levels], field)
    colours = [_colour(at, len(levels)) for at in range(len(levels))]
    for at, colour in enumerate(colours):
        mask = band == at
        ground[mask] = mixed(ground[mask], _STRENGTH, colour)
    fine = math.ceil(_SHARP / max(cost.shape))  # pixels to a cell, so that lines between bands are thinner than cells
    ground = ground.repeat(fine, 0).repeat(fine, 1)
    edges = _edges(band.repeat(fine, 0).repeat(fine, 1))
    ground[edges & passable.repeat(fine, 0).repeat(fine, 1)] = INK
    drawing = MapDrawing(ground)
    drawing.square(drawing.at((start[0] * fine + fine // 2, start[1] * fine + fine // 2)))
    grey = np.full(3, 190 if shade is not None else 90, np.uint8)
    keys = [drawing.symbol_key(drawing.square, "start")]
    for colour, (_, words) in zip(colours, levels, strict=True):
        keys.append(drawing.swatch(tuple(mixed(grey, _STRENGTH, colour).tolist()), words))
    if not passable.all():
        keys.append(drawing.swatch(IMPASSABLE, "impassable"))
    return drawing.finish([keys, drawing.scale(None if cell_size_m is None else cell_size_m / fine)])


def _colour(at: int, count: int) -> Colour:
    """One of so many along a scale from dark to light."""
    place = np.array([[round(255 * (at + 0.5) / count)]], np.uint8)
    blue, green, red = cv2.applyColorMap(place, cv2.COLORMAP_PLASMA)[0, 0].tolist()
    return blue, green, red


def _edges(band: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Cells with one of a farther band to the right or below."""
    edges = np.zeros(band.shape, bool)
    edges[:-1] |= band[:-1] != band[1:]
    edges[:, :-1] |= band[:, :-1] != band[:, 1:]
    return edges
