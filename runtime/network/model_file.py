"""Model files: where they are, what they say of themselves, and what was measured with them."""

import hashlib
import json
import warnings
from dataclasses import asdict, dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.graph_check import checked_metadata
from nnpp_edge.runtime.reading import problem_with_file, refused_as

METADATA_KEY = "nnpp_edge"
FORMAT: Final = "nnpp-edge-model-1"
FIGURES_FORMAT = "nnpp-edge-figures-1"
FIGURE_NAMES = (
    *("workload", "size", "method", "n", "success_raw", "success", "gap_mean", "gap_p99"),
    *("time_ms_median", "time_ms_p99", "speedup_median", "speedup_total", "mm_mean"),
)
"""The keys that every row of figures has, as `nnpp-edge evaluate --json` prints them."""

_Row = msgspec.defstruct(
    "Row", [(name, str if name in ("workload", "method") else float | None) for name in FIGURE_NAMES]
)
_CHANNELS = {"gaussian": ("cost", "start_map", "goal_map"), "ends": ("cost", "blocked", "ends")}
QUERY_SPACING = 8
"""Network cells between the points of a query that is encoded as ``ends``."""
_DEEPEST = 20
"""Lists and objects inside one another in the facts of a training."""
_MODELS = Path(str(files("nnpp_edge.models")))

Count = Annotated[int, msgspec.Meta(gt=0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]


@dataclass(frozen=True)
class ModelMetadata:
    """The terms of network and runtime; they travel in the ONNX file as JSON and are checked at load."""

    name: str
    architecture: str
    input_size: Annotated[int, msgspec.Meta(gt=0, le=4096)]
    """Side S of the network's square, in cells."""
    blocks: Count
    """The answer comes on blocks × blocks."""
    encoding: str
    """``gaussian`` (the paper's): cost, start and goal map in one input. ``ends``: an encoder sees the map alone."""
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
    """With ``ends``: the numbers that relate a place to an end, and the units of the head's two hidden layers."""
    precision: str = "fp32"
    training: dict[str, object] = field(default_factory=dict)
    version: str = ""
    format: Literal["nnpp-edge-model-1"] = FORMAT

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes | None, source: str) -> "ModelMetadata":
        """Read and check; ModelError names `source`, what was wanted and what came."""
        if not text:
            raise ModelError(f"{source}: wanted an ONNX model with '{METADATA_KEY}' metadata, got one without")
        with refused_as(ModelError, f"{source}: wanted metadata of format {FORMAT}"):
            found = msgspec.json.decode(text, type=cls)
            too_deep = _depth(found.training) > _DEEPEST
        if _CHANNELS.get(found.encoding) != found.channels:
            got = f"{found.encoding!r} {found.channels}"
            raise ModelError(f"{source}: wanted encoding and channels to be one of {_CHANNELS}, got {got}")
        in_parts, blocks, size = found.encoding == "ends", found.blocks, found.input_size
        fits = size % blocks == 0 and (blocks == 2 * (size // QUERY_SPACING) or not in_parts)
        if too_deep or not fits or len(found.head) != 3 * in_parts:
            raise ModelError(f"{source}: its metadata holds numbers that do not go together: {found}")
        return found


def _depth(value: object) -> int:
    """How many lists and objects lie inside one another."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + max(map(_depth, inner), default=0)


class Figures(msgspec.Struct, rename={"rows": "figures"}):
    """Figures measured with a model; in the JSON file beside it."""

    rows: list[dict[str, str | float | None]]
    """With the keys of `FIGURE_NAMES`; the planners that it was compared with have rows of their own."""
    commands: list[str]
    """That printed the rows."""
    machine: str
    """They ran on."""
    model_sha256: str


@dataclass(frozen=True)
class ModelFile:
    """A model file, with its metadata, figures and card."""

    name: str
    """The file's, without its ending: what `model_path` takes if the model is shipped."""
    path: Path
    size_bytes: int
    sha256: str
    metadata: ModelMetadata
    figures: Figures | None
    card: str | None
    """Text of the Markdown file beside it."""

    def summary(self) -> dict[str, object]:
        """For JSON: all but the card."""
        facts, figures = asdict(self) | {"path": str(self.path)}, self.figures
        del facts["card"]
        measured = (figures.rows, figures.commands, figures.machine) if figures else (None, None, None)
        return facts | dict(zip(("figures", "commands", "machine"), measured, strict=True))


def model_path(name: str | Path) -> Path:
    """Path of a shipped model by its name (``edge``), or of a model file; ModelError where there is neither."""
    shipped = _MODELS / f"{name}.onnx"
    for path in (shipped, Path(name)):
        if (problem := problem_with_file(path)) is None:
            return path
    names = ", ".join(sorted(p.stem for p in _MODELS.glob("*.onnx"))) or "none"
    raise ModelError(f"wanted a model file or the name of a shipped model ({names}), got {str(name)!r} ({problem})")


def read_metadata(path: Path, content: bytes | None = None) -> ModelMetadata:
    """A model's metadata; ModelError where they cannot be read, or `checked_metadata` refuses the file."""
    found = checked_metadata(_bytes(path) if content is None else content, str(path))
    return ModelMetadata.from_json(found.get(METADATA_KEY.encode()), str(path))


def list_models() -> list[ModelFile]:
    """The shipped models, by name."""
    return [read_model_file(path) for path in sorted(_MODELS.glob("*.onnx"), key=lambda path: path.stem)]


def read_model_file(model: str | Path = "edge") -> ModelFile:
    """All about a shipped model, by its name, or an ONNX file with our metadata.

    Beside MODEL.onnx may lie MODEL.md, the card, and MODEL.json, the figures: ``format``, ``model_sha256``,
    ``machine``, ``commands`` and ``figures``. Figures of another file of that name are left out with a warning.
    ModelError where the file is missing, truncated or without our metadata, or its figures cannot be read.
    """
    path = model_path(model)
    content, card = _bytes(path), path.with_suffix(".md")
    sha256 = hashlib.sha256(content).hexdigest()
    return ModelFile(
        name=path.stem,
        path=path,
        size_bytes=len(content),
        sha256=sha256,
        metadata=read_metadata(path, content),
        figures=_figures(path.with_suffix(".json"), sha256),
        card=_bytes(card).decode(errors="replace") if problem_with_file(card) is None else None,
    )


def _bytes(path: Path) -> bytes:
    with refused_as(ModelError, f"{path}: wanted a file to read"):
        return path.read_bytes()


def _figures(path: Path, sha256: str) -> Figures | None:
    """Those in `path`; None if there is no such file, or it is a JSON file of another kind or another model."""
    if problem_with_file(path) is not None:
        return None
    with refused_as(ModelError, f"{path}: wanted figures as JSON"):
        stored = msgspec.json.decode(_bytes(path))
        if not isinstance(stored, dict) or stored.get("format") != FIGURES_FORMAT:
            return None
        found = msgspec.convert(stored, Figures)
        msgspec.convert(found.rows, list[_Row])  # type: ignore[valid-type]
    if found.model_sha256 != sha256:
        warnings.warn(f"{path}: its figures are of another model file and are left out", stacklevel=3)
        return None
    return found
