"""A trained network as one ONNX file that the runtime can check and run, and whether it computes
the same.
"""

import ast
import contextlib
import copy
import io
import logging
import math
import warnings
from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import onnx
import torch
from onnxscript import optimizer
from torch import Tensor, nn

from nnpp_edge import __version__
from nnpp_edge.files import write_whole
from nnpp_edge.model import edge
from nnpp_edge.model.edge import EdgeNet
from nnpp_edge.model.network import Network, count_macs
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.errors import ModelError, OutputError
from nnpp_edge.runtime.kernels.encoding import ENDS_CHANNELS
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.loading import OUTPUT, PLACES
from nnpp_edge.runtime.network.model_file import (
    CHANNELS,
    HEAD_KEY,
    METADATA_KEY,
    QUERY_SPACING,
    ModelMetadata,
)
from nnpp_edge.runtime.network.place_head import text_of
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.terrain.traversability import Traversability

if TYPE_CHECKING:
    from nnpp_edge.terrain.shards import Recipe

OPSET = 18
"""The oldest that torch's exporter writes without conversion, so that older onnxruntimes read the
file too.
"""
COMPARED = 32
"""Random queries on which torch and onnxruntime are compared."""
MOST_DIFFERENCE = 1e-4
"""Largest difference of two probabilities that passes; torch and onnxruntime both compute in
float32.
"""


@dataclass(frozen=True)
class ExportReport:
    """The exported file, its number of nodes, and the multiply-accumulates of one query."""

    path: str
    size_bytes: int
    nodes: int
    macs: int


@dataclass(frozen=True)
class Parity:
    """Differences between the probabilities of torch and of the ONNX file."""

    queries: int
    max_difference: float
    mean_difference: float
    limit: float
    passed: bool


def export_network(
    network: Network,
    output: Path,
    *,
    name: str,
    region_factor: float | None = None,
    omega: float = PAPER_OMEGA,
    limits: Traversability | None = None,
    training: Mapping[str, object] | None = None,
) -> ExportReport:
    """Write a network as ONNX, whole or not at all. The other arguments are its metadata, or a
    ModelError.

    `region_factor` is the factor on the adaptive threshold that the runtime is to use, in (0, 1]:
    by default that of the architecture, which chose the best weights. `omega` and `limits` (by
    default the paper's) are those of the cost maps that it was trained on.
    """
    spec = network.spec
    body = network.body
    cost_limits = asdict(limits or Traversability())
    facts = ModelMetadata(
        name=name,
        architecture=spec.architecture,
        input_size=spec.input_size,
        blocks=spec.blocks,
        encoding=spec.encoding,
        channels=CHANNELS[spec.encoding],
        sigma=spec.sigma,
        omega=omega,
        cost_limits={name: limit for name, limit in cost_limits.items() if math.isfinite(limit)},
        region_factor=spec.region_factor if region_factor is None else region_factor,
        head=body.head.sizes if isinstance(body, EdgeNet) else (),
        training=dict(training or {}),
        version=__version__,
    )
    model = to_onnx(network)
    stored = {METADATA_KEY: facts.to_json()}
    if isinstance(body, EdgeNet):
        stored[HEAD_KEY] = text_of(body.head.parameters_in_order().detach().numpy())
    onnx.helper.set_model_props(model, stored)
    onnx.checker.check_model(model, full_check=True)
    content = model.SerializeToString()
    # a file that the runtime would refuse is not written
    with TemporaryDirectory() as folder:
        trial = Path(folder) / output.name
        trial.write_bytes(content)
        try:
            NetworkModel(trial)
        except ModelError as error:
            raise ModelError(f"{output}: {str(error).removeprefix(f'{trial}: ')}") from error
    write_whole(output, content)
    macs = count_macs(body, tuple(example_inputs(spec).values()))
    return ExportReport(str(output), len(content), len(model.graph.node), macs)


