"""A trained network as one ONNX file that the runtime can check and run."""

import ast
import copy
import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import onnx
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from nnpp_edge import __version__
from nnpp_edge.export.optional_head import make_head_optional
from nnpp_edge.export.quiet import quiet
from nnpp_edge.files import write_whole
from nnpp_edge.model import edge
from nnpp_edge.model.edge import EdgeNet
from nnpp_edge.model.macs import count_macs
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.network.encoding import ENDS_CHANNELS
from nnpp_edge.runtime.network.inference import HEAD, METADATA_KEY, OUTPUT, PLACES, ModelMetadata
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.shards import Recipe

OPSET = 18
"""The oldest that torch's exporter writes of itself, so that older onnxruntimes read the file too."""


@dataclass(frozen=True)
class ExportReport:
    """What was written: the file's opset, its number of nodes by kind, and the shapes of inputs and probability."""

    path: str
    size_bytes: int
    opset: int
    nodes: int
    operators: dict[str, int]
    inputs: dict[str, tuple[int, ...]]
    output: tuple[int, ...]
    macs: int
    """Multiply-accumulates of one query."""
    metadata: dict[str, object]

    def to_json(self) -> str:
        """One line of JSON."""
        return msgspec.json.encode(self).decode()


def export_network(
    network: Network,
    output: Path,
    *,
    name: str,
    region_factor: float = 0.5,
    omega: float = PAPER_OMEGA,
    limits: Traversability | None = None,
    opset: int = OPSET,
    training: Mapping[str, object] | None = None,
) -> ExportReport:
    """Write a network as ONNX, whole or not at all.

    Parameters
    ----------
    network : Network
        In evaluation mode or not: its norms' running statistics are what is written.
    region_factor : float
        Factor on the adaptive threshold that the runtime is to use, in (0, 1].
    omega : float
        Weight of the traversability cost per grey level that the labels were made with.
    limits : Traversability, optional
        Of the cost maps that it was trained on; by default the paper's.
    opset : int
        Asked for; the report says what the file has.
    name, training
        For the metadata.

    Raises
    ------
    ModelError
        A number is out of range.
    OutputError
        The file cannot be written.
    """
    spec, body = network.spec, network.body
    facts = ModelMetadata(
        name=name,
        architecture=spec.architecture,
        input_size=spec.input_size,
        blocks=spec.blocks,
        encoding=spec.encoding,
        channels=("cost", "blocked", "ends") if isinstance(body, EdgeNet) else ("cost", "start_map", "goal_map"),
        sigma=spec.sigma,
        omega=omega,
        cost_limits={k: v for k, v in asdict(limits or Traversability()).items() if math.isfinite(v)},
        region_factor=region_factor,
        map_unshuffle=edge.UNSHUFFLE if isinstance(body, EdgeNet) else 1,
        output_shuffle=edge.OUTPUT_SHUFFLE if isinstance(body, EdgeNet) else 1,
        head=body.head.sizes if isinstance(body, EdgeNet) else (),
        training=dict(training or {}),
        version=__version__,
    )
    ModelMetadata.from_json(facts.to_json(), str(output))  # what the runtime would refuse is not written
    model = to_onnx(network, opset)
    onnx.helper.set_model_props(model, {METADATA_KEY: facts.to_json()})
    onnx.checker.check_model(model, full_check=True)
    write_whole(output, model.SerializeToString())
    return describe(output, count_macs(body, tuple(example_inputs(spec).values())))


def to_onnx(network: Network, opset: int = OPSET) -> onnx.ModelProto:
    """The network's graph for one query: norms folded, fixed shapes, a sigmoid at the end."""
    if opset < OPSET:
        raise ModelError(f"opset must be at least {OPSET}, got {opset}")
    inputs = example_inputs(network.spec)
    body = fold_norms(network)
    with_head = isinstance(body, EdgeNet)
    with quiet():
        program = torch.onnx.export(
            _EncoderAndHead(body) if isinstance(body, EdgeNet) else _Probability(body),
            tuple(inputs.values()),
            input_names=list(inputs),
            output_names=[OUTPUT, PLACES, HEAD] if with_head else [OUTPUT],
            opset_version=opset,
            dynamo=True,
            external_data=False,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    _tidy(model.graph)
    if with_head:
        make_head_optional(model)
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
    return {
        "map": torch.zeros(1, edge.MAP_CHANNELS * edge.UNSHUFFLE**2, map_side, map_side),
        "query": torch.zeros(1, ENDS_CHANNELS, query_side, query_side),
    }


def dataset_facts(recipe: Recipe) -> dict[str, object]:
    """What decided a data set, for a model's metadata; terrain by the files' names alone."""
    return msgspec.structs.asdict(recipe) | {"terrain": [Path(name).name for name in recipe.terrain]}


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


class _Probability(nn.Module):
    """The body with its logits turned into probabilities."""

    def __init__(self, body: nn.Module) -> None:
        super().__init__()
        self.body = body

    def forward(self, *inputs: Tensor) -> Tensor:
        return torch.sigmoid(self.body(*inputs))


class _EncoderAndHead(nn.Module):
    """The edge network with all outputs that the runtime needs: probabilities, places, the head's parameters."""

    def __init__(self, body: EdgeNet) -> None:
        super().__init__()
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
