"""Maps of poses in memory, and batches of them as a passage network is shown them."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.kernels.blocks import MIDDLE
from nnpp_edge.runtime.network.passage import STEPS, shown_blocks, shown_numbers, vehicle_numbers
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.dataset import read_any_recipe, read_shards
from nnpp_edge.terrain.passage import CLOSED, BlockLabels, PassageRecipe, of_stored, unpacked_heights

Labels = dict[str, NDArray[np.uint8]]
"""(4, R, C) each, by the names of `BlockLabels`."""
_FLIPPED, _TRANSPOSED = [0, 3, 2, 1], [2, 1, 0, 3]
"""The heading that each heading becomes."""


class PassageBatch(NamedTuple):
    """Maps of V vehicles, N of each, with one block more on every side."""

    blocks: Tensor
    """(V, N, 19, R + 2, C + 2) float32 in [-1, 1]."""
    numbers: Tensor
    """(V, 12) float32."""
    labels: dict[str, Tensor]
    """(V, N, 4, R, C) uint8 each, by the names of `BlockLabels`."""


class PassageMaps:
    """All maps of a data set, by their vehicles.

    Raises
    ------
    DataSetError
        The folder holds no data set for passage networks, or none of its shards.
    """

    def __init__(self, folder: Path) -> None:
        recipe = read_any_recipe(folder)
        if not isinstance(recipe, PassageRecipe):
            raise DataSetError(f"{folder}: wanted a data set for passage networks (nnpp-edge dataset --poses)")
        self.recipe, self._of_each = recipe, recipe.maps_per_vehicle
        self._parts: list[Mapping[str, NDArray[np.generic]]] = []
        for shard in read_shards(folder, recipe):
            for first in range(0, len(shard["heights"]) - self._of_each + 1, self._of_each):
                self._parts.append({name: part[first : first + self._of_each] for name, part in shard.items()})
        if not self._parts:
            raise DataSetError(f"{folder}: wanted at least {self._of_each} maps, got none")

    def __len__(self) -> int:
        """Number of vehicles; the same one counts as often as it was drawn."""
        return len(self._parts)

    def ground(self, k: int) -> tuple[Float2D, Vehicle]:
        """The first map of vehicle `k`, (S, S) heights in cells, and the vehicle, in cells."""
        part = self._parts[k]
        heights = unpacked_heights(np.asarray(part["heights"][0], np.int16), float(part["scale"][0]))
        return heights, of_stored(np.asarray(part["vehicle"][0], np.float64))

    def batch(self, which: NDArray[np.int64] | range, rng: np.random.Generator | None = None) -> PassageBatch:
        """Those vehicles' maps, turned and mirrored at random where `rng` is given."""
        blocks, numbers, labels = [], [], {name: [] for name in BlockLabels._fields}  # type: ignore[var-annotated]
        for part in (self._parts[k] for k in which):
            vehicle = of_stored(np.asarray(part["vehicle"][0], np.float64))
            numbers.append(shown_numbers(vehicle_numbers(vehicle, (1.0, 1.0))))
            for m in range(self._of_each):
                heights = unpacked_heights(np.asarray(part["heights"][m], np.int16), float(part["scale"][m]))
                own: Labels = {name: np.asarray(part[name][m], np.uint8) for name in BlockLabels._fields}
                for turn in () if rng is None else np.flatnonzero(rng.random(4) < 0.5):
                    heights, own = (transposed, flipped)[turn % 2](heights, own)
                rows, cols = own["link"].shape[1:]
                shape = rows + 2, cols + 2
                blocks.append(shown_blocks(np.ascontiguousarray(heights), (1.0, 1.0), vehicle, (-1, -1), shape))
                for name, label in own.items():
                    labels[name].append(label)
        shown = (self._formed(blocks).float() - MIDDLE) / STEPS
        return PassageBatch(
            shown, torch.from_numpy(np.stack(numbers)), {k: self._formed(v) for k, v in labels.items()}
        )

    def _formed(self, arrays: list[NDArray[np.uint8]]) -> Tensor:
        """(V, N, …) of the arrays of all maps."""
        stacked = torch.from_numpy(np.stack(arrays))
        return stacked.reshape(-1, self._of_each, *stacked.shape[1:])


def flipped(heights: Float2D, labels: Labels) -> tuple[Float2D, Labels]:
    """A map and its labels, rows in reverse."""
    out = {name: label[_FLIPPED, ::-1] for name, label in labels.items()}
    link = out["link"].copy()  # what leads down leaves from the block above now
    link[0, :-1], link[0, -1] = out["link"][0, 1:], CLOSED
    return heights[::-1], out | {"link": link}


def transposed(heights: Float2D, labels: Labels) -> tuple[Float2D, Labels]:
    """A map and its labels, rows and columns exchanged."""
    out = {name: label[_TRANSPOSED].transpose(0, 2, 1) for name, label in labels.items()}
    link = out["link"].copy()  # what leads up and to the right leaves from its other end now
    link[3] = CLOSED
    link[3, 1:, :-1] = out["link"][3, :-1, 1:]
    return heights.T, out | {"link": link}
