"""The part of a map that is driven on: where the seed puts it, and the ground there."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from nnpp_edge.runtime import Ground, Vehicle
from nnpp_edge.runtime.cells import Endpoints, Rectangle, slices
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.simulation.ground import SurveyedGround, reach_of
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.rocks import with_rocks

_SURVEY = 8
"""Cells over which a point's first map is blurred where no means of blocks are known."""


def part_of_map(
    whole: Dem,
    size: int,
    factor: int,
    vehicle: Vehicle | None,
    seed: int,
    ends: Endpoints | None = None,
) -> Rectangle:
    """A part of at most `size` cells to a side, a multiple of `factor`, where the seed puts it, or
    around both ends; InvalidQueryError where these lie outside the map, or too far apart.
    """
    shape = np.array([min(size, side) // factor * factor for side in whole.shape])
    most = np.subtract(whole.shape, shape)
    if ends is None:
        corner = np.random.default_rng([seed, 3]).integers(most + 1)
    else:
        places = np.array(ends)
        reach = reach_of(vehicle, (whole.cell_size_m, whole.cell_width_m))
        last = np.subtract(whole.shape, 1)
        first = np.maximum(places.min(0) - reach, 0)
        beyond = np.minimum(places.max(0) + reach, last)
        if ((places < 0) | (places > last) | (beyond - first >= shape)).any():
            rows, cols = whole.shape
            raise InvalidQueryError(
                f"--start and --goal, cells {places.tolist()}, must not lie outside the map of "
                f"{rows} × {cols} cells, nor further apart than --size {size} holds with {reach} "
                "cells around each"
            )
        # the ends lie around the part's middle
        corner = np.clip((first + beyond + 1 - shape) // 2, 0, most)
    row, col, rows, cols = np.concatenate((corner, shape)).tolist()
    return row, col, rows, cols


def ground_of_part(
    whole: Dem,
    part: Rectangle,
    ground_of: Callable[[Dem], Ground],
    rocks: float,
    seed: int,
    known: tuple[int, str] | None,
) -> SurveyedGround:
    """The ground there, with rocks on a share of it that the survey does not show; `known` are the
    side of blocks whose means are known, and what prices them.
    """
    heights = np.ascontiguousarray(whole.elevation[slices(part)])
    true = heights
    if rocks:
        rng = np.random.default_rng([seed, 4])
        width = whole.cell_width_m
        true = with_rocks(heights, whole.cell_size_m, rocks, rng, cell_width_m=width)
    actual = ground_of(replace(whole, elevation=true))
    if known is None:
        return SurveyedGround.of(actual, 1 if actual.vehicle else _SURVEY, heights)
    return SurveyedGround.of_known(actual, *known)
