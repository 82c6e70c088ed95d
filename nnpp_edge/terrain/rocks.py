"""Boulders on an elevation map, by the size-frequency law of Golombek & Rapp."""

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from nnpp_edge.runtime.arrays import Float2D, Floats, as_map
from nnpp_edge.runtime.cells import Shape
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.terrain.traversability import sides_of
from nnpp_edge.terrain.georeference import Sides

MOST_COVER = 0.2
"""Largest share of the ground that rocks cover; the law was fitted below it."""
HEIGHT = 0.5
"""Of a rock, as a share of its diameter: half a ball, as Golombek et al. take it for
landing sites.
"""
_LEAST_M = 0.2
_LEAST_CELLS = 0.5
"""Smaller rocks are left out by default: no obstacle, or less than a fifth of a cell."""
_GREATEST_M = 3.0
"""Larger rocks cover less than 0.01 % of the ground even at the largest share."""
_TABLE = 4096
"""Diameters at which the law is tabulated: counts are right to four digits or better."""


class Rocks(NamedTuple):
    """Where rocks lie, and how large they are."""

    places: Floats
    """(N, 2) of their middles in cells, (row, col); 0 is the middle of the first cell."""
    diameters_m: Floats


def covered_share(cover: float, diameter_m: ArrayLike) -> Floats:
    """Share of the ground that rocks of this diameter and more cover, where all rocks cover the
    share `cover`.

    Golombek & Rapp, Size-frequency distributions of rocks on Mars and Earth analog sites, J.
    Geophys. Res. 102 (E2), 1997: F_k(D) = k exp(-q(k) D), q(k) = 1.79 + 0.152 / k, with D in
    metres.
    """
    if not 0.0 <= cover <= MOST_COVER:
        raise InvalidQueryError(
            f"rocks must cover a share of the ground from 0 to {MOST_COVER}, got {cover}"
        )
    diameters = np.asarray(diameter_m, np.float64)
    if cover == 0.0:
        return np.zeros_like(diameters)
    with np.errstate(under="ignore"):
        return np.asarray(cover * np.exp(-(1.79 + 0.152 / cover) * diameters))


def draw_rocks(
    shape: Shape,
    sides_m: Sides,
    cover: float,
    rng: Generator | int,
    diameters_m: tuple[float, float],
) -> Rocks:
    """Rocks at random places of a map of (H, W) cells of these (height, width), as many as the law
    has on average.
    """
    rng = np.random.default_rng(rng)
    if not 0.0 < diameters_m[0] < diameters_m[1] < math.inf:
        wanted = "rocks' diameters must be positive and in order, metres"
        raise InvalidQueryError(f"{wanted}, got {diameters_m[0]:g} and {diameters_m[1]:g}")
    table = np.geomspace(*diameters_m, _TABLE)
    shares = covered_share(cover, table)
    # on a square metre, from the least diameter up to each
    areas = 0.25 * math.pi * table[:-1] * table[1:]
    between = np.maximum(shares[:-1] - shares[1:], 0.0) / areas
    numbers = np.concatenate(((0.0,), np.cumsum(between)))
    on_map = numbers[-1] * math.prod(shape) * math.prod(sides_m)
    count = int(rng.poisson(on_map))
    places = rng.random((count, 2)) * shape - 0.5
    drawn = rng.random(count) * numbers[-1]
    return Rocks(places, np.interp(drawn, numbers, table))


def with_rocks(
    dem: ArrayLike,
    cell_size_m: float,
    cover: float,
    rng: Generator | int,
    *,
    cell_width_m: float | None = None,
) -> Float2D:
    """An elevation map (metres, NaN where unknown) with rocks on it: a new (H, W) float32 array.

    A rock is half a ball that lies on the ground. It raises every cell that it touches by its
    greatest height over that cell, so that none is lost between cells' middles; where rocks
    overlap, the highest counts. The share `cover` of the ground, from 0 to 0.2, lies under rocks of
    any size: the law's k. Drawn are rocks of 0.2 m, or half a cell if that is more, to 3 m.
    InvalidQueryError on cells of more than 6 m.
    """
    heights = as_map(dem, "dem")
    sides = sides_of(cell_size_m, cell_width_m)
    least = max(_LEAST_M, _LEAST_CELLS * max(sides))
    rocks = draw_rocks(heights.shape, sides, cover, rng, (least, _GREATEST_M))
    return heights + rock_heights(heights.shape, sides, rocks)


def rock_heights(shape: Shape, sides_m: Sides, rocks: Rocks) -> Float2D:
    """(H, W) metres by which rocks raise the cells of a map."""
    out = np.zeros(shape, np.float32)
    for middle, radius in zip(rocks.places, 0.5 * rocks.diameters_m, strict=True):
        # the map's cells that it touches, and how far their nearest points are
        reach = 0.5 + radius / np.array(sides_m)
        first = np.maximum(np.ceil(middle - reach).astype(np.int64), 0)
        end = np.floor(middle + reach).astype(np.int64) + 1
        part = out[tuple(map(slice, first, end))]
        down, across = (
            np.maximum(np.abs(at + np.arange(count) - place) - 0.5, 0.0) * side
            for at, count, place, side in zip(first, part.shape, middle, sides_m, strict=True)
        )
        rest = radius**2 - down[:, None] ** 2 - across**2
        raised = 2.0 * HEIGHT * np.sqrt(np.maximum(rest, 0.0))
        np.maximum(part, raised.astype(np.float32), out=part)
    return out
