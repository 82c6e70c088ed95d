"""A trained network as one ONNX file that the runtime can check and run."""

import ast
import contextlib
import copy
import io
import logging
import math
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, MutableSequence, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

import msgspec
import onnx
import torch
from onnx import TensorProto, helper
from torch import Tensor, nn

from nnpp_edge import __version__
from nnpp_edge.files import write_whole
from nnpp_edge.model import edge
from nnpp_edge.model.edge import EdgeNet
from nnpp_edge.model.network import Network, count_macs
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.network.encoding import ENDS_CHANNELS
from nnpp_edge.runtime.network.inference import ASK, HEAD, METADATA_KEY, OUTPUT, PLACES, ModelMetadata
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.shards import Recipe

OPSET = 18
"""The oldest that torch's exporter writes of itself, so that older onnxruntimes read the file too."""
M = TypeVar("M", onnx.NodeProto, onnx.TensorProto, onnx.ValueInfoProto)


@dataclass(frozen=True)
class ExportReport:
    """What was written: the file, its number of nodes, and the multiply-accumulates of one query."""

    path: str
    size_bytes: int
    nodes: int
    macs: int


def export_network(
    network: Network,
    output: Path,
    *,
    name: str,
    region_factor: float = 0.5,
    omega: float = PAPER_OMEGA,
    limits: Traversability | None = None,
    training: Mapping[str, object] | None = None,
) -> ExportReport:
    """Write a network as ONNX, whole or not at all; its norms' running statistics are what is written.

    Parameters
    ----------
    name, training
        For the metadata.
    region_factor : float
        Factor on the adaptive threshold that the runtime is to use, in (0, 1].
    omega : float
        Weight of the traversability cost per grey level that the labels were made with.
    limits : Traversability, optional
        Of the cost maps that it was trained on; by default the paper's.

    Raises
    ------
    ModelError, OutputError
        A number is out of range; the file cannot be written.
    """
    spec, body = network.spec, network.body
    of_edge = isinstance(body, EdgeNet)
    facts = ModelMetadata(
        name=name,
        architecture=spec.architecture,
        input_size=spec.input_size,
        blocks=spec.blocks,
        encoding=spec.encoding,
        channels=("cost", "blocked", "ends") if of_edge else ("cost", "start_map", "goal_map"),
        sigma=spec.sigma,
        omega=omega,
        cost_limits={k: v for k, v in asdict(limits or Traversability()).items() if math.isfinite(v)},
        region_factor=region_factor,
        map_unshuffle=edge.UNSHUFFLE if of_edge else 1,
        output_shuffle=edge.OUTPUT_SHUFFLE if of_edge else 1,
        head=body.head.sizes if isinstance(body, EdgeNet) else (),
        training=dict(training or {}),
        version=__version__,
    )
    ModelMetadata.from_json(facts.to_json(), str(output))  # what the runtime would refuse is not written
    model = to_onnx(network)
    helper.set_model_props(model, {METADATA_KEY: facts.to_json()})
    onnx.checker.check_model(model, full_check=True)
    content = model.SerializeToString()
    write_whole(output, content)
    macs = count_macs(body, tuple(example_inputs(spec).values()))
    return ExportReport(str(output), len(content), len(model.graph.node), macs)


def to_onnx(network: Network) -> onnx.ModelProto:
    """The network's graph for one query: norms folded (by torch's exporter), fixed shapes, a sigmoid at the end."""
    inputs, body = example_inputs(network.spec), copy.deepcopy(network.body).eval()
    with_head = isinstance(body, EdgeNet)
    with quiet():
        program = torch.onnx.export(
            _EncoderAndHead(body) if isinstance(body, EdgeNet) else _Probability(body),
            tuple(inputs.values()),
            input_names=list(inputs),
            output_names=[OUTPUT, PLACES, HEAD] if with_head else [OUTPUT],
            opset_version=OPSET,
            dynamo=True,
            external_data=False,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    _tidy(model.graph)
    if with_head:
        _make_head_optional(model.graph)
    return model


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Drop other libraries' warnings, prints and log lines below critical."""
    before = logging.root.manager.disable
    logging.disable(logging.ERROR)
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)


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
    for part in (*graph.node, *graph.value_info, *graph.input, *graph.output, *graph.initializer, graph):
        del part.metadata_props[:]
        part.doc_string = ""


def nodes_leading_to(names: Iterable[str], graph: onnx.GraphProto) -> set[str]:
    """Names of the nodes that these values are made from."""
    makers = {name: node for node in graph.node for name in node.output}
    found: set[str] = set()
    waiting = [makers[name] for name in names if name in makers]
    while waiting:
        node = waiting.pop()
        if node.name not in found:
            found.add(node.name)
            waiting += [makers[name] for name in node.input if name in makers]
    return found


def _make_head_optional(graph: onnx.GraphProto) -> None:
    """Put all that leads to the probability, and to nothing else, into one branch of an ``If``.

    The graph gets one more input, `ASK` (1,) bool. Where it is false the probability is 0 and the encoder alone runs:
    onnxruntime takes longer to run a part of a graph's outputs than to run all of it.
    """
    kept = nodes_leading_to((PLACES, HEAD), graph)
    inside, outside = ([n for n in graph.node if (n.name in kept) == shared] for shared in (False, True))
    needed = {name for node in outside for name in node.input} | {value.name for value in graph.output}
    weights = [tensor for tensor in graph.initializer if tensor.name not in needed]
    moved = {name for node in inside for name in node.output} | {tensor.name for tensor in weights}
    answer = next(value for value in graph.output if value.name == OUTPUT)
    shape = [d.dim_value for d in answer.type.tensor_type.shape.dim]
    computed, zero, shape_name = f"{OUTPUT}_computed", f"{OUTPUT}_zero", f"{OUTPUT}_shape"
    for node in inside:
        node.output[:] = [computed if name == OUTPUT else name for name in node.output]
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in (computed, zero)]
    fill = helper.make_tensor("", TensorProto.FLOAT, [1], [0.0])
    zeros = helper.make_node("ConstantOfShape", [shape_name], [zero], name="head/Zero", value=fill)
    sizes = helper.make_tensor(shape_name, TensorProto.INT64, [len(shape)], shape)
    then_branch = helper.make_graph(inside, "head", [], values[:1], weights)
    else_branch = helper.make_graph([zeros], "zero", [], values[1:], [sizes])
    choice = helper.make_node("If", [ASK], [OUTPUT], "head/If", then_branch=then_branch, else_branch=else_branch)
    _replace(graph.node, [*outside, choice])
    _replace(graph.initializer, [tensor for tensor in graph.initializer if tensor.name not in moved])
    _replace(graph.value_info, [value for value in graph.value_info if value.name not in moved])
    graph.input.append(helper.make_tensor_value_info(ASK, TensorProto.BOOL, [1]))


def _replace(field: MutableSequence[M], values: Sequence[M]) -> None:
    """Put copies of the messages in the place of what the field holds."""
    copies = [type(value).FromString(value.SerializeToString()) for value in values]
    del field[:]
    field.extend(copies)
