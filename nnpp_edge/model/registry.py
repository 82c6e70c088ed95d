"""Architectures and presets by name: what a network is built from, and how it is shown start and
goal.

Nothing here needs torch, so that commands can list the names at once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from nnpp_edge.runtime.errors import ModelError

ENCODINGS = {"edge": "ends", "nnpp": "gaussian", "unseen": "unseen"}
"""The encoding of start and goal of each architecture."""

OUTPUT_STRIDES = {"edge": 4, "nnpp": 8, "unseen": 1}
"""Cells of the input to the side of a block of the output."""
SIZE_STEPS = {"edge": 64, "nnpp": 128, "unseen": 4}
"""Of the input's side in cells; the paper's network pools 1/32 of it to 4 × 4."""


def architecture_name(stored: str) -> str:
    """Today's name of an architecture that an older checkpoint or model file names."""
    return {"split": "edge"}.get(stored, stored)


@dataclass(frozen=True)
class Spec:
    """All that is needed to build a network and to feed it; ModelError for what no architecture is
    built for.
    """

    architecture: str
    """One of `ENCODINGS`; a former name is replaced by today's."""
    input_size: int = 256
    sigma: float = 0.25
    """Of the Gaussians around start and goal, as a share of the map's side (the paper's
    best: 1/4).
    """
    options: Mapping[str, int | Sequence[int]] = field(default_factory=dict)
    """Arguments of the network's constructor; lists become tuples."""

    def __post_init__(self) -> None:
        name = architecture_name(self.architecture)
        if name not in ENCODINGS:
            raise ModelError(
                f"architecture must be one of {', '.join(ENCODINGS)}, got {self.architecture!r}"
            )
        step = SIZE_STEPS[name]
        if self.input_size < step or self.input_size % step:
            raise ModelError(
                f"input_size must be a positive multiple of {step}, got {self.input_size}"
            )
        options = {
            key: tuple(v) if isinstance(v, Sequence) else v for key, v in self.options.items()
        }
        for key, value in {"architecture": name, "options": options}.items():
            object.__setattr__(self, key, value)

    @property
    def encoding(self) -> str:
        """How start and goal are shown."""
        return ENCODINGS[self.architecture]

    @property
    def blocks(self) -> int:
        """The output has blocks × blocks probabilities."""
        return self.input_size // OUTPUT_STRIDES[self.architecture]


PRESETS = {
    "edge": Spec("edge", input_size=64),
    "nnpp-w16": Spec("nnpp", options={"width": 16}),
    "nnpp": Spec("nnpp", options={"width": 64}),
    "unseen": Spec("unseen", input_size=64),
}
"""``edge`` runs its encoder once for each map and a small head for each query; ``nnpp`` is the
paper's network; ``unseen`` prices ground of which a coarse map alone is known."""
