"""A coarse map to plan over block by block, each by what crossing it is expected to cost."""

from dataclasses import replace

import numpy as np

from nnpp_edge.runtime import Ground, Plan, Traversability
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.runtime.network.priors import prices_by
from nnpp_edge.runtime.tuning import PRICE_SCALE
from nnpp_edge.terrain.dem import Dem

_DEAREST = np.float32(0.999)
"""Cost that is shown of a block that counts as more: none is impassable."""


def ground_of_blocks(dem: Dem, limits: Traversability, factor: int, prior: str) -> tuple[Float2D, Ground, float]:
    """A map whose cells are blocks of `factor` × `factor` of the robot's own; errors as of `prices_by`.

    (H, W) prices in units of T, below 1, to be shown; a ground of prices divided by a scale, to be planned on with
    that much more weight; the scale.
    """
    prices = prices_by(prior, dem.elevation, limits, dem.cell_size_m, factor)
    return np.minimum(prices, _DEAREST), Ground(prices / np.float32(PRICE_SCALE)), PRICE_SCALE


def on_the_ground(plan: Plan, ground: Ground, scale: float) -> Plan:
    """A plan with the numbers along its way over known heights; the costs of its cells were divided by `scale`."""
    assert ground.elevation is not None and ground.mobility is not None
    along = Along.of(plan.line, ground.elevation, ground.sides_m, ground.mobility, plan.along)
    return replace(plan, along=along, traverse_cost=scale * plan.traverse_cost)
