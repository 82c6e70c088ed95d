"""A network of any architecture behind one interface, and its computational cost."""

import copy
from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from nnpp_edge.model import edge
from nnpp_edge.model.encoding import encode_ends, encode_gaussians
from nnpp_edge.model.nnpp import NNPP
from nnpp_edge.model.registry import Spec
from nnpp_edge.model.unseen import UnseenNet
from nnpp_edge.runtime.arrays import Array, Float32s

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

    @torch.no_grad()
    def shown(self, maps: Tensor, facts: Tensor) -> tuple[Tensor, ...]:
        """The arguments of `forward`, encoded in float32 on the device of both.

        For `maps` (N, 2, S, S), mean cost and share of impassable cells in [0, 1], or as uint8 in
        255ths (the paper's network is shown the first alone), and as `facts` start and goal
        (N, 2, 2), rows and columns in network cells. A network that prices unseen ground is shown
        the planes of `encode_unseen` as they are, and no facts.
        """
        if self.spec.architecture == "unseen":
            return (maps,)
        greatest = 1.0 if maps.is_floating_point() else 255.0
        if self.spec.architecture == "nnpp":  # written once: these are megabytes
            shown = torch.empty(len(maps), 3, *maps.shape[2:], device=maps.device)
            torch.div(maps[:, :1], greatest, out=shown[:, :1])
            encode_gaussians(self.spec, facts, shown[:, 1:])
            return (shown,)
        planes = torch.pixel_unshuffle(maps / greatest, edge.UNSHUFFLE)
        return planes, encode_ends(self.spec, facts)

    def forward(self, *shown: Tensor) -> Tensor:
        """Logits (N, B, B) on blocks × blocks; three of a network that prices unseen ground,
        (N, 3, B, B).
        """
        logits: Tensor = self.body(*shown)
        if self.spec.architecture == "unseen":
            return logits
        if self.spec.architecture == "edge":
            logits = torch.pixel_shuffle(logits, edge.OUTPUT_SHUFFLE)
        return logits[:, 0]

    @torch.no_grad()
    def answers(self, maps: Array, facts: Float32s) -> Float32s:
        """The sigmoid of the logits for arrays of any length, in batches and evaluation mode."""
        self.eval()
        device = next(self.parameters()).device
        parts = []
        for at in range(0, len(maps), _BATCH):
            batch = (torch.from_numpy(each[at : at + _BATCH]) for each in (maps, facts))
            logits = self(*self.shown(*(each.to(device) for each in batch)))
            parts.append(torch.sigmoid(logits.float()).cpu())
        return torch.cat(parts).numpy()


def count_macs(model: nn.Module, inputs: tuple[Tensor, ...]) -> int:
    """Multiply-accumulates of convolutions and matrix products in one forward pass over the whole
    batch.
    """
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        copy.deepcopy(model).eval()(*inputs)
    return int(counter.get_total_flops()) // 2
