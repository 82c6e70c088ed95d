"""A trained network as one ONNX file that the runtime can check and run."""

import ast
import copy
import json
import logging
import math
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from nnpp_edge import __version__
from nnpp_edge.export.in_parts import ask_for_the_head
from nnpp_edge.files import write_whole
from nnpp_edge.model import edge
from nnpp_edge.model.macs import count_macs
from nnpp_edge.model.registry import Network, Spec
from nnpp_edge.model.split import SplitNet
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.network.encoding import ENDS_CHANNELS, PAIR_CHANNELS
from nnpp_edge.runtime.network.inference import HEAD, METADATA_KEY, OUTPUT, PLACES, ModelMetadata
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.dataset import Recipe
from nnpp_edge.training.train import load_checkpoint

OPSET = 18
"""The oldest that torch's exporter writes of itself, so that older onnxruntimes read the file too."""


@dataclass(frozen=True)
class ExportReport:
    """What was written."""

    path: str
    size_bytes: int
    opset: int
    """As read back from the file."""
    nodes: int
    operators: dict[str, int]
    """How many nodes of each kind."""
    inputs: dict[str, tuple[int, ...]]
    output: tuple[int, ...]
    macs: int
    """Multiply-accumulates of one query."""
    metadata: dict[str, Any]

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(asdict(self))


def export_onnx(
    checkpoint: Path,
    output: Path,
    *,
    name: str,
    region_factor: float = 0.5,
    omega: float = PAPER_OMEGA,
    opset: int = OPSET,
    training: dict[str, Any] | None = None,
) -> ExportReport:
    """Write a checkpoint's averaged network as ONNX: `export_network`, with the checkpoint's own facts."""
    network, saved = load_checkpoint(checkpoint)
    facts = checkpoint_facts(saved) | (training or {})
    return export_network(
        network, output, name=name, region_factor=region_factor, omega=omega, opset=opset, training=facts
    )


def export_network(
    network: Network,
    output: Path,
    *,
    name: str,
    region_factor: float = 0.5,
    omega: float = PAPER_OMEGA,
    opset: int = OPSET,
    training: dict[str, Any] | None = None,
) -> ExportReport:
    """Write a network as ONNX, whole or not at all.

    Parameters
    ----------
    network : Network
        In evaluation mode or not: its norms' running statistics are what is written.
    output : Path
        The file; weights and metadata are inside.
    name : str
        Of the model, in its metadata.
    region_factor : float
        Factor on the adaptive threshold that the runtime is to use, in (0, 1].
    omega : float
        Weight of the traversability cost per grey level that the labels were made with.
    opset : int
        Asked for; the report tells what the file has.
    training : dict
        Facts on the training, for the metadata.

    Raises
    ------
    ModelError
        A number is out of range.
    OutputError
        The file cannot be written.
    """
    spec = network.spec
    apart = spec.architecture != "nnpp"
    facts = ModelMetadata(
        name=name,
        architecture=spec.architecture,
        input_size=spec.input_size,
        blocks=spec.blocks,
        encoding=spec.encoding,
        channels=("cost", "blocked", spec.encoding) if apart else ("cost", "start_map", "goal_map"),
        sigma=spec.sigma,
        omega=omega,
        cost_limits={k: v for k, v in asdict(Traversability()).items() if math.isfinite(v)},
        region_factor=region_factor,
        map_unshuffle=edge.UNSHUFFLE if apart else 1,
        output_shuffle=edge.QUERY_STRIDE // edge.OUTPUT_STRIDE if apart else 1,
        head=network.body.head.sizes if isinstance(network.body, SplitNet) else (),
        training=training or {},
        version=__version__,
    )
    ModelMetadata.from_json(facts.to_json(), str(output))  # what the runtime would refuse is not written
    model = to_onnx(network, opset)
    onnx.helper.set_model_props(model, {METADATA_KEY: facts.to_json()})
    onnx.checker.check_model(model, full_check=True)
    write_whole(output, model.SerializeToString())
    return describe(output, count_macs(network.body, tuple(example_inputs(spec).values())))