def parity(network: Network, onnx_path: Path) -> Parity:
    """Compare a network in torch with its ONNX file as the runtime runs it, over whole queries:
    random maps and ends. How `NetworkModel` lays out the map, encodes the query and reads the
    output is compared too.
    """
    spec = network.spec
    size = spec.input_size
    model = NetworkModel(onnx_path)
    rng = np.random.default_rng(1)
    differences = []
    facts: Floats = np.empty(0)
    for _ in range(COMPARED):
        if spec.encoding == "unseen":
            maps = model.inputs["input"][0]
            maps[:] = rng.uniform(-1.0, 1.0, maps.shape)
            answer = model.answers()
        else:
            maps = rng.random((2, size, size), np.float32)
            facts = rng.uniform(0, size - 1, (2, 2))
            model.set_map(maps)
            start, goal = facts.tolist()
            answer = model.answer(start, goal)
        wanted = network.answers(maps[None], facts[None].astype(np.float32))[0]
        differences.append(np.abs(answer - wanted))
    most = float(np.max(differences))
    return Parity(
        queries=COMPARED,
        max_difference=most,
        mean_difference=float(np.mean(differences)),
        limit=MOST_DIFFERENCE,
        passed=most <= MOST_DIFFERENCE,
    )


def to_onnx(network: Network) -> onnx.ModelProto:
    """The network's graph for one query: norms folded (by torch's exporter), fixed shapes, a
    sigmoid at the end. Of a network in two parts it is that of the encoder.
    """
    name, shown = next(iter(example_inputs(network.spec).items()))
    body = copy.deepcopy(network.body).eval()
    layers = OrderedDict[str, nn.Module](body=body, answer=nn.Sigmoid())
    output = OUTPUT
    if isinstance(body, EdgeNet):
        layers = OrderedDict(encoder=body.encoder)
        output = PLACES
    with quiet(), refused_as(OutputError, "torch could not export the network"):
        program = torch.onnx.export(
            nn.Sequential(layers),
            (shown,),
            input_names=[name],
            output_names=[output],
            opset_version=OPSET,
            dynamo=True,
            external_data=False,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    optimizer.remove_unused_nodes(model)  # and initializers, of which onnxruntime would warn
    _tidy(model.graph)
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
    """Names and shapes of the network's inputs, of which the ONNX graph has the first; the values
    mean nothing.
    """
    size = spec.input_size
    if spec.architecture != "edge":
        channels = len(CHANNELS[spec.encoding])
        return {"input": torch.zeros(1, channels, size, size)}
    map_side = size // edge.UNSHUFFLE
    query_side = size // QUERY_SPACING
    return {
        "map": torch.zeros(1, edge.MAP_CHANNELS * edge.UNSHUFFLE**2, map_side, map_side),
        "query": torch.zeros(1, ENDS_CHANNELS, query_side, query_side),
    }


def dataset_facts(recipe: "Recipe") -> dict[str, object]:
    """Facts that decided a data set, for a model's metadata; terrain by the files' names alone."""
    names = [Path(name).name for name in recipe.terrain]
    return {**msgspec.structs.asdict(recipe), "terrain": names}


def _tidy(graph: onnx.GraphProto) -> None:
    """Name each node by the module it comes from, and drop the exporter's traces, which hold local
    paths.
    """
    taken: Counter[str] = Counter()
    for node in graph.node:
        facts = {p.key: p.value for p in node.metadata_props}
        scopes = ast.literal_eval(facts.get("pkg.torch.onnx.name_scopes", "[]"))
        module = scopes[-2].removeprefix("body").strip(".") if len(scopes) > 1 else ""
        name = f"{module}/{node.op_type}" if module else node.op_type
        taken[name] += 1
        node.name = name if taken[name] == 1 else f"{name}_{taken[name]}"
    values = (*graph.value_info, *graph.input, *graph.output, *graph.initializer)
    for part in (graph, *graph.node, *values):
        del part.metadata_props[:]
        part.doc_string = ""


def nodes_leading_to(names: Iterable[str], nodes: Sequence[onnx.NodeProto]) -> set[str]:
    """Names of the nodes that these values are made from."""
    found = set[str]()
    wanted = set(names)
    for node in reversed(nodes):
        if not wanted.isdisjoint(node.output):
            found.add(node.name)
            wanted.update(node.input)
    return found
