"""Batches of coarse maps, and how well answers fit what lies unseen."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from nnpp_edge.model.network import Network
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.model_file import UNSEEN
from nnpp_edge.runtime.network.unseen import encode_unseen
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.training.batches import Batch, made_ahead
from nnpp_edge.training.checkpoint import TrainSettings

Floats = NDArray[np.float32]


class KnownBatches:
    """Planes of coarse maps, turned and mirrored, and the answers wanted; the query of these networks is empty."""

    def __init__(self, maps: KnownMaps, settings: TrainSettings, *, rank: int = 0, world: int = 1) -> None:
        if len(maps) < settings.batch:
            raise DataSetError(f"wanted at least {settings.batch} maps for one batch, got {len(maps)}")
        self.maps, self.settings, self.rank, self.world = maps, settings, rank, world

    def __len__(self) -> int:
        """Batches in an epoch."""
        return len(self.maps) // self.settings.batch

    def epoch(self, number: int, skip: int = 0) -> Iterator[Batch]:
        """The batches of an epoch from the `skip`-th on, made ahead in threads."""
        seed, step = self.settings.seed, self.settings.batch
        order = np.random.default_rng([seed, number]).permutation(len(self.maps))

        def make(at: int) -> Batch:
            rng = np.random.default_rng([seed, number, at])
            turns = [(int(rng.integers(4)), bool(rng.integers(2))) for _ in range(step)]
            ours = range(self.rank, step, self.world)
            shown = [sample(self.maps, int(order[at * step + i]), *turns[i]) for i in ours]
            planes, answers = (np.stack(each) for each in zip(*shown, strict=True))
            return planes, np.empty((len(ours), 0), np.float32), answers

        return made_ahead(make, range(skip, len(self)))


def sample(maps: KnownMaps, at: int, quarters: int = 0, mirrored: bool = False) -> tuple[Floats, Floats]:
    """A map as a network is shown it, and the answers wanted, in one of eight positions."""

    def turned(array: Floats) -> Floats:
        array = np.rot90(array, quarters, axes=(-2, -1))
        return np.ascontiguousarray(array[..., ::-1] if mirrored else array)

    heights, factor = turned(maps.heights[at]), int(maps.factor[at])
    planes = np.empty((len(UNSEEN), *heights.shape), np.float32)
    encode_unseen(heights, maps.limits(at), float(maps.cell_size_m[at]) * factor, factor, planes)
    return planes, turned(maps.wanted(at))


@dataclass(frozen=True)
class Fit:
    """Root mean square errors of the three answers."""

    rmse_mean: float
    rmse_blocked: float
    rmse_closed: float

    @classmethod
    def of(cls, answers: Floats, wanted: Floats) -> "Fit":
        """Of answers (N, 3, B, B)."""
        return cls(*np.sqrt(((answers - wanted) ** 2).mean(axis=(0, 2, 3))).tolist())


class KnownValidator:
    """Judges answers on fixed maps of other terrain."""

    def __init__(self, maps: KnownMaps, most: int = 256) -> None:
        chosen = np.linspace(0, len(maps) - 1, min(most, len(maps))).astype(int)
        self.planes, self.wanted = (np.stack(each) for each in zip(*(sample(maps, at) for at in chosen), strict=True))

    @torch.no_grad()
    def judge(self, network: Network, batch: int = 32) -> list[Fit]:
        """How well a network's answers fit."""
        network.eval()
        device = next(network.parameters()).device
        parts = (torch.from_numpy(self.planes[at : at + batch]) for at in range(0, len(self.planes), batch))
        logits = [network(part.to(device), part[:0]).float().cpu() for part in parts]
        return [Fit.of(torch.sigmoid(torch.cat(logits)).numpy(), self.wanted)]
