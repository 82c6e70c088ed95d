"""Batches of labelled queries, or of maps known by their blocks, turned and swapped at random."""

import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.model.network import encode
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.terrain.labels import EXCESS_STEP
from nnpp_edge.training.checkpoint import TrainSettings
from nnpp_edge.training.unseen import known_batch

Batch = tuple[NDArray[np.generic], NDArray[np.float32], NDArray[np.float32]]
"""Planes, encoded queries, targets."""


class Batches:
    """Planes, encoded queries and targets, in a new random order each epoch.

    The settings' ``target`` is ``near``: exp(-excess / softness), the nearness to the optimum of
    the best path through a block; or ``path``: 1 on the optimal path's blocks, 0 elsewhere, as in
    the paper; of maps known by their blocks it is what these turn out to be. Every process, `rank`
    of `world`, takes every `world`-th query of each batch: together they see the samples of one
    process.
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
        self.rank = rank
        self.world = world
        self._make = (
            partial(known_batch, samples)
            if isinstance(samples, KnownMaps)
            else _Labelled(samples, spec, settings)
        )

    def __len__(self) -> int:
        """Batches in an epoch."""
        return len(self.samples) // self.settings.batch

    def epoch(self, number: int, skip: int = 0) -> Iterator[Batch]:
        """The batches of an epoch from the `skip`-th on, made ahead in threads."""
        order = np.random.default_rng([self.settings.seed, number]).permutation(len(self.samples))
        step = self.settings.batch

        def make(at: int) -> Batch:
            rng = np.random.default_rng([self.settings.seed, number, at])
            swapped = [rng.random() >= 0.5 for _ in range(step)]
            turns = [(int(rng.integers(4)), bool(rng.integers(2))) for _ in range(step)]
            ours = slice(self.rank, step, self.world)
            return self._make(order[at * step : (at + 1) * step][ours], swapped[ours], turns[ours])

        threads = max(2, len(os.sched_getaffinity(0)))
        with ThreadPoolExecutor(threads) as pool:
            ahead: deque[Future[Batch]] = deque()
            for at in range(skip, len(self)):
                if len(ahead) > threads:
                    yield ahead.popleft().result()
                ahead.append(pool.submit(make, at))
            while ahead:
                yield ahead.popleft().result()


class _Labelled:
    """Makes batches of labelled queries."""

    def __init__(self, samples: Samples, spec: Spec, settings: TrainSettings) -> None:
        label_blocks = samples.excess.shape[-1]
        side = samples.planes.shape[-1]
        if label_blocks % spec.blocks or side != spec.input_size:
            raise DataSetError(
                f"the network wants maps of {spec.input_size} and labels of a multiple of "
                f"{spec.blocks} "
                f"blocks, got {side} and {label_blocks}"
            )
        self.samples = samples
        self.spec = spec
        self.settings = settings
        self.nearness = np.exp(-np.arange(256) * EXCESS_STEP / settings.softness).astype(np.float32)
        self.nearness[255] = 0.0

    def __call__(
        self, queries: NDArray[np.int64], swapped: list[bool], turns: list[tuple[int, bool]]
    ) -> Batch:
        """The batch of `queries`; those `swapped` go from goal to start, and each is turned and
        mirrored.
        """
        s = self.samples
        encoded = []
        planes = s.planes[s.map_index[queries]]
        targets = self._targets(queries)
        last = planes.shape[-1] - 1
        for at, (query, swap, (quarters, mirrored)) in enumerate(
            zip(queries, swapped, turns, strict=True)
        ):
            ends = []
            for row, col in (s.start[query].tolist(), s.goal[query].tolist()):
                for _ in range(quarters):
                    row, col = last - col, row
                ends.append((row, last - col if mirrored else col))
            encoded.append(encode(self.spec, *(ends[::-1] if swap else ends)))
            for array in (planes, targets):
                turned = np.rot90(array[at], quarters, axes=(-2, -1))
                array[at] = turned[..., ::-1] if mirrored else turned
        return planes, np.stack(encoded), targets

    def _targets(self, queries: NDArray[np.int64]) -> NDArray[np.float32]:
        s = self.samples
        blocks = self.spec.blocks
        side = s.excess.shape[-1] // blocks
        shape = (len(queries), blocks, side, blocks, side)
        if self.settings.target == "path":
            masks = np.unpackbits(s.on_path[queries], axis=-1)
            return np.asarray(masks.reshape(shape).max(axis=(2, 4)), np.float32)
        return np.asarray(self.nearness[s.excess[queries].reshape(shape).min(axis=(2, 4))])
