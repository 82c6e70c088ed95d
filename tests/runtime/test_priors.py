"""Prices of unseen ground: the rules, how the network is shown a map, and that its answers are the ones it gave."""

import math

import numpy as np
import pytest

from nnpp_edge.runtime.errors import InvalidQueryError, ModelError
from nnpp_edge.runtime.network.model_file import UNSEEN
from nnpp_edge.runtime.network.priors import PRIORS, NetworkPrior, prior_named, windows
from nnpp_edge.runtime.network.unseen import Seen, encode_unseen
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.tuning import MOST_PRICE

LIMIT20 = Traversability(slope_limit_deg=20.0, hard_slope_deg=20.0)


def hills(side: int, seed: int = 1) -> np.ndarray:
    """Rough ground, blocks of 160 m."""
    rng = np.random.default_rng(seed)
    waves = rng.normal(size=(12, 4))
    rows, cols = np.mgrid[:side, :side] / 64.0
    return sum(
        40.0 * math.sin(c) * np.sin(6.0 * (a * rows + b * cols) + d) for a, b, c, d in waves
    ).astype(np.float32)  # fmt: skip


@pytest.mark.parametrize("name", PRIORS)
@pytest.mark.parametrize("limits", [Traversability(), LIMIT20], ids=["soft", "limit20"])
def test_prices_are_finite_and_go_by_relative_heights_alone(name, limits):
    prior, dem = prior_named(name, limits, 160.0, 8), hills(64)
    dem[10:14, 20:30] = np.nan
    prices = prior.prices(dem)
    assert prices.dtype == np.float32 and prices.shape == dem.shape
    assert ((prices >= 0.0) & (prices <= MOST_PRICE)).all()
    assert (prices[10:14, 20:30] == MOST_PRICE).all()
    assert prior.prices(dem + np.float32(512.0)) == pytest.approx(prices, abs=0.02)


def test_steeper_blocks_cost_more_and_the_map_may_be_turned():
    prior, dem = prior_named("slope", LIMIT20, 160.0, 8), hills(40)
    prices = prior.prices(dem)
    steep = np.hypot(*np.gradient(dem))
    assert np.corrcoef(steep.ravel(), prices.ravel())[0, 1] > 0.7
    assert prior.prices(np.ascontiguousarray(np.rot90(dem))) == pytest.approx(np.rot90(prices), abs=1e-4)


def test_unknown_names_and_networks_of_another_kind_are_refused():
    with pytest.raises(InvalidQueryError, match="prior must be one of"):
        prior_named("magic", LIMIT20, 160.0, 8)
    with pytest.raises(ModelError, match="prices unseen ground"):
        NetworkPrior("edge", LIMIT20, 160.0, 8)


@pytest.mark.parametrize("cells", [1, 63, 64, 65, 100, 130, 300])
def test_windows_cover_each_block_once_and_leave_a_margin(cells):
    covered = np.zeros(cells, int)
    for begin, first, count in windows(cells, 64):
        covered[first : first + count] += 1
        assert begin <= first and first + count <= begin + 64
        assert first == 0 or first - begin >= 8
        assert first + count == cells or begin + 64 - first - count >= 8
    assert (covered == 1).all()


def test_what_was_seen_is_shown_where_it_lies():
    dem, share = hills(24), np.zeros((24, 24), np.float32)
    share[3, 5] = 0.5
    out = np.empty((len(UNSEEN), 24, 24), np.float32)
    encode_unseen(dem, Seen(0.9 * (share > 0), 0.3 * (share > 0), share), LIMIT20, 160.0, 8, out)
    planes = dict(zip(UNSEEN, out, strict=True))
    assert np.argwhere(planes["seen"]).tolist() == np.argwhere(planes["seen_blocked"]).tolist() == [[3, 5]]
    assert planes["slope_down"] == pytest.approx(_soft(np.gradient(dem, axis=0)), abs=1e-4)
    assert planes["slope_across"] == pytest.approx(_soft(np.gradient(dem, axis=1)), abs=1e-4)


def _soft(rise: np.ndarray) -> np.ndarray:
    scaled = rise / (160.0 * math.tan(math.radians(20.0)))
    return scaled / (1.0 + np.abs(scaled))
