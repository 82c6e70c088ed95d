"""Batches of labelled queries, or of maps known by their blocks, turned and swapped at random."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

import numpy as np

from nnpp_edge.model.network import encode
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.arrays import Array, Float32, Int64, in_blocks
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.terrain.labels import EXCESS_STEP
from nnpp_edge.training.checkpoint import TrainSettings
from nnpp_edge.training.unseen import Turn, known_batch, turned

Batch = tuple[Array, Float32, Float32]
"""Planes, encoded queries, targets."""
Make = Callable[[Int64, list[bool], list[Turn]], Batch]
"""From the numbers of queries or maps, whether each is swapped, and how it is turned."""


class Batches:
    """Planes, encoded queries and targets, in a new random order each epoch.

    The settings' ``target`` is ``near``: exp(-excess / softness), the nearness to the optimum of
    the best path through a block; or ``path``: 1 on the optimal path's blocks, 0 elsewhere, as in
    the paper; for maps known by their blocks it is what the blocks turn out to be. Every process,
    `rank` of `world`, takes every `world`-th query of each batch: together they see the samples of
    one process.
    """

    def __init__(
        self,
        samples: Samples | KnownMaps,
        spec: Spec,
        settings: TrainSettings,
        *,
        rank: int = 0,
        world: int = 1,
    ) -> None:
        if len(samples) < settings.batch:
            raise DataSetError(
                f"wanted at least {settings.batch} samples for one batch, got {len(samples)}"
            )
        self.samples = samples
        self.settings = settings
        self.share = slice(rank, settings.batch, world)
        self._make: Make
        if isinstance(samples, KnownMaps):
            self._make = partial(known_batch, samples)
        else:
            self._make = _labelled(samples, spec, settings)

    def __len__(self) -> int:
        """Batches in an epoch."""
        return len(self.samples) // self.settings.batch

    def epoch(self, number: int, skip: int = 0) -> Iterator[Batch]:
        """The batches of an epoch from the `skip`-th on, made ahead in threads."""
        seed = self.settings.seed
        size = self.settings.batch
        order = np.random.default_rng([seed, number]).permutation(len(self.samples))

        def make(at: int) -> Batch:
            # drawn for the whole batch, whoever takes which part of it
            rng = np.random.default_rng([seed, number, at])
            swapped = [rng.random() >= 0.5 for _ in range(size)]
            turns = [(int(rng.integers(4)), bool(rng.integers(2))) for _ in range(size)]
            queries = order[at * size : (at + 1) * size]
            return self._make(queries[self.share], swapped[self.share], turns[self.share])

        threads = max(2, len(os.sched_getaffinity(0)))
        with ThreadPoolExecutor(threads) as pool:
            ahead: deque[Future[Batch]] = deque()
            for at in range(skip, len(self)):
                if len(ahead) > threads:
                    yield ahead.popleft().result()
                ahead.append(pool.submit(make, at))
            while ahead:
                yield ahead.popleft().result()


def _labelled(samples: Samples, spec: Spec, settings: TrainSettings) -> Make:
    """A function that makes batches of labelled queries."""
    labels = samples.excess.shape[-1]
    side = samples.planes.shape[-1]
    blocks = spec.blocks
    if labels % blocks or side != spec.input_size:
        raise DataSetError(
            f"the network wants maps of {spec.input_size} and labels of a multiple of {blocks} "
            f"blocks, got {side} and {labels}"
        )
    finer = labels // blocks
    last = side - 1
    nearness = np.exp(-np.arange(256) * EXCESS_STEP / settings.softness).astype(np.float32)
    nearness[255] = 0.0

    def targets_of(queries: Int64) -> Float32:
        """(N, B, B), the best of the labels in each of the network's blocks."""
        if settings.target == "path":
            on_path = np.unpackbits(samples.on_path[queries], axis=-1)
            return np.asarray(in_blocks(on_path, finer).max(axis=(2, 4)), np.float32)
        return np.asarray(nearness[in_blocks(samples.excess[queries], finer).min(axis=(2, 4))])

    def make(queries: Int64, swapped: list[bool], turns: list[Turn]) -> Batch:
        """The batch of `queries`; those `swapped` go from goal to start, and each is turned and
        mirrored.
        """
        planes = samples.planes[samples.map_index[queries]]
        targets = targets_of(queries)
        encoded = []
        for at, (query, swap, turn) in enumerate(zip(queries, swapped, turns, strict=True)):
            planes[at] = turned(planes[at], turn)
            targets[at] = turned(targets[at], turn)
            quarters, mirrored = turn
            ends = []
            for row, col in (samples.start[query].tolist(), samples.goal[query].tolist()):
                for _ in range(quarters):
                    row, col = last - col, row
                ends.append((row, last - col if mirrored else col))
            start, goal = reversed(ends) if swap else ends
            encoded.append(encode(spec, start, goal))
        return planes, np.stack(encoded), targets

    return make
