"""A network of any architecture behind one interface, the query as it is shown it, and what it
costs.
"""

import copy
from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from nnpp_edge.model import edge
from nnpp_edge.model.nnpp import NNPP
from nnpp_edge.model.registry import Spec
from nnpp_edge.model.unseen import UnseenNet
from nnpp_edge.runtime.kernels.encoding import ENDS_CHANNELS, GAUSSIAN_CHANNELS
from nnpp_edge.runtime.network.encoding import encode_ends, encode_gaussian
from nnpp_edge.runtime.network.model_file import QUERY_SPACING

_BODIES: dict[str, Callable[..., nn.Module]] = {
    "edge": edge.EdgeNet,
    "nnpp": NNPP,
    "unseen": UnseenNet,
}


class Network(nn.Module):
    """A network built from its `Spec`."""

    def __init__(self, spec: Spec) -> None:
        super().__init__()
        self.spec = spec
        size = (spec.input_size,) if spec.architecture == "nnpp" else ()
        self.body = _BODIES[spec.architecture](*size, **spec.options)

    def forward(self, planes: Tensor, query: Tensor) -> Tensor:
        """Logits (N, B, B) on blocks × blocks.

        For planes (N, 2, S, S), mean cost and share of impassable cells in [0, 1] (the paper's
        network is shown the first alone), and start and goal (N, C, E, E), from `encode`. A network
        that prices unseen ground is shown planes of its own (`encode_unseen`) and no query, and has
        three logits: (N, 3, B, B).
        """
        if self.spec.architecture == "unseen":
            answers: Tensor = self.body(planes)
            return answers
        if self.spec.architecture == "nnpp":
            logits: Tensor = self.body(torch.cat((planes[:, :1], query), 1))
        else:
            small = torch.pixel_unshuffle(planes, edge.UNSHUFFLE)
            logits = torch.pixel_shuffle(self.body(small, query), edge.OUTPUT_SHUFFLE)
        return logits[:, 0]


def encode(spec: Spec, start: Sequence[float], goal: Sequence[float]) -> NDArray[np.float32]:
    """Start and goal, (row, col) in network cells, as this network is shown them: (C, E, E)
    float32.
    """
    size = spec.input_size
    sigma = spec.sigma * spec.input_size
    ends = (float(start[0]), float(start[1])), (float(goal[0]), float(goal[1]))
    if spec.encoding == "ends":
        side = size // QUERY_SPACING
        out = np.empty((ENDS_CHANNELS, side, side), np.float32)
        encode_ends(*ends, sigma, out)
        return out
    out = np.empty((GAUSSIAN_CHANNELS, size, size), np.float32)
    encode_gaussian(*ends, sigma, out)
    return out


def count_macs(model: nn.Module, inputs: tuple[Tensor, ...]) -> int:
    """Multiply-accumulates of convolutions and matrix products in one forward pass over the whole
    batch.
    """
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        copy.deepcopy(model).eval()(*inputs)
    return int(counter.get_total_flops()) // 2
