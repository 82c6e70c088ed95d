"""A network of any architecture behind one interface, the query as it is shown to it, and its
computational cost.
"""

import copy
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from nnpp_edge.model import edge
from nnpp_edge.model.nnpp import NNPP
from nnpp_edge.model.registry import Spec
from nnpp_edge.model.unseen import UnseenNet
from nnpp_edge.runtime.arrays import Array, Float32s
from nnpp_edge.runtime.kernels.encoding import ENDS_CHANNELS, GAUSSIAN_CHANNELS
from nnpp_edge.runtime.network.encoding import Point, encode_ends, encode_gaussian
from nnpp_edge.runtime.network.model_file import QUERY_SPACING

_BODIES: dict[str, Callable[..., nn.Module]] = {
    "edge": edge.EdgeNet,
    "nnpp": NNPP,
    "unseen": UnseenNet,
}
_BATCH = 32


class Network(nn.Module):
    """A network built from its `Spec`."""

    def __init__(self, spec: Spec) -> None:
        super().__init__()
        self.spec = spec
        size = (spec.input_size,) if spec.architecture == "nnpp" else ()
        self.body = _BODIES[spec.architecture](*size, **spec.options)

    def forward(self, planes: Tensor, query: Tensor) -> Tensor:
        """Logits (N, B, B) on blocks × blocks.

        For planes (N, 2, S, S), mean cost and share of impassable cells in [0, 1], or as uint8 in
        255ths (the paper's network is shown the first alone), and start and goal (N, C, E, E), from
        `encode`. A network that prices unseen ground is shown planes of its own (`encode_unseen`)
        and no query, and has three logits: (N, 3, B, B).
        """
        if not planes.is_floating_point():
            planes = planes.float() / 255.0
        if self.spec.architecture == "unseen":
            logits: Tensor = self.body(planes)
            return logits
        if self.spec.architecture == "nnpp":
            logits = self.body(torch.cat((planes[:, :1], query), 1))
        else:
            small = torch.pixel_unshuffle(planes, edge.UNSHUFFLE)
            logits = torch.pixel_shuffle(self.body(small, query), edge.OUTPUT_SHUFFLE)
        return logits[:, 0]

    @torch.no_grad()
    def answers(self, planes: Array, queries: Float32s) -> Float32s:
        """The sigmoid of the logits for arrays of any length, in batches and evaluation mode."""
        self.eval()
        device = next(self.parameters()).device
        parts = []
        for at in range(0, len(planes), _BATCH):
            batch = (torch.from_numpy(each[at : at + _BATCH]) for each in (planes, queries))
            logits = self(*(each.to(device) for each in batch))
            parts.append(torch.sigmoid(logits.float()).cpu())
        return torch.cat(parts).numpy()


def encode(spec: Spec, start: Point, goal: Point) -> Float32s:
    """Start and goal, (row, col) in network cells, as they are shown to this network: (C, E, E)
    float32.
    """
    sigma = spec.sigma * spec.input_size
    if spec.encoding == "ends":
        side = spec.input_size // QUERY_SPACING
        query = np.empty((ENDS_CHANNELS, side, side), np.float32)
        encode_ends(start, goal, sigma, query)
    else:
        query = np.empty((GAUSSIAN_CHANNELS, spec.input_size, spec.input_size), np.float32)
        encode_gaussian(start, goal, sigma, query)
    return query


def count_macs(model: nn.Module, inputs: tuple[Tensor, ...]) -> int:
    """Multiply-accumulates of convolutions and matrix products in one forward pass over the whole
    batch.
    """
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        copy.deepcopy(model).eval()(*inputs)
    return int(counter.get_total_flops()) // 2
