"""Batches of coarse maps with random tracks of what has been seen, and how well the answers fit."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from nnpp_edge.model.network import Network
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.model_file import UNSEEN
from nnpp_edge.runtime.network.unseen import Seen, encode_unseen
from nnpp_edge.terrain.known import QUARTERS, KnownMaps
from nnpp_edge.training.batches import Batch, made_ahead
from nnpp_edge.training.checkpoint import TrainSettings

NOTHING_SEEN = 0.12
"""Share of the maps of which nothing has been seen."""
SIGHTS = 8, 16, 32
"""Cells that a robot sees to each side."""
Floats = NDArray[np.float32]


class KnownBatches:
    """Planes of coarse maps, turned and mirrored, with random tracks seen; targets are NaN where all was seen."""

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
            rngs = np.random.default_rng([seed, number, at]).spawn(step)
            ours = range(at * step + self.rank, (at + 1) * step, self.world)
            return stacked([sample(self.maps, int(order[i]), rngs[i - at * step]) for i in ours])

        return made_ahead(make, range(skip, len(self)))


def stacked(samples: list[tuple[Floats, Floats]]) -> tuple[Floats, Floats, Floats]:
    """A batch; the query of these networks is empty."""
    planes, targets = (np.stack(each) for each in zip(*samples, strict=True))
    return planes, np.empty((len(samples), 0), np.float32), targets


def sample(maps: KnownMaps, at: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """A map as a robot under way may know it, and what is to be answered, in one of eight positions."""
    factor = int(maps.factor[at])
    mask = seen_track(maps.mean.shape[-1], factor, rng)
    seen, answers = maps.seen(at, mask), maps.answers(at)
    answers[:, seen.share == 1.0] = np.nan
    quarters, mirrored = int(rng.integers(4)), bool(rng.integers(2))

    def turned(array: Floats) -> Floats:
        array = np.rot90(array, quarters, axes=(-2, -1))
        return np.ascontiguousarray(array[..., ::-1] if mirrored else array)

    planes = np.empty((len(UNSEEN), *answers.shape[1:]), np.float32)
    now = Seen(*(turned(each) for each in (seen.mean, seen.blocked, seen.share)))
    size_m = float(maps.cell_size_m[at]) * factor
    encode_unseen(turned(maps.heights[at]), now, maps.limits(at), size_m, factor, planes)
    return planes, turned(answers)


def seen_track(side: int, factor: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(side, side) parts of blocks that a robot saw on one or two tracks, if any."""
    mask = np.zeros((side, side), np.bool_)
    if rng.random() < NOTHING_SEEN:
        return mask
    for _ in range(rng.integers(1, 3)):
        sight = max(1, round(rng.choice(SIGHTS) * QUARTERS / factor))
        place, heading = rng.uniform(0, side, 2), rng.uniform(0, 2 * math.pi)
        for _ in range(rng.integers(1, 16)):
            row, col = place.astype(int)
            mask[max(row - sight, 0) : max(row + sight + 1, 0), max(col - sight, 0) : max(col + sight + 1, 0)] = True
            heading += rng.normal(0.0, 0.4)
            place += max(sight / 2, 1.0) * np.array([math.cos(heading), math.sin(heading)])
    return mask


def loss_where_unseen(logits: Tensor, target: Tensor) -> Tensor:
    """Sum over the answers of the mean cross entropy over blocks with a target."""
    wanted = target.isfinite()
    losses = binary_cross_entropy_with_logits(logits, target.nan_to_num(), reduction="none")
    return logits.shape[1] * (losses * wanted).sum() / wanted.sum()


@dataclass(frozen=True)
class Fit:
    """Root mean square errors of the three answers where nothing was seen."""

    mean: float
    blocked: float
    closed: float


class KnownValidator:
    """Judges answers on fixed maps of other terrain, each with a fixed track; up to `size` all beyond is unknown."""

    def __init__(self, maps: KnownMaps, most: int = 256, size: int = 0) -> None:
        chosen = np.linspace(0, len(maps) - 1, min(most, len(maps))).astype(int)
        drawn = [sample(maps, int(at), np.random.default_rng([7, int(at)])) for at in chosen]
        planes, _, targets = stacked(drawn)
        room = [(0, max(size - planes.shape[-1], 0))] * 2
        self.planes: Floats = np.pad(planes, [(0, 0), (0, 0), *room])
        self.targets: Floats = np.pad(targets, [(0, 0), (0, 0), *room], constant_values=np.nan)

    def rows(self, network: Network) -> dict[str, float]:
        """For a training's history."""
        fit = fit_of(probabilities(network, self.planes), self.targets)
        return {"rmse_mean": fit.mean, "rmse_blocked": fit.blocked, "rmse_closed": fit.closed}


def fit_of(answers: Floats, targets: Floats) -> Fit:
    """Of answers (N, 3, B, B) to targets that are NaN where all was seen."""
    return Fit(*np.sqrt(np.nanmean((answers - targets) ** 2, axis=(0, 2, 3))).tolist())


@torch.no_grad()
def probabilities(network: Network, planes: Floats, batch: int = 32) -> Floats:
    """(N, 3, B, B) the answers of a network."""
    network.eval()
    device = next(network.parameters()).device
    parts = [torch.from_numpy(planes[at : at + batch]).to(device) for at in range(0, len(planes), batch)]
    return np.concatenate([torch.sigmoid(network(part, part[:0]).float()).cpu().numpy() for part in parts])
