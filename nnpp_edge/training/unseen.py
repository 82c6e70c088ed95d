"""How well answers fit what lies unseen."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from nnpp_edge.model.network import Network
from nnpp_edge.runtime.network.model_file import UNSEEN
from nnpp_edge.runtime.network.unseen import prices_of
from nnpp_edge.terrain.known import CERTAIN, KnownMaps
from nnpp_edge.training.batches import held_known
from nnpp_edge.training.encoding import encode_unseen_maps

Floats = NDArray[np.float32]


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
        held = held_known(maps.pick(chosen))
        shape = (len(chosen), len(UNSEEN), *held.maps.shape[2:])
        self.planes = np.empty(shape, np.float32)
        planes = torch.from_numpy(self.planes)
        encode_unseen_maps(held.maps[:, 0], torch.from_numpy(held.facts), planes)
        self.wanted: Floats = (held.labels / CERTAIN).numpy()

    def judge(self, network: Network) -> list[Fit]:
        """How well a network's answers fit."""
        no_query = np.empty((len(self.planes), 0), np.float32)
        return [self.judge_answers(network.answers(self.planes, no_query))]

    def judge_answers(self, answers: Floats) -> Fit:
        """How well answers (N, 3, B, B) fit."""
        wrong = answers - self.wanted
        errors = [wrong[:, at] for at in range(wrong.shape[1])]
        errors.append(prices_of(wrong.swapaxes(0, 1)))
        return Fit(*(float(np.sqrt((each**2).mean())) for each in errors))