def to_onnx(network: Network, opset: int = OPSET) -> onnx.ModelProto:
    """The network's graph for one query: norms folded, fixed shapes, a sigmoid at the end."""
    if opset < OPSET:
        raise ModelError(f"opset must be at least {OPSET}, got {opset}")
    inputs = example_inputs(network.spec)
    split = network.spec.architecture == "split"
    wrapped, outputs = (_InParts, [OUTPUT, PLACES, HEAD]) if split else (_Answer, [OUTPUT])
    with _quiet():
        program = torch.onnx.export(
            wrapped(fold_norms(network)),
            tuple(inputs.values()),
            input_names=list(inputs),
            output_names=outputs,
            opset_version=opset,
            dynamo=True,
            external_data=False,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    _tidy(model.graph)
    if split:
        ask_for_the_head(model)
    return model


def fold_norms(network: Network) -> nn.Module:
    """A copy of the network's body in which each batch norm that follows a convolution is part of it."""
    body = copy.deepcopy(network.body).eval()
    for module in body.modules():
        if isinstance(module, nn.Sequential):
            for i in range(len(module) - 1):
                conv, norm = module[i], module[i + 1]
                if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                    module[i], module[i + 1] = fuse_conv_bn_eval(conv, norm), nn.Identity()
    return body


def example_inputs(spec: Spec) -> dict[str, Tensor]:
    """Names and shapes of the graph's inputs, in order; the values mean nothing."""
    size = spec.input_size
    if spec.architecture == "nnpp":
        return {"input": torch.zeros(1, 3, size, size)}
    map_side, query_side = size // edge.UNSHUFFLE, size // edge.QUERY_STRIDE
    channels = ENDS_CHANNELS if spec.architecture == "split" else PAIR_CHANNELS
    return {
        "map": torch.zeros(1, edge.MAP_CHANNELS * edge.UNSHUFFLE**2, map_side, map_side),
        "query": torch.zeros(1, channels, query_side, query_side),
    }


def checkpoint_facts(saved: dict[str, Any]) -> dict[str, Any]:
    """What a checkpoint tells of its training, for a model's metadata."""
    try:
        progress, settings = saved["progress"], saved["settings"]
        return {
            "steps": int(progress["step"]),
            "epochs": int(progress["epoch"]),
            "seconds": round(float(progress["spent_s"]), 1),
            **{k: settings[k] for k in ("batch", "learning_rate", "weight_decay", "target", "softness", "seed")},
        }
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"wanted a checkpoint with its progress and settings, got one without {error}") from error


def dataset_facts(recipe: Recipe) -> dict[str, Any]:
    """What decided a data set, for a model's metadata; terrain by the files' names alone."""
    return asdict(recipe) | {"terrain": [Path(name).name for name in recipe.terrain]}


def describe(path: Path, macs: int) -> ExportReport:
    """Read a written model back."""
    model = onnx.load(path)
    stored = {p.key: p.value for p in model.metadata_props}[METADATA_KEY]
    shapes = {
        value.name: tuple(d.dim_value for d in value.type.tensor_type.shape.dim)
        for value in (*model.graph.input, *model.graph.output)
    }
    return ExportReport(
        path=str(path),
        size_bytes=path.stat().st_size,
        opset=next(o.version for o in model.opset_import if o.domain in ("", "ai.onnx")),
        nodes=len(model.graph.node),
        operators=dict(Counter(node.op_type for node in model.graph.node).most_common()),
        inputs={value.name: shapes[value.name] for value in model.graph.input},
        output=shapes[OUTPUT],
        macs=macs,
        metadata=json.loads(stored),
    )


class _Answer(nn.Module):
    """The body with its logits turned into probabilities."""

    def __init__(self, body: nn.Module) -> None:
        super().__init__()
        self.body = body

    def forward(self, *inputs: Tensor) -> Tensor:
        return torch.sigmoid(self.body(*inputs))


class _InParts(nn.Module):
    """A network in two parts, whose outputs are all that the runtime needs of it."""

    def __init__(self, body: nn.Module) -> None:
        super().__init__()
        assert isinstance(body, SplitNet)
        self.body = body

    def forward(self, planes: Tensor, query: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        places = self.body.encoder(planes)
        return torch.sigmoid(self.body.head(places, query)), places, self.body.head.parameters_in_order()


def _tidy(graph: onnx.GraphProto) -> None:
    """Name each node by the module it comes from, and drop the exporter's traces, which hold local paths."""
    taken: Counter[str] = Counter()
    for node in graph.node:
        facts = {p.key: p.value for p in node.metadata_props}
        scopes = ast.literal_eval(facts.get("pkg.torch.onnx.name_scopes", "[]"))
        module = scopes[-2].removeprefix("body").strip(".") if len(scopes) > 1 else ""
        name = f"{module}/{node.op_type}" if module else node.op_type
        taken[name] += 1
        node.name = name if taken[name] == 1 else f"{name}_{taken[name]}"
        del node.metadata_props[:]
        node.doc_string = ""
    for value in (*graph.value_info, *graph.input, *graph.output, *graph.initializer, graph):
        del value.metadata_props[:]
        value.doc_string = ""


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the exporter's notes, none of which is for the user, off stderr."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
