"""Prices of unseen ground: the rules, and how a large map is shown to the network."""

import numpy as np
import pytest

from nnpp_edge.runtime import Planner, Traversability
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.priors import prices_by, windows
from nnpp_edge.runtime.options import PRIORS
from nnpp_edge.runtime.tuning import MOST_PRICE
from nnpp_edge.terrain.dem import sample_dem

LIMIT20 = Traversability(slope_limit_deg=20.0, hard_slope_deg=20.0)


def hills(side: int) -> np.ndarray:
    """Lunar highlands, blocks of 160 m."""
    elevation = sample_dem("moon_highlands").rescaled(20.0).elevation
    return elevation.reshape(64, 8, 64, 8).mean(axis=(1, 3))[:side, :side]


@pytest.mark.parametrize("name", PRIORS)
@pytest.mark.parametrize("limits", [Traversability(), LIMIT20], ids=["soft", "limit20"])
def test_prices_are_finite_and_go_by_relative_heights_alone(name, limits):
    dem = hills(64)
    dem[10:14, 20:30] = np.nan
    prices = prices_by(name, dem, limits, 160.0, 8)
    assert prices.dtype == np.float32 and prices.shape == dem.shape
    assert ((prices >= 0.0) & (prices <= MOST_PRICE)).all()
    assert (prices[10:14, 20:30] == MOST_PRICE).all()
    assert prices_by(name, dem + np.float32(512.0), limits, 160.0, 8) == pytest.approx(
        prices, abs=0.02
    )


def test_steeper_blocks_cost_more_and_the_map_may_be_turned():
    dem = hills(40)
    prices = prices_by("slope", dem, LIMIT20, 160.0, 8)
    steep = np.hypot(*np.gradient(dem))
    assert np.corrcoef(steep.ravel(), prices.ravel())[0, 1] > 0.7
    turned = np.ascontiguousarray(np.rot90(dem))
    assert prices_by("slope", turned, LIMIT20, 160.0, 8) == pytest.approx(
        np.rot90(prices), abs=1e-4
    )


@pytest.mark.parametrize("name", PRIORS)
def test_prices_go_by_both_sides_of_a_block(name):
    plane = np.tile(30.0 * np.arange(40.0), (40, 1))
    prices = [
        Planner.of_coarse(dem, 160.0, 8, LIMIT20, prior=name, cell_width_m=width).state.unseen
        for dem, width in ((plane, 160.0), (4.0 * plane, 640.0))
    ]
    square, wide = (unseen.layers[0][15:25, 15:25] for unseen in prices)
    assert wide == pytest.approx(square, rel=0.1)


def test_networks_of_another_kind_are_refused():
    with pytest.raises(ModelError, match="prices unseen ground"):
        prices_by("network", hills(4), LIMIT20, 160.0, 8, "edge")


@pytest.mark.parametrize("cells", [1, 63, 64, 65, 100, 130, 300])
def test_windows_cover_each_block_once_and_leave_a_margin(cells):
    covered = np.zeros(cells, int)
    for begin, first, count in windows(cells, 64):
        covered[first : first + count] += 1
        assert begin <= first and first + count <= begin + 64
        assert first == 0 or first - begin >= 8
        assert first + count == cells or begin + 64 - first - count >= 8
    assert (covered == 1).all()
