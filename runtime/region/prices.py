"""Prices of ground that nobody has seen."""

from nnpp_edge.runtime.map.unseen import Unseen
from nnpp_edge.runtime.network.priors import prior_named


def set_prices(unseen: Unseen) -> None:
    """Price the blocks of a coarse map by its ground's prior, unless they are, before any of its cells are weighed.

    InvalidQueryError where there is no such prior; ModelError where its network cannot be loaded.
    """
    if not unseen.priced:
        ground, side_m = unseen.ground, unseen.factor * unseen.ground.sides_m[0]
        prior = prior_named(ground.prior, ground.traversability, side_m, unseen.factor, ground.prior_model)
        unseen.layers[0] = prior.prices(unseen.dem)
        unseen.priced = True
