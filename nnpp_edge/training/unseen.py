"""How well answers fit what lies unseen."""

from dataclasses import dataclass

import numpy as np

from nnpp_edge.model.network import Network
from nnpp_edge.runtime.arrays import Float32s
from nnpp_edge.runtime.network.unseen import prices_of
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.training.batches import known_planes


@dataclass(frozen=True)
class Fit:
    """Root mean square errors of the three answers, and of the price that they make."""

    rmse_mean: float
    rmse_blocked: float
    rmse_closed: float
    rmse_price: float

    @property
    def score(self) -> float:
        """What the best weights are chosen by; less is better."""
        return self.rmse_price


class KnownValidator:
    """Judges answers on fixed maps of other terrain."""

    def __init__(self, maps: KnownMaps, most: int = 256) -> None:
        chosen = np.linspace(0, len(maps) - 1, min(most, len(maps))).astype(int)
        self.shown = maps.pick(chosen)
        self.wanted = self.shown.wanted

    def judge(self, network: Network) -> Fit:
        """How well a network's answers fit."""
        planes = known_planes(self.shown)
        no_facts = np.empty((len(planes), 0), np.float32)
        return self.judge_answers(network.answers(planes, no_facts))

    def judge_answers(self, answers: Float32s) -> Fit:
        """How well answers (N, 3, B, B) fit."""
        wrong = answers - self.wanted
        errors = [wrong[:, at] for at in range(wrong.shape[1])]
        errors.append(prices_of(wrong.swapaxes(0, 1)))
        return Fit(*(float(np.sqrt((each**2).mean())) for each in errors))
