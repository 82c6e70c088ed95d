"""A network in two parts: an encoder that sees the map alone, and a small head for each query.

The encoder, nearly all of the work, runs when the map changes. The head is a few thousand multiply-accumulates a
block: what it costs to get from a block to either end is a matter of the two places, which the encoder has described,
and of how they lie to each other.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from nnpp_edge.model.edge import (
    MAP_CHANNELS,
    OUTPUT_STRIDE,
    PRIOR_LOGIT,
    QUERY_STRIDE,
    UNSHUFFLE,
    ConvBlock,
    Pyramid,
    check_input,
)
from nnpp_edge.runtime.network.encoding import END_CHANNELS, PAIR_CHANNELS
from nnpp_edge.runtime.network.place_head import ANSWERS

assert ANSWERS == (QUERY_STRIDE // OUTPUT_STRIDE) ** 2


class Encoder(nn.Module):
    """The map's two descriptions of each place: as one to pass through, and as an end of a path."""

    def __init__(self, widths: tuple[int, ...], stem: int, depth: tuple[int, ...], relation: int) -> None:
        super().__init__()
        self.stem = ConvBlock(MAP_CHANNELS * UNSHUFFLE**2, stem, stride=2)
        self.widen = ConvBlock(stem, widths[0])
        self.pyramid = Pyramid(widths, depth)
        self.describe = nn.Conv2d(widths[0], 2 * relation, 1)

    def forward(self, planes: Tensor) -> Tensor:
        """(N, 32, S/4, S/4) to (N, 2R, S/8, S/8)."""
        return self.describe(self.pyramid(self.widen(self.stem(planes))))


class Head(nn.Module):
    """From the places' descriptions and a query to logits.

    Parameters
    ----------
    relation : int
        R, numbers that relate a place to an end.
    hidden : two ints
        Units of the two layers after.
    """

    def __init__(self, relation: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        first, second = hidden
        self.sizes = (relation, first, second)
        self.way = nn.Linear(END_CHANNELS - 1, relation)
        self.both = nn.Linear(relation, first)
        self.across = nn.Linear(relation, first, bias=False)
        self.between = nn.Linear(PAIR_CHANNELS, first, bias=False)
        self.mix = nn.Linear(first, second)
        self.answer = nn.Linear(second, ANSWERS)

    def parameters_in_order(self) -> Tensor:
        """All of them in a row, in the order and layout of `runtime.place_head.parameter_shapes`."""
        layers = self.way, self.both, self.across, self.between, self.mix, self.answer
        parts = [part for layer in layers for part in (layer.weight.T, layer.bias) if part is not None]
        return torch.cat([part.flatten() for part in parts])

    def forward(self, described: Tensor, query: Tensor) -> Tensor:
        """(N, 2R, B, B) and (N, 15, B, B) to (N, 4, B, B)."""
        side = described.shape[-1]
        place, end = described.flatten(2).transpose(1, 2).chunk(2, -1)
        flat = query.flatten(2)
        ends = flat[:, : 2 * END_CHANNELS].unflatten(1, (2, END_CHANNELS))
        share, way = ends[:, :, 0], ends[:, :, 1:].transpose(2, 3)
        at_ends = share @ end
        related = functional.relu(place[:, None] + at_ends[:, :, None] + self.way(way))
        across = share.flip(1)[:, :, None] @ related  # how each end is related to the other
        between = self.between(flat[:, 2 * END_CHANNELS :].transpose(1, 2))
        x = functional.relu(self.both(related.sum(1)) + self.across(across.sum(1)) + between)
        x = self.answer(functional.relu(self.mix(x)))
        return x.transpose(1, 2).unflatten(2, (side, side))


class SplitNet(nn.Module):
    """An encoder of the map and a head for each query.

    Parameters
    ----------
    input_size : int
        Side S of the map; a multiple of 64.
    widths, stem, depth
        Of the encoder, as in `edge.EdgeNet`.
    relation, hidden
        Of the head.
    """

    def __init__(
        self, input_size: int = 64, widths: tuple[int, ...] = (32, 64, 64, 64), stem: int = 32,
        depth: tuple[int, ...] = (0, 1, 0, 0), relation: int = 32, hidden: tuple[int, ...] = (32, 16),
    ) -> None:  # fmt: skip
        super().__init__()
        check_input(input_size)
        self.encoder = Encoder(widths, stem, depth, relation)
        self.head = Head(relation, hidden)
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.Linear):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
        nn.init.normal_(self.head.answer.weight, std=0.01)
        nn.init.constant_(self.head.answer.bias, PRIOR_LOGIT)

    def forward(self, planes: Tensor, query: Tensor) -> Tensor:
        """Logits of the probability that a nearly optimal path passes.

        Parameters
        ----------
        planes : (N, 32, S/4, S/4) float
            The map's two planes, in [0, 1], 4 × 4 cells to a pixel (`torch.pixel_unshuffle`).
        query : (N, 15, S/8, S/8) float
            Start and goal (`runtime.encoding.encode_ends`).

        Returns
        -------
        (N, 4, S/8, S/8) float
            Four blocks of a quarter's resolution to a pixel (`torch.pixel_shuffle` puts them in place).
        """
        return self.head(self.encoder(planes), query)
