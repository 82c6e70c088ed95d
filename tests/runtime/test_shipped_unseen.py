"""The shipped network `unseen`, on a sample map: bounds that turned, mirrored, shuffled or halved answers break.

Measured, errors of prices under `soft` and `limit20`: 0.029 and 0.24; by the slope 0.064 and 0.82; answers turned
0.45 and 2.1, mirrored 0.52 and 2.0, halved 0.21 and 1.0, weights shuffled 1.3 and 2.1. Inputs with the two slopes
swapped 0.053 and 0.39, one of them mirrored 0.060 and 0.40, all halved 0.12 and 0.54.
"""

import numpy as np
import pytest

from nnpp_edge.benchmarks.unseen import Ground, shuffled_network
from nnpp_edge.runtime.network.priors import CoarseSlope, NetworkPrior
from nnpp_edge.runtime.network.unseen import prices_of
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.known import KnownMaps, known_map
from nnpp_edge.terrain.workloads import workload

FACTOR = 8
FAULTS = {
    "turned": np.rot90,
    "upside down": np.flipud,
    "mirrored": np.fliplr,
    "halved": lambda prices: prices / 2.0,
    "moved by a block": lambda prices: np.roll(prices, 1, axis=1),
}


class Case:
    """Lunar highlands, 64² blocks of 8 × 8 cells, of which a stripe has been seen."""

    def __init__(self, name: str) -> None:
        dem, self.limits = sample_dem("moon_highlands").rescaled(20.0), workload(name)
        self.ground = Ground(dem.elevation, dem.cell_size_m, self.limits, FACTOR)
        fields = known_map(dem.elevation, dem.cell_size_m, dem.cell_size_m, self.limits, FACTOR)
        self.truth = prices_of(KnownMaps(*(np.array([each]) for each in fields)).answers(0))
        mask = np.zeros(self.ground.cost.shape, bool)
        mask[:, 200:264] = True
        self.seen = self.ground.seen(mask)

    def error(self, prices: np.ndarray) -> float:
        """Root mean square, where nothing was seen."""
        return float(np.sqrt(((prices - self.truth)[self.seen.share == 0.0] ** 2).mean()))


@pytest.mark.parametrize(("name", "most"), [("soft", 0.035), ("limit20", 0.3)])
def test_prices_are_near_the_truth_and_no_fault_is_as_near(name, most):
    case = Case(name)
    shape = case.limits, 20.0 * FACTOR, FACTOR
    prices = NetworkPrior("unseen", *shape).prices(case.ground.coarse, case.seen)
    faults = {name: case.error(fault(prices)) for name, fault in FAULTS.items()}
    faults["shuffled"] = case.error(shuffled_network("unseen", *shape).prices(case.ground.coarse, case.seen))
    assert case.error(prices) < most < min(faults.values()), faults
    assert case.error(CoarseSlope(*shape).prices(case.ground.coarse)) > 1.5 * most
