"""Model files: where they are, what they say of themselves, and what was measured with them."""

import hashlib
import itertools
import json
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from nnpp_edge.runtime.errors import ModelError, NnppEdgeError
from nnpp_edge.runtime.network.graph_check import checked_metadata
from nnpp_edge.runtime.reading import problem_with_file

if TYPE_CHECKING:
    from onnxruntime import InferenceSession, SessionOptions

METADATA_KEY = "nnpp_edge"
FORMAT = "nnpp-edge-model-1"
FIGURES_FORMAT = "nnpp-edge-figures-1"
FIGURE_NAMES = (
    *("workload", "size", "method", "n", "success_raw", "success", "gap_mean", "gap_p99"),
    *("time_ms_median", "time_ms_p99", "speedup_median", "speedup_total", "mm_mean"),
)
"""The keys that every row of figures has, as `nnpp-edge evaluate --json` prints them."""

_CHANNELS = {
    "gaussian": ("cost", "start_map", "goal_map"),
    "ends": ("cost", "blocked", "ends"),
}
_MOST_CELLS = 4096
"""To a side of a network's input."""
_DEEPEST = 20
"""Lists and objects inside one another in the facts of a training."""
_MODELS = Path(str(files("nnpp_edge.models")))


@dataclass(frozen=True)
class ModelMetadata:
    """What network and runtime must agree on; travels in the ONNX file as JSON and is checked at load."""

    name: str
    architecture: str
    input_size: int
    """Side S of the network's square, in cells."""
    blocks: int
    """The answer comes on blocks × blocks."""
    encoding: str
    """``gaussian`` (the paper's): cost, start and goal map in one input. ``ends``: an encoder sees the map alone."""
    channels: tuple[str, ...]
    """Their order in the input."""
    sigma: float
    """Of the Gaussians, as a share of S."""
    omega: float
    """Weight of the traversability cost per grey level that the labels were made with."""
    cost_limits: dict[str, float]
    """Limits and weights of the cost maps that it was trained on."""
    region_factor: float = 0.5
    """Factor on the adaptive threshold, chosen on validation terrain."""
    map_unshuffle: int = 1
    """The map's input has this many cells, squared, to a pixel, as channels."""
    output_shuffle: int = 1
    """The output has this many blocks, squared, to a pixel, as channels."""
    head: tuple[int, ...] = ()
    """With ``ends``: the numbers that relate a place to an end, and the units of the head's two hidden layers."""
    precision: str = "fp32"
    training: dict[str, object] = field(default_factory=dict)
    version: str = ""
    format: str = FORMAT

    def facts(self) -> dict[str, object]:
        """All of it, as it stands in the file."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(self.facts())

    @classmethod
    def from_json(cls, text: str | bytes | None, source: str) -> "ModelMetadata":
        """Read and check; ModelError names `source`, what was wanted and what came."""
        if not text:
            raise ModelError(f"{source}: wanted an ONNX model with '{METADATA_KEY}' metadata, got one without")
        try:
            stored = json.loads(text)
            if not isinstance(stored, dict) or stored.get("format") != FORMAT:
                got = stored.get("format") if isinstance(stored, dict) else stored
                raise ModelError(f"{source}: wanted metadata of format {FORMAT}, got {got!r}")
            found = msgspec.convert(stored, cls)
            wanted = _CHANNELS.get(found.encoding)
            numbers_fit = (
                0 < found.blocks <= found.input_size <= _MOST_CELLS
                and found.input_size % found.blocks == 0
                and 0.0 < found.region_factor <= 1.0
                and all(0.0 < number < math.inf for number in (found.sigma, found.omega))
                and min(found.map_unshuffle, found.output_shuffle) > 0
                and len(found.head) == (3 if found.encoding == "ends" else 0)
                and all(size > 0 for size in found.head)
                and _depth(found.training) <= _DEEPEST
            )
        except (ValueError, RecursionError, msgspec.ValidationError) as error:
            if isinstance(error, ModelError):
                raise
            raise ModelError(f"{source}: its metadata cannot be read: {error}") from error
        if wanted is None or found.channels != wanted:
            raise ModelError(
                f"{source}: wanted encoding and channels to be one of {_CHANNELS}, "
                f"got {found.encoding!r} {found.channels}"
            )
        if not numbers_fit:
            raise ModelError(f"{source}: its metadata holds numbers out of range: {found}")
        return found


def _depth(value: object) -> int:
    """How many lists and objects lie inside one another."""
    depth, level = 0, [value]
    while level:
        inner = [v.values() if isinstance(v, dict) else v for v in level if isinstance(v, dict | list)]
        depth, level = depth + 1, list(itertools.chain.from_iterable(inner))
    return depth


@dataclass(frozen=True)
class Figures:
    """What was measured with a model; in the JSON file beside it."""

    rows: list[dict[str, str | float | None]]
    """With the keys of `FIGURE_NAMES`; the planners that it was compared with have rows of their own."""
    commands: list[str]
    """That printed the rows."""
    machine: str
    """They ran on."""


class _FigureFile(msgspec.Struct):
    """The file that figures are read from."""

    model_sha256: str
    figures: list[dict[str, str | float | None]]
    commands: list[str]
    machine: str


@dataclass(frozen=True)
class ModelFile:
    """What a model file says of itself."""

    name: str
    """The file's, without its ending: what `model_path` takes if the model is shipped."""
    path: Path
    size_bytes: int
    sha256: str
    metadata: ModelMetadata
    inputs: dict[str, tuple[int | str, ...]]
    """Shape of each; a dimension that is not fixed has its name, or ``?``."""
    outputs: dict[str, tuple[int | str, ...]]
    producer: str
    """The program that wrote the file."""
    figures: Figures | None
    card: str | None
    """Text of the Markdown file beside it."""

    def summary(self) -> dict[str, object]:
        """For JSON: all but the card."""
        figures = self.figures
        return {
            "name": self.name,
            "path": str(self.path),
            "size_bytes": self.size_bytes,
            "sha256": self.sha256,
            "metadata": self.metadata.facts(),
            "inputs": self.inputs,
            "outputs": self.outputs,
            "producer": self.producer,
            "figures": figures and figures.rows,
            "commands": figures and figures.commands,
            "machine": figures and figures.machine,
        }


