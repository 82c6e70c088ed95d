"""Batches of coarse maps, and how well answers fit what lies unseen."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.model.network import Network
from nnpp_edge.runtime.arrays import Int64
from nnpp_edge.runtime.network.model_file import UNSEEN
from nnpp_edge.runtime.network.unseen import encode_unseen
from nnpp_edge.terrain.known import KnownMaps

Floats = NDArray[np.float32]
NumberT = TypeVar("NumberT", bound=np.generic)
Turn = tuple[int, bool]
"""Quarter turns to the left, and whether a map is mirrored after them."""


def turned(array: NDArray[NumberT], turn: Turn) -> NDArray[NumberT]:
    """(..., H, W) in one of eight positions."""
    quarters, mirrored = turn
    array = np.rot90(array, quarters, axes=(-2, -1))
    return np.ascontiguousarray(array[..., ::-1] if mirrored else array)


def known_batch(
    maps: KnownMaps, numbers: Int64, swapped: list[bool], turns: list[Turn]
) -> tuple[Floats, Floats, Floats]:
    """Planes of maps, each turned and mirrored, and the answers wanted; the query of these networks
    is empty.
    """
    shown = [sample(maps, at, turn) for at, turn in zip(numbers.tolist(), turns, strict=True)]
    planes, answers = (np.stack(each) for each in zip(*shown, strict=True))
    return planes, np.empty((len(shown), 0), np.float32), answers


def sample(maps: KnownMaps, at: int, turn: Turn = (0, False)) -> tuple[Floats, Floats]:
    """A map as it is shown to a network, and the answers wanted, in one of eight positions."""
    heights = turned(maps.heights[at], turn)
    factor, block_m = maps.blocks(at)
    planes = np.empty((len(UNSEEN), *heights.shape), np.float32)
    encode_unseen(heights, maps.limits(at), (block_m, block_m), factor, planes)
    return planes, turned(maps.wanted(at), turn)


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
        turns = [(0, False)] * len(chosen)
        self.planes, self.query, self.wanted = known_batch(maps, chosen, [], turns)

    def judge(self, network: Network) -> list[Fit]:
        """How well a network's answers fit."""
        return [self.judge_answers(network.answers(self.planes, self.query))]

    def judge_answers(self, answers: Floats) -> Fit:
        """How well answers (N, 3, B, B) fit: their root mean square errors."""
        squares = (answers - self.wanted) ** 2
        return Fit(*np.sqrt(squares.mean(axis=(0, 2, 3))).tolist())
