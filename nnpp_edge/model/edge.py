"""The edge network: an encoder that is shown the map alone, and a small head for each query.

The encoder, nearly all of the work, runs when the map changes. The head is a few thousand
multiply-accumulates a block: what it costs to get from a block to either end is a matter of the two
places, which the encoder has described, and of how they lie to each other.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from nnpp_edge.model.nnpp import ConvBNReLU, initialise
from nnpp_edge.model.registry import OUTPUT_STRIDES
from nnpp_edge.runtime.kernels.encoding import BETWEEN_CHANNELS, END_CHANNELS
from nnpp_edge.runtime.kernels.place_head import ANSWERS
from nnpp_edge.runtime.network.model_file import QUERY_SPACING

MAP_CHANNELS = 2
UNSHUFFLE = 4
"""The map's input has 4 × 4 cells to a pixel, as channels."""
OUTPUT_SHUFFLE = QUERY_SPACING // OUTPUT_STRIDES["edge"]
"""The output has 2 × 2 blocks to a pixel, as channels."""

assert ANSWERS == OUTPUT_SHUFFLE**2


class EdgeNet(nn.Module):
    """An encoder of the map and a head for each query.

    `widths` are the encoder's channels at 1/8, 1/16, 1/32 and 1/64 resolution, `stem` those after
    its first convolution; `relation` and `hidden` are the `Head`'s. Unlike the paper's network it
    is shown 4 × 4 cells as a pixel, so that the first convolution is one large node, and the share
    of impassable cells, as averages hide walls and passes on large maps. The map's side S is a
    multiple of 64.
    """

    def __init__(
        self,
        widths: tuple[int, ...] = (32, 64, 64, 64),
        stem: int = 32,
        relation: int = 32,
        hidden: tuple[int, ...] = (32, 16),
    ) -> None:
        super().__init__()
        self.encoder = Encoder(widths, stem, relation)
        self.head = Head(relation, hidden)
        initialise(self, self.head.answer)

    def forward(self, planes: Tensor, query: Tensor) -> Tensor:
        """Logits (N, 4, S/8, S/8) of the probability that a nearly optimal path passes.

        For planes (N, 32, S/4, S/4) in [0, 1], 4 × 4 cells to a pixel (`torch.pixel_unshuffle`),
        and start and goal (N, 15, S/8, S/8, `encode_ends` of the runtime). Four blocks to a pixel
        (`torch.pixel_shuffle`).
        """
        logits: Tensor = self.head(self.encoder(planes), query)
        return logits


class Encoder(nn.Module):
    """The map's two descriptions of each place, as one to pass through and as an end of a path.

    (N, 32, S/4, S/4) to (N, 2R, S/8, S/8).
    """

    def __init__(self, widths: tuple[int, ...], stem: int, relation: int) -> None:
        super().__init__()
        self.stem = ConvBNReLU(MAP_CHANNELS * UNSHUFFLE**2, stem, stride=2)
        self.widen = ConvBNReLU(stem, widths[0])
        self.pyramid = FeaturePyramid(*widths)
        self.describe = nn.Conv2d(widths[0], 2 * relation, 1)

    def forward(self, planes: Tensor) -> Tensor:
        described: Tensor = self.describe(self.pyramid(self.widen(self.stem(planes))))
        return described


class Head(nn.Module):
    """From the places' descriptions (N, 2R, B, B) and a query (N, 15, B, B) to logits (N, 4, B, B).

    `relation` (R) numbers relate a place to an end; `hidden` are the units of the two layers after.
    """

    def __init__(self, relation: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        first, second = hidden
        self.sizes = (relation, first, second)
        self.way = nn.Linear(END_CHANNELS - 1, relation)
        self.both = nn.Linear(relation, first)
        self.across = nn.Linear(relation, first, bias=False)
        self.between = nn.Linear(BETWEEN_CHANNELS, first, bias=False)
        self.mix = nn.Linear(first, second)
        self.answer = nn.Linear(second, ANSWERS)

    def parameters_in_order(self) -> Tensor:
        """All of them in a row, in the order and layout that the runtime's head reads
        (`parameter_shapes`).
        """
        layers = self.way, self.both, self.across, self.between, self.mix, self.answer
        parts = [
            part for layer in layers for part in (layer.weight.T, layer.bias) if part is not None
        ]
        return torch.cat([part.flatten() for part in parts])

    def forward(self, described: Tensor, query: Tensor) -> Tensor:
        side = described.shape[-1]
        place, end = described.flatten(2).transpose(1, 2).chunk(2, -1)
        flat = query.flatten(2)
        ends = torch.unflatten(flat[:, : 2 * END_CHANNELS], 1, (2, END_CHANNELS))
        share = ends[:, :, 0]
        way = ends[:, :, 1:].transpose(2, 3)
        at_ends = share @ end
        related = functional.relu(place[:, None] + at_ends[:, :, None] + self.way(way))
        across = share.flip(1)[:, :, None] @ related  # how each end is related to the other
        between = self.between(flat[:, 2 * END_CHANNELS :].transpose(1, 2))
        x = functional.relu(self.both(related.sum(1)) + self.across(across.sum(1)) + between)
        x = self.answer(functional.relu(self.mix(x)))
        return torch.unflatten(x.transpose(1, 2), 2, (side, side))


class FeaturePyramid(nn.Module):
    """Down from 1/8 resolution to 1/64, and up again, with so many channels."""

    def __init__(self, at8: int, at16: int, at32: int, at64: int) -> None:
        super().__init__()
        self.down16 = nn.Sequential(ConvBNReLU(at8, at16, stride=2))
        self.down32 = nn.Sequential(ConvBNReLU(at16, at32, stride=2), Residual(at32))
        self.down64 = nn.Sequential(ConvBNReLU(at32, at64, stride=2))
        self.up32 = Up(at64, at32)
        self.up16 = Up(at32, at16)
        self.up8 = Up(at16, at8)

    def forward(self, at8: Tensor) -> Tensor:
        at16 = self.down16(at8)
        at32 = self.down32(at16)
        at32 = self.up32(self.down64(at32), at32)
        out: Tensor = self.up8(self.up16(at32, at16), at8)
        return out


class Residual(nn.Module):
    """Two convolutions beside a short cut: (N, C, H, W) to the same."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = ConvBNReLU(channels, channels)
        self.second = ConvBNReLU(channels, channels, relu=False)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.second(self.first(x)))


class Up(nn.Module):
    """`deep` (N, D, H, W) at twice its side added to `shallow` (N, C, 2H, 2W), then convolved."""

    def __init__(self, deep: int, shallow: int) -> None:
        super().__init__()
        self.match = ConvBNReLU(deep, shallow, 1)
        self.merge = ConvBNReLU(shallow, shallow)

    def forward(self, deep: Tensor, shallow: Tensor) -> Tensor:
        doubled = functional.interpolate(self.match(deep), scale_factor=2, mode="nearest")
        merged: Tensor = self.merge(shallow + doubled)
        return merged
