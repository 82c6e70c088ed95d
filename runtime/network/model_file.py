"""Model files: where they are, and what they say of themselves."""

import hashlib
import json
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.graph_check import checked_metadata
from nnpp_edge.runtime.reading import problem_with_file, refused_as

METADATA_KEY = "nnpp_edge"
HEAD_KEY = "nnpp_edge_head"
"""Of the head's parameters, in networks with the encoding ``ends``."""
FORMAT: Final = "nnpp-edge-model-1"
UNSEEN = (
    "slope_across",
    "slope_down",
    "above_3",
    "above_7",
    "above_15",
    "slope",
    "step",
    "blocked_by_slope",
    "known",
    # the same of all blocks of a map
    "limited",
    "factor",
    "cell",
)
"""Planes of a coarse map, in order; `above_n` are differences between means over n × n blocks
(`network.unseen`).
"""
CHANNELS = {
    "gaussian": ("cost", "start_map", "goal_map"),
    "ends": ("cost", "blocked", "ends"),
    "unseen": UNSEEN,
}
"""Names of what a network is shown, in order, by its encoding."""
QUERY_SPACING = 8
"""Network cells between the points of a query that is encoded as ``ends``."""

Count = Annotated[int, msgspec.Meta(gt=0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]


@dataclass(frozen=True)
class ModelMetadata:
    """The terms of network and runtime; they travel in the ONNX file as JSON and are checked at
    load.
    """

    name: str
    architecture: str
    input_size: Annotated[int, msgspec.Meta(gt=0, le=4096)]
    """Side S of the network's square, in cells."""
    blocks: Count
    """The answer comes on blocks × blocks."""
    encoding: str
    """``gaussian`` (the paper's): cost, start and goal map in one input. ``ends``: an encoder
    sees the map alone. ``unseen``: no query, see `network.unseen`."""
    channels: tuple[str, ...]
    """Their order in the input."""
    sigma: Positive
    """Of the Gaussians, as a share of S."""
    omega: Positive
    """Weight of the traversability cost per grey level that the labels were made with."""
    cost_limits: dict[str, float]
    """Limits and weights of the cost maps that it was trained on."""
    region_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.5
    """Factor on the adaptive threshold, chosen on validation terrain."""
    head: tuple[Count, ...] = ()
    """With ``ends``: the numbers that relate a place to an end, and the units of the head's two
    hidden layers.
    """
    precision: str = "fp32"
    training: dict[str, object] = field(default_factory=dict)
    version: str = ""
    format: Literal["nnpp-edge-model-1"] = FORMAT

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(msgspec.to_builtins(self))

    @classmethod
    def from_json(cls, text: str | bytes | None, source: str) -> "ModelMetadata":
        """Read and check; ModelError names `source`, what was wanted and what came."""
        if not text:
            raise ModelError(
                f"{source}: wanted an ONNX model with '{METADATA_KEY}' metadata, got one without"
            )
        with refused_as(ModelError, f"{source}: wanted metadata of format {FORMAT}"):
            found = msgspec.json.decode(text, type=cls)
        if CHANNELS.get(found.encoding) != found.channels:
            got = f"{found.encoding!r} {found.channels}"
            raise ModelError(
                f"{source}: wanted encoding and channels to be one of {CHANNELS}, got {got}"
            )
        in_parts = found.encoding == "ends"
        blocks = found.blocks
        size = found.input_size
        fits = size % blocks == 0 and (blocks == 2 * (size // QUERY_SPACING) or not in_parts)
        if not fits or len(found.head) != 3 * in_parts:
            raise ModelError(
                f"{source}: its metadata holds numbers that do not go together: {found}"
            )
        return found


@dataclass(frozen=True)
class ModelFile:
    """A model file, with its metadata and card."""

    name: str
    """The file's, without its ending: what `model_path` takes if the model is shipped."""
    path: Path
    size_bytes: int
    sha256: str
    metadata: ModelMetadata
    card: str | None
    """Text of the Markdown file beside it, with what was measured."""

    def summary(self) -> dict[str, object]:
        """For JSON: all but the card."""
        facts: dict[str, object] = msgspec.to_builtins(self, enc_hook=str)
        del facts["card"]
        return facts


def model_path(name: str | Path) -> Path:
    """Path of a shipped model by its name (``edge``), or of a model file; ModelError where there is
    neither.
    """
    if (shipped := _shipped().get(str(name))) is not None:
        return shipped
    path = Path(name)
    if (problem := problem_with_file(path)) is None:
        return path
    raise ModelError(
        f"wanted a model file or the name of a shipped model ({', '.join(_shipped())}), got "
        f"{str(name)!r} ({problem})"
    )


def read_metadata(path: Path, content: bytes | None = None) -> ModelMetadata:
    """A model's metadata; ModelError where they cannot be read, or `checked_metadata` refuses the
    file.
    """
    found = checked_metadata(_bytes(path) if content is None else content, str(path))
    return ModelMetadata.from_json(found.get(METADATA_KEY.encode()), str(path))


def list_models() -> list[ModelFile]:
    """The shipped models, by name."""
    return [read_model_file(name) for name in _shipped()]


@cache
def _shipped() -> dict[str, Path]:
    """The shipped models' files, by name."""
    folder = Path(str(files("nnpp_edge.models")))
    return dict(sorted((path.stem, path) for path in folder.glob("*.onnx")))


def read_model_file(model: str | Path = "edge") -> ModelFile:
    """All about a shipped model, by its name, or an ONNX file with our metadata.

    Beside MODEL.onnx may lie MODEL.md, the card. ModelError where the file is missing, truncated or
    without our metadata.
    """
    path = model_path(model)
    content = _bytes(path)
    card = path.with_suffix(".md")
    return ModelFile(
        name=path.stem,
        path=path,
        size_bytes=len(content),
        sha256=hashlib.sha256(content).hexdigest(),
        metadata=read_metadata(path, content),
        card=_bytes(card).decode(errors="replace") if problem_with_file(card) is None else None,
    )


def _bytes(path: Path) -> bytes:
    with refused_as(ModelError, f"{path}: wanted a file to read"):
        return path.read_bytes()
