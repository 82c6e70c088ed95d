"""Prices of unseen ground: the expected cost of crossing a block of a coarse map.

A block's price is in units of T a fine cell: a straight step through it costs L + 2 · 255 · ω ·
price. It is finite. Where a block is likely to hold impassable cells it is above 1, up to
`MOST_PRICE`: a way through it may turn out to be a dead end, which costs more than any ground.
Blocks of unknown elevation have that price.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import slices
from nnpp_edge.runtime.errors import InvalidQueryError, ModelError
from nnpp_edge.runtime.map.unseen import Unseen
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.unseen import MARGIN, encode_unseen, expected_by_slope, prices_of
from nnpp_edge.runtime.options import PRIORS
from nnpp_edge.runtime.terrain.traversability import Traversability, sides_of, terrain_terms
from nnpp_edge.runtime.tuning import BLOCKED_PRICE, MOST_PRICE


def set_prices(unseen: Unseen) -> None:
    """Price a coarse map's blocks by its prior, unless they are, before any cell is weighed; see
    `prices_by`.
    """
    if not unseen.priced:
        ground = unseen.ground
        height_m, width_m = (unseen.factor * side for side in ground.sides_m)
        unseen.layers[0] = prices_by(
            ground.prior,
            unseen.dem,
            ground.limits,
            height_m,
            unseen.factor,
            ground.prior_model,
            cell_width_m=width_m,
        )
        unseen.priced = True


def prices_by(
    prior: str,
    dem: Float2D,
    limits: Traversability,
    cell_size_m: float,
    factor: int,
    model: str | Path | NetworkModel = "unseen",
    *,
    cell_width_m: float | None = None,
) -> Float2D:
    """Price of each block of a coarse map, (H, W) float32 in [0, `MOST_PRICE`].

    `dem` are the means of `factor` × `factor` cells, metres, NaN where unknown; blocks have sides
    of `cell_size_m`, and of `cell_width_m` from column to column where they are not square. Only
    what is relative in the elevations counts. InvalidQueryError where there is no such prior;
    ModelError where the network's `model` cannot be loaded or is another kind.
    """
    if prior not in PRIORS:
        raise InvalidQueryError(f"prior must be one of {', '.join(PRIORS)}, got {prior!r}")
    sides_m = sides_of(cell_size_m, cell_width_m)
    if prior == "network":
        network = model if isinstance(model, NetworkModel) else NetworkModel(model)
        price = _by_network(network, dem, limits, sides_m, factor)
    else:
        slope = terrain_terms(dem, cell_size_m, cell_width_m=cell_width_m)[0]
        mean, blocked = expected_by_slope(slope, limits, factor)
        price = mean + np.float32(BLOCKED_PRICE) * blocked
    price = np.where(np.isfinite(dem), np.clip(price, 0.0, MOST_PRICE), MOST_PRICE)
    return price.astype(np.float32)


def _by_network(
    network: NetworkModel,
    dem: Float2D,
    limits: Traversability,
    sides_m: tuple[float, float],
    factor: int,
) -> NDArray[np.floating]:
    """Prices by a network; maps larger than its input are shown to it window by window."""
    if network.metadata.encoding != "unseen":
        raise ModelError(f"{network.path}: wanted a network that prices unseen ground, got another")
    out = np.empty(dem.shape, np.float32)
    side = network.metadata.input_size
    for top, row, rows in windows(dem.shape[0], side):
        for left, col, cols in windows(dem.shape[1], side):
            part = dem[top : top + side, left : left + side]
            missing = [(0, side - length) for length in part.shape]
            window = np.pad(part, missing, constant_values=np.nan)
            encode_unseen(window, limits, sides_m, factor, network.inputs["input"][0])
            here = slices((row - top, col - left, rows, cols))
            out[slices((row, col, rows, cols))] = prices_of(network.answers())[here]
    return out


def windows(cells: int, side: int) -> Iterator[tuple[int, int, int]]:
    """Windows of `side` that cover a length: where each begins, and from where how many of its
    cells are taken.
    """
    done = 0
    while done < cells:
        begin = max(0, min(done - MARGIN, cells - side))
        end = cells if begin + side >= cells else begin + side - MARGIN
        yield begin, done, end - done
        done = end