def model_path(name: str | Path) -> Path:
    """Path of a shipped model by its name (``edge``), or of a model file.

    Raises
    ------
    ModelError
        There is neither.
    """
    shipped = _MODELS / f"{name}.onnx"
    for path in (shipped, Path(name)):
        if (problem := problem_with_file(path)) is None:
            return path
    names = ", ".join(sorted(p.stem for p in _MODELS.glob("*.onnx"))) or "none"
    raise ModelError(f"wanted a model file or the name of a shipped model ({names}), got {str(name)!r} ({problem})")


def read_metadata(path: Path) -> ModelMetadata:
    """What a model says of itself; ModelError where it cannot be read, or `checked_metadata` refuses the file."""
    return _metadata_in(_bytes(path), path)


def _metadata_in(content: bytes, path: Path) -> ModelMetadata:
    text = checked_metadata(content, str(path)).get(METADATA_KEY.encode())
    return ModelMetadata.from_json(text, str(path))


def open_session(path: Path, options: "SessionOptions | None" = None) -> "InferenceSession":
    """onnxruntime's session of a model file; by default one that does not prepare the network for speed.

    Raises
    ------
    ModelError
        The file does not load.

    Notes
    -----
    `read_metadata` is to be called first: it refuses what onnxruntime would never come back from.
    """
    import onnxruntime as ort

    if options is None:
        options = ort.SessionOptions()
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4
    with model_errors(path, "got a file that does not load"):
        return ort.InferenceSession(str(path), options, ["CPUExecutionProvider"], enable_fallback=0)


@contextmanager
def model_errors(path: Path, got: str) -> Iterator[None]:
    """Turn whatever onnxruntime raises over a model file into a ModelError of one line."""
    try:
        yield
    except NnppEdgeError:
        raise
    except Exception as error:  # onnxruntime's errors share no base class
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise ModelError(f"{path}: wanted an ONNX model, {got}: {line}") from error


def list_models() -> list[ModelFile]:
    """The shipped models, by name."""
    return [read_model_file(path) for path in sorted(_MODELS.glob("*.onnx"), key=lambda path: path.stem)]


def read_model_file(model: str | Path = "edge") -> ModelFile:
    """What a model says of itself, and the card and the figures that lie beside it.

    Parameters
    ----------
    model : str or Path
        Name of a shipped model, or an ONNX file with our metadata.

    Raises
    ------
    ModelError
        The file is missing, truncated or without our metadata, or its figures cannot be read.

    Notes
    -----
    Beside MODEL.onnx may lie MODEL.md, the card, and MODEL.json, the figures: ``format``, ``model_sha256``,
    ``machine``, ``commands`` and ``figures``. Figures of another file of that name are left out with a warning.
    """
    path = model_path(model)
    content = _bytes(path)
    sha256 = hashlib.sha256(content).hexdigest()
    metadata = _metadata_in(content, path)
    session = open_session(path)
    with model_errors(path, "got one whose texts cannot be read"):
        facts = session.get_modelmeta()
        producer = facts.producer_name
        inputs, outputs = (
            {value.name: tuple(value.shape) for value in values}
            for values in (session.get_inputs(), session.get_outputs())
        )
    return ModelFile(
        name=path.stem,
        path=path,
        size_bytes=len(content),
        sha256=sha256,
        metadata=metadata,
        inputs=inputs,
        outputs=outputs,
        producer=producer,
        figures=_figures(path.with_suffix(".json"), sha256),
        card=_card(path.with_suffix(".md")),
    )


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: wanted a file to read, got: {error.strerror}") from error


def _card(path: Path) -> str | None:
    return _bytes(path).decode(errors="replace") if problem_with_file(path) is None else None


def _figures(path: Path, sha256: str) -> Figures | None:
    """Those in `path`; None if there is no such file, or it is a JSON file of another kind or another model."""
    if problem_with_file(path) is not None:
        return None
    try:
        stored = json.loads(_bytes(path))
        if not isinstance(stored, dict) or stored.get("format") != FIGURES_FORMAT:
            return None
        found = msgspec.convert(stored, _FigureFile)
        for row, key in itertools.product(found.figures, FIGURE_NAMES):
            if key not in row:
                raise ModelError(f"{path}: wanted figures as JSON, got some without {key!r}")
            if isinstance(row[key], str) != (key in ("workload", "method")):
                raise ModelError(f"{path}: wanted figures as JSON, got some whose {key} is {row[key]!r}")
    except (ValueError, RecursionError, msgspec.ValidationError) as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"{path}: wanted figures as JSON, got a file that cannot be read: {error}") from error
    if found.model_sha256 != sha256:
        warnings.warn(f"{path}: its figures are of another model file and are left out", stacklevel=3)
        return None
    return Figures(found.figures, found.commands, found.machine)
