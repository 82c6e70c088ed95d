"""Batches of coarse maps, and how well answers fit what lies unseen."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from nnpp_edge.model.network import Network
from nnpp_edge.runtime.network.model_file import UNSEEN
from nnpp_edge.runtime.network.unseen import encode_unseen
from nnpp_edge.terrain.known import KnownMaps

Floats = NDArray[np.float32]


def known_batch(
    maps: KnownMaps, numbers: NDArray[np.int64], swapped: list[bool], turns: list[tuple[int, bool]]
) -> tuple[Floats, Floats, Floats]:
    """Planes of maps, each turned and mirrored, and the answers wanted; the query of these networks
    is empty.
    """
    shown = [sample(maps, int(at), *turn) for at, turn in zip(numbers, turns, strict=True)]
    planes, answers = (np.stack(each) for each in zip(*shown, strict=True))
    return planes, np.empty((len(shown), 0), np.float32), answers


def sample(
    maps: KnownMaps, at: int, quarters: int = 0, mirrored: bool = False
) -> tuple[Floats, Floats]:
    """A map as a network is shown it, and the answers wanted, in one of eight positions."""

    def turned(array: Floats) -> Floats:
        array = np.rot90(array, quarters, axes=(-2, -1))
        return np.ascontiguousarray(array[..., ::-1] if mirrored else array)

    heights = turned(maps.heights[at])
    factor = int(maps.factor[at])
    planes = np.empty((len(UNSEEN), *heights.shape), np.float32)
    side_m = float(maps.cell_size_m[at]) * factor
    encode_unseen(heights, maps.limits(at), (side_m, side_m), factor, planes)
    return planes, turned(maps.wanted(at))


@dataclass(frozen=True)
class Fit:
    """Root mean square errors of the three answers."""

    rmse_mean: float
    rmse_blocked: float
    rmse_closed: float


class KnownValidator:
    """Judges answers on fixed maps of other terrain."""

    def __init__(self, maps: KnownMaps, most: int = 256) -> None:
        chosen = np.linspace(0, len(maps) - 1, min(most, len(maps))).astype(int)
        self.planes, self.wanted = (
            np.stack(each) for each in zip(*(sample(maps, at) for at in chosen), strict=True)
        )

    @torch.no_grad()
    def judge(self, network: Network, batch: int = 32) -> list[Fit]:
        """How well a network's answers fit."""
        network.eval()
        device = next(network.parameters()).device
        parts = (
            torch.from_numpy(self.planes[at : at + batch])
            for at in range(0, len(self.planes), batch)
        )
        logits = [network(part.to(device), part[:0]).float().cpu() for part in parts]
        return self.judge_answers(torch.sigmoid(torch.cat(logits)).numpy())

    def judge_answers(self, answers: Floats) -> list[Fit]:
        """How well answers (N, 3, B, B) fit: their root mean square errors."""
        return [Fit(*np.sqrt(((answers - self.wanted) ** 2).mean(axis=(0, 2, 3))).tolist())]
