"""Networks by name, and what each is fed with."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from nnpp_edge.model import edge, nnpp, split
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.encoding import (
    ENDS_CHANNELS,
    GAUSSIAN_CHANNELS,
    PAIR_CHANNELS,
    encode_ends,
    encode_gaussian,
    encode_pair,
)

ENCODINGS = {"edge": ("pair",), "split": ("ends",), "nnpp": ("gaussian", "euclidean", "pixel")}
"""``euclidean`` and ``pixel`` are what the paper compares its Gaussians with (Fig. 13): training knows them, the
runtime does not."""


@dataclass(frozen=True)
class Spec:
    """Architecture and input of a network: all that is needed to build it and to feed it."""

    architecture: str
    """``edge``, ``split`` or ``nnpp``."""
    input_size: int = 256
    sigma: float = 0.25
    """Of the Gaussian encoding, as a share of the map's side (the paper's best: 1/4)."""
    options: dict[str, Any] = field(default_factory=dict)
    """Arguments of the network's constructor."""
    encoding: str = ""
    """How start and goal are shown, one of `ENCODINGS`; by default the first of the architecture's."""

    def __post_init__(self) -> None:
        """Fill in the default; ModelError for an encoding that the architecture is not built for."""
        known = ENCODINGS.get(self.architecture)
        if known is None:
            raise ModelError(f"architecture must be one of {', '.join(ENCODINGS)}, got {self.architecture!r}")
        if not self.encoding:
            object.__setattr__(self, "encoding", known[0])
        elif self.encoding not in known:
            wanted = f"encoding of {self.architecture} must be one of {', '.join(known)}"
            raise ModelError(f"{wanted}, got {self.encoding!r}")

    @property
    def blocks(self) -> int:
        """The answer comes on blocks × blocks."""
        stride = nnpp.OUTPUT_STRIDE if self.architecture == "nnpp" else edge.OUTPUT_STRIDE
        return self.input_size // stride

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for checkpoints."""
        return asdict(self)


PRESETS = {
    "edge": Spec("split", input_size=64),
    "edge-joint": Spec(
        "edge", input_size=64, options={"widths": [32, 64, 64, 64], "stem": 32, "depth": [0, 1, 0, 0]}
    ),
    "edge-128": Spec("edge", input_size=128, options={"widths": [16, 32, 64, 64], "stem": 16, "depth": [0, 1, 1, 0]}),
    "edge-256": Spec("edge"),
    "nnpp-w16": Spec("nnpp", options={"width": 16}),
    "nnpp": Spec("nnpp", options={"width": 64}),
    "nnpp-stdc2": Spec("nnpp", options={"width": 64, "depth": [4, 5, 3]}),
}
"""``edge`` sees the map once, and each query with a small head; ``edge-joint`` sees both together at each query,
``edge-128`` and ``edge-256`` do so at twice and four times the resolution, with twice and 37 times the work; ``nnpp``
is the paper's network at full width and ``nnpp-w16`` the same at a quarter of it."""


class Network(nn.Module):
    """A network behind one face, whatever it is fed with."""

    def __init__(self, spec: Spec) -> None:
        super().__init__()
        self.spec = spec
        options: dict[str, Any] = {k: tuple(v) if isinstance(v, Sequence) else v for k, v in spec.options.items()}
        if spec.architecture == "edge":
            self.body: nn.Module = edge.EdgeNet(spec.input_size, **options)
        elif spec.architecture == "split":
            self.body = split.SplitNet(spec.input_size, **options)
        else:
            self.body = nnpp.NNPP(spec.input_size, **options)

    def forward(self, planes: Tensor, query: Tensor) -> Tensor:
        """Logits on blocks × blocks.

        Parameters
        ----------
        planes : (N, 2, S, S) float
            Mean cost and share of impassable cells, in [0, 1]; the paper's network sees the first alone.
        query : (N, C, E, E) float
            Start and goal, as `encode` gives them.

        Returns
        -------
        (N, B, B) float
        """
        if self.spec.architecture == "nnpp":
            return self.body(torch.cat((planes[:, :1], query), 1))[:, 0]
        small = torch.pixel_unshuffle(planes, edge.UNSHUFFLE)
        return torch.pixel_shuffle(self.body(small, query), edge.QUERY_STRIDE // edge.OUTPUT_STRIDE)[:, 0]


def encode(spec: Spec, start: Sequence[float], goal: Sequence[float]) -> NDArray[np.float32]:
    """Start and goal as this network is shown them: (C, E, E) float32."""
    sigma = spec.sigma * spec.input_size
    s, g = (float(start[0]), float(start[1])), (float(goal[0]), float(goal[1]))
    if spec.encoding in ("pair", "ends"):
        side = spec.input_size // edge.QUERY_STRIDE
        channels, write = (PAIR_CHANNELS, encode_pair) if spec.encoding == "pair" else (ENDS_CHANNELS, encode_ends)
        out = np.empty((channels, side, side), np.float32)
        write(s, g, side, edge.QUERY_STRIDE, sigma, out)
        return out
    out = np.zeros((GAUSSIAN_CHANNELS, spec.input_size, spec.input_size), np.float32)
    if spec.encoding == "gaussian":
        encode_gaussian(s, g, spec.input_size, 1, sigma, out)
    elif spec.encoding == "pixel":
        for plane, (row, col) in zip(out, (s, g), strict=True):
            plane[round(row), round(col)] = 1.0
    else:
        axis = np.arange(spec.input_size, dtype=np.float32)
        for plane, (row, col) in zip(out, (s, g), strict=True):
            plane[:] = np.hypot(axis[:, None] - row, axis - col) / (math.sqrt(2.0) * spec.input_size)
    return out
