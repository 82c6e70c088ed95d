"""The edge network: an encoder that is shown the map alone, and a small head for each query.

The encoder, nearly all of the work, runs when the map changes. The head takes a few thousand
multiply-accumulates a block: the cost from a block to either end depends on the two places, which
the encoder has described, and on how they lie to each other.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from nnpp_edge.model.nnpp import ConvBNReLU, doubled, initialise
from nnpp_edge.model.registry import ARCHITECTURES
from nnpp_edge.runtime.kernels.encoding import BETWEEN_CHANNELS, END_CHANNELS
from nnpp_edge.runtime.kernels.place_head import ANSWERS
from nnpp_edge.runtime.network.model_file import QUERY_SPACING

MAP_CHANNELS = 2
UNSHUFFLE = 4
"""The map's input has 4 × 4 cells to a pixel, as channels."""
OUTPUT_SHUFFLE = QUERY_SPACING // ARCHITECTURES["edge"].stride
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
        and start and goal (N, 15, S/8, S/8, `fill_ends` of the runtime). Four blocks to a pixel
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
        parts = []
        for layer in (self.way, self.both, self.across, self.between, self.mix, self.answer):
            parts.append(layer.weight.T.flatten())
            if layer.bias is not None:
                parts.append(layer.bias)
        return torch.cat(parts)

    def forward(self, described: Tensor, query: Tensor) -> Tensor:
        side = described.shape[-1]
        # (N, B·B, R) each: a place as one to pass through, and as an end
        place, end = described.flatten(2).transpose(1, 2).chunk(2, -1)
        # of both ends, (N, 2, ...): the weights that read a value there, and the way to it
        flat = query.flatten(2)
        ends = torch.unflatten(flat[:, : 2 * END_CHANNELS], 1, (2, END_CHANNELS))
        weights = ends[:, :, 0]
        way = ends[:, :, 1:].transpose(2, 3)
        at_ends = weights @ end
        related = functional.relu(place[:, None] + at_ends[:, :, None] + self.way(way))
        # how each end is related to the other
        across = weights.flip(1)[:, :, None] @ related
        between = self.between(flat[:, 2 * END_CHANNELS :].transpose(1, 2))
        relations = self.both(related.sum(1)) + self.across(across.sum(1)) + between
        answer = self.answer(functional.relu(self.mix(functional.relu(relations))))
        return torch.unflatten(answer.transpose(1, 2), 2, (side, side))


class FeaturePyramid(nn.Module):
    """Down from 1/8 resolution to 1/64, and up again, with so many channels."""

    def __init__(
        self,
        at8: int,
        at16: int,
        at32: int,
        at64: int,
    ) -> None:
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
        at64 = self.down64(at32)
        up32 = self.up32(at64, at32)
        up16 = self.up16(up32, at16)
        up8: Tensor = self.up8(up16, at8)
        return up8


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
        merged: Tensor = self.merge(shallow + doubled(self.match(deep)))
        return merged
