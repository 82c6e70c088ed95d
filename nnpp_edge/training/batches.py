"""Batches of labelled queries, or of maps known by their blocks, turned and swapped at random.

They are made whole, on the device that trains, of maps and labels that lie in this machine's memory
as bytes. The network encodes them itself.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.arrays import Bool, Float32s, Int64
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.model_file import UNSEEN
from nnpp_edge.terrain.dataset import Queries
from nnpp_edge.terrain.known import CERTAIN, KnownMaps
from nnpp_edge.terrain.labels import EXCESS_STEP
from nnpp_edge.training.settings import TrainSettings

Batch = tuple[Tensor, Tensor, Tensor]
"""Maps and facts, as a network is called with, and targets."""
CPU = torch.device("cpu")
POSITIONS = 8
"""Of a map: turned and mirrored."""


class Held(NamedTuple):
    """Samples as they are kept: bytes in tensors, the rest in arrays."""

    maps: Tensor
    """(M, C, S, S) planes: uint8, or float32 of maps known by their blocks."""
    labels: Tensor
    """(Q, L, B, B) uint8."""
    map_index: Int64
    """(Q,) the map of each sample."""
    facts: Float32s
    """(Q, 2, 2) start and goal; (Q, 0) without."""


class Batches:
    """Maps, facts and targets, in a new random order each epoch, which the settings' seed and the
    epoch's number decide.

    The settings' ``target`` is ``near``: exp(-excess / softness), the nearness to the optimum of
    the best path through a block; or ``path``: 1 on the optimal path's blocks, 0 elsewhere, as in
    the paper; for maps known by their blocks it is what the blocks turn out to be. DataSetError
    where samples are not of the network's size.
    """

    def __init__(
        self,
        samples: Queries,
        spec: Spec,
        settings: TrainSettings,
        *,
        device: torch.device = CPU,
    ) -> None:
        self.spec = spec
        self.settings = settings
        self.device = device
        nearness = torch.exp(-torch.arange(256) * (EXCESS_STEP / settings.softness))
        nearness[255] = 0.0
        self._nearness = nearness.to(device)
        self.held = self._of(samples)

    def __len__(self) -> int:
        """Batches in an epoch."""
        return len(self.held.labels) // self.settings.batch

    def _of(self, samples: Queries) -> Held:
        """Samples as they are kept."""
        if isinstance(samples, KnownMaps):
            answers = torch.from_numpy(np.ascontiguousarray(samples.answers))
            count = len(samples)
            no_facts = np.empty((count, 0), np.float32)
            planes = torch.from_numpy(known_planes(samples))
            return Held(planes, answers, np.arange(count), no_facts)
        side = samples.planes.shape[-1]
        blocks = self.spec.blocks
        count, fine, _ = samples.excess.shape
        if fine % blocks or side != self.spec.input_size:
            raise DataSetError(
                f"the network wants maps of {self.spec.input_size} and labels of a multiple of "
                f"{blocks} blocks, got {side} and {fine}"
            )
        labels = torch.from_numpy(samples.excess)
        if self.settings.target == "path":  # as the excess of a label: 0 on the path, else the most
            labels = 255 * torch.from_numpy(1 - np.unpackbits(samples.on_path, axis=-1))
        shape = (count, 1, blocks, fine // blocks, blocks, fine // blocks)
        planes = torch.from_numpy(samples.planes)
        return Held(
            planes[:, :1] if self.spec.architecture == "nnpp" else planes,
            labels.reshape(shape).amin((3, 5)),
            samples.map_index.astype(np.int64),
            np.stack([samples.start, samples.goal], 1),
        )

    def epoch(self, number: int, skip: int = 0) -> Iterator[Batch]:
        """The batches of an epoch from the `skip`-th on."""
        size = self.settings.batch
        rng = np.random.default_rng([self.settings.seed, number])
        count = len(self.held.labels)
        order = rng.permutation(count)[: len(self) * size].reshape(-1, size)
        swapped = rng.integers(2, size=order.shape, dtype=bool)
        # each place of a batch has its position, equal ones side by side: the order is random
        turns = np.sort((np.arange(size) + rng.integers(POSITIONS)) % POSITIONS)
        threads = torch.get_num_threads()
        for queries, from_goal in zip(order[skip:], swapped[skip:], strict=True):
            # to wake other threads takes longer than these copies
            torch.set_num_threads(1)
            batch = self.made(queries, from_goal, turns)
            torch.set_num_threads(threads)
            yield batch

    def made(self, queries: Int64, swapped: Bool, turns: Int64) -> Batch:
        """Maps, facts and targets of queries (N,); those `swapped` go from goal to start."""
        held = self.held
        of_blocks = self.spec.encoding == "unseen"
        labels = self._turned(held.labels, queries, turns)
        maps = self._turned(held.maps, held.map_index[queries], turns, rises=of_blocks)
        facts = held.facts[queries]
        if of_blocks:
            targets = labels / CERTAIN
        else:
            targets = self._nearness[labels[:, 0].int()]
            facts = turned_ends(facts, turns, self.spec.input_size)
            facts = np.where(swapped[:, None, None], facts[:, ::-1], facts)
        return maps, torch.from_numpy(facts).to(self.device), targets

    def _turned(self, held: Tensor, index: Int64, turns: Int64, *, rises: bool = False) -> Tensor:
        """`held[index]` on the device, each in its position: all of one position at once. With
        `rises` the first two planes are those along rows and down columns, which turn with the map.
        """
        found = held.index_select(0, torch.from_numpy(index))
        if self.device != CPU:
            found = found.pin_memory().to(self.device, non_blocking=True)
        in_position = torch.empty_like(found)
        sizes = np.bincount(turns).tolist()
        groups = zip(torch.split(found, sizes), torch.split(in_position, sizes), strict=True)
        for turn, (group, out) in enumerate(groups):
            out.copy_(turned(group, turn))
            if rises:
                signs = [1 - (turn & 2), 1 - 2 * (turn & 1)]
                signed = out[:, :2] * out.new_tensor(signs)[:, None, None]
                out[:, :2] = signed.flip(1) if turn & 4 else signed
        return in_position


def known_planes(maps: KnownMaps) -> Float32s:
    """All maps as a network is shown them, (M, 12, B, B)."""
    planes = np.empty((len(maps), len(UNSEEN), *maps.heights.shape[1:]), np.float32)
    for at, out in enumerate(planes):
        maps.encode(at, out)
    return planes


def turned(array: Tensor, turn: int) -> Tensor:
    """(..., S, S) in one of eight positions: rows mirrored if `turn` has the bit 1, columns 2, then
    transposed 4.
    """
    mirrored = [axis for axis, bit in ((-2, 1), (-1, 2)) if turn & bit]
    array = array.flip(mirrored) if mirrored else array
    return array.mT if turn & 4 else array


def turned_ends(ends: Float32s, turns: Int64, side: int) -> Float32s:
    """Places (..., N, 2, 2), (row, col) in cells, on maps of this side in these positions (N,)."""
    turns = turns[:, None, None]
    mirrored = np.where(turns & np.array([1, 2]), np.float32(side - 1) - ends, ends)
    return np.where(turns & 4, mirrored[..., ::-1], mirrored)
