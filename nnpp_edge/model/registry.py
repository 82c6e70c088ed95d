"""Architectures and presets by name: what a network is built from, and how start and goal are shown
to it.

Nothing here needs torch, so that commands can list the names at once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from nnpp_edge.runtime.errors import ModelError


class Architecture(NamedTuple):
    """Facts that all networks of an architecture share."""

    encoding: str
    """How start and goal are shown."""
    stride: int
    """Cells of the input to the side of a block of the output."""
    size_step: int
    """The input's side in cells is a multiple of this."""
    region_factor: float = 0.5
    """On the adaptive threshold: the best weights are chosen at it, and planners use the model at
    it.
    """


ARCHITECTURES = {
    "edge": Architecture("ends", 4, 64, region_factor=0.2),
    "nnpp": Architecture("gaussian", 8, 128),
    "unseen": Architecture("unseen", 1, 4),
}


def architecture_name(stored: str) -> str:
    """Today's name of an architecture that an older checkpoint or model file names."""
    return {"split": "edge"}.get(stored, stored)


@dataclass(frozen=True)
class Spec:
    """All that is needed to build a network and to feed it.

    ModelError for what no architecture is built for.
    """

    architecture: str
    """One of `ARCHITECTURES`; a former name is replaced by today's."""
    input_size: int = 256
    sigma: float = 0.25
    """Of the Gaussians around start and goal, as a share of the map's side (the paper's
    best: 1/4).
    """
    options: Mapping[str, int | Sequence[int]] = field(default_factory=dict)
    """Arguments of the network's constructor; lists become tuples."""

    def __post_init__(self) -> None:
        name = architecture_name(self.architecture)
        if name not in ARCHITECTURES:
            names = ", ".join(ARCHITECTURES)
            raise ModelError(f"architecture must be one of {names}, got {self.architecture!r}")
        step = ARCHITECTURES[name].size_step
        if self.input_size < step or self.input_size % step:
            raise ModelError(
                f"input_size must be a positive multiple of {step}, got {self.input_size}"
            )
        options = {
            key: tuple(value) if isinstance(value, Sequence) else value
            for key, value in self.options.items()
        }
        object.__setattr__(self, "architecture", name)
        object.__setattr__(self, "options", options)

    @property
    def encoding(self) -> str:
        """How start and goal are shown."""
        return ARCHITECTURES[self.architecture].encoding

    @property
    def region_factor(self) -> float:
        """On the adaptive threshold, by default."""
        return ARCHITECTURES[self.architecture].region_factor

    @property
    def blocks(self) -> int:
        """The output has blocks × blocks probabilities."""
        return self.input_size // ARCHITECTURES[self.architecture].stride


PRESETS = {
    "edge": Spec("edge", input_size=64),
    "nnpp-w16": Spec("nnpp", options={"width": 16}),
    "nnpp": Spec("nnpp", options={"width": 64}),
    "unseen": Spec("unseen", input_size=64),
}
"""``edge`` runs its encoder once for each map and a small head for each query; ``nnpp`` is the
paper's network; ``unseen`` prices ground of which only a coarse map is known."""
