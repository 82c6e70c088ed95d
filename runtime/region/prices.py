"""Prices of ground that nobody has seen, looked at again as more of it is."""

import numpy as np

from nnpp_edge.runtime.cells import Rectangle, slices, widened
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.priors import NetworkPrior, prior_named
from nnpp_edge.runtime.network.unseen import Seen
from nnpp_edge.runtime.tuning import PRICE_KEPT


class UnseenPrices:
    """Keeps the prices of a coarse map's blocks, by its ground's prior. Serves one thread at a time.

    InvalidQueryError where there is no such prior; ModelError where its network cannot be loaded.
    """

    def __init__(self, state: MapState) -> None:
        assert state.unseen is not None
        self._state, self._unseen, ground = state, state.unseen, state.unseen.ground
        side_m = ground.factor * ground.sides_m[0]
        self._prior = prior_named(ground.prior, ground.traversability, side_m, ground.factor, ground.prior_model)
        rows, cols = self._unseen.dem.shape
        self._set((0, 0, rows, cols))

    def look(self) -> Rectangle | None:
        """Have what was seen since the last time count; the blocks whose price, or cells, may be others now."""
        part = self._unseen.read(self._state.grid)
        if part is None or not isinstance(self._prior, NetworkPrior):
            return part
        part = widened(part, (self._prior.reach, self._prior.reach), self._unseen.dem.shape)
        self._set(part)
        return part

    def _set(self, part: Rectangle) -> None:
        """Price the blocks of a part anew."""
        unseen, (rows, cols) = self._unseen, slices(part)
        seen = Seen(unseen.mean[rows, cols], unseen.blocked[rows, cols], unseen.share[rows, cols])
        prices = self._prior.prices(unseen.dem[rows, cols], seen)
        self._state.price(part, prices, np.abs(prices - unseen.layers[0][rows, cols]) >= PRICE_KEPT)
