"""Training maps of which blocks are known coarsely: their mean elevations, and what their cells
turn out to be.
"""

from dataclasses import dataclass, fields

import cv2
import numpy as np

from nnpp_edge.runtime.arrays import Array, Bool, Float2D, Float32s, Int32, Planes, UInt8, in_blocks
from nnpp_edge.runtime.network.unseen import encode_unseen
from nnpp_edge.runtime.terrain.traversability import Traversability

CERTAIN = 254
"""The number stored for an answer of 1: even, as ways across a block are counted in halves."""


@dataclass(frozen=True)
class KnownMaps:
    """M maps of B × B blocks, each of `factor` × `factor` cells."""

    heights: Float2D
    """(M, B, B) mean elevation, metres relative to the map's mean."""
    answers: UInt8
    """(M, 3, B, B) of each block, 1 as `CERTAIN`: mean T of its cells, impassable ones as 1;
    share of impassable cells; of the ways across it, down and to the side, the share that these
    close."""
    factor: Int32
    cell_size_m: Float2D
    """(M,) side of a cell."""
    slope_limit_deg: Float2D
    hard_slope_deg: Float2D
    """(M,) limits of the slope; inf for none."""

    def __len__(self) -> int:
        return len(self.heights)

    def limits(self, at: int) -> Traversability:
        """Those of the slope of one map."""
        return Traversability(
            float(self.slope_limit_deg[at]),
            hard_slope_deg=float(self.hard_slope_deg[at]),
        )

    def blocks(self, at: int) -> tuple[int, float]:
        """Side of one map's blocks, in cells and in metres."""
        factor = int(self.factor[at])
        return factor, float(self.cell_size_m[at]) * factor

    def encode(self, at: int, out: Planes) -> None:
        """Show one map to a network: its channels into `out`, (12, B, B) float32."""
        factor, side_m = self.blocks(at)
        encode_unseen(self.heights[at], self.limits(at), (side_m, side_m), factor, out)

    def pick(self, maps: slice | Array) -> "KnownMaps":
        """Some of the maps."""
        return KnownMaps(*(getattr(self, field.name)[maps] for field in fields(self)))

    @property
    def wanted(self) -> Float32s:
        """The answers wanted: (M, 3, B, B)."""
        return np.divide(self.answers, CERTAIN, dtype=np.float32)


def known_map(
    elevation: Float2D,
    cost: Float2D,
    cell_size_m: float,
    limits: Traversability,
    factor: int,
) -> tuple[object, ...]:
    """The fields of `KnownMaps` for one map."""
    blocked = ~(cost < 1.0)
    layers = np.stack([elevation, np.where(blocked, np.float32(1.0), cost), blocked])
    means = in_blocks(layers, factor).mean(axis=(2, 4))
    answers = np.stack([*means[1:], _closed(blocked, factor)])
    return (
        means[0] - means[0].mean(),
        np.rint(CERTAIN * answers).astype(np.uint8),
        np.int32(factor),
        np.float32(cell_size_m),
        np.float32(limits.slope_limit_deg),
        np.float32(limits.hard_slope_deg),
    )


def _closed(blocked: Bool, factor: int) -> Float2D:
    """Of the two ways across each block, within it, the share that is closed."""
    blocks = in_blocks(blocked, factor).swapaxes(1, 2)
    closed = np.zeros(blocks.shape[:2], np.float32)
    for row, col in np.argwhere(blocks.any(axis=(2, 3))):
        free = (~blocks[row, col]).astype(np.uint8)
        _, pieces = cv2.connectedComponents(free, connectivity=8)
        for across in (pieces, pieces.T):
            first = across[0]
            if not np.intersect1d(first[first > 0], across[-1]).size:
                closed[row, col] += 0.5
    return closed
