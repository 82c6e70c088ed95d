"""An int8 model made from an fp32 model; `profiling.int8` measures it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import onnx
import onnxruntime as ort
from onnxruntime import quantization
from onnxruntime.quantization import QuantType

from nnpp_edge import __version__
from nnpp_edge.export.to_onnx import nodes_leading_to, quiet
from nnpp_edge.runtime.arrays import Array, Float32s
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import METADATA_KEY
from nnpp_edge.terrain.known import KnownMaps

if TYPE_CHECKING:
    from nnpp_edge.terrain.dataset import Queries

OPERATORS = ("Conv", "Relu", "Add", "Resize", "Concat", "AveragePool", "MaxPool")
"""Kinds of nodes that have an int8 kernel on CPUs, so that their QDQ pairs disappear."""
LAYERS_COMPARED_ON = 4
"""Queries on which the layers of both models are compared."""


@dataclass(frozen=True)
class Convolution:
    """A convolution, and how far int8 is from fp32 behind it."""

    name: str
    quantised: bool
    error: float
    """Root mean square difference of its outputs, as a share of the fp32 outputs' root mean square:
    its own error and what the layers before it pass on.
    """


def quantised_graph(
    fp32: NetworkModel, queries: "Queries", folder: Path, exclude: Sequence[str] = ()
) -> tuple[onnx.ModelProto, tuple[Convolution, ...]]:
    """A model's int8 variant, calibrated on all of the queries, and its convolutions, the largest
    error first.

    The `folder` is for the files in between. ModelError where `exclude` names a node that does not
    exist.
    """
    prepared = folder / "prepared.onnx"
    target = folder / "quantised.onnx"
    with quiet():
        try:
            quantization.quant_pre_process(fp32.path, prepared)
        # it cannot follow ReduceMax over axes given as an input; plain inference can
        except Exception:
            quantization.quant_pre_process(fp32.path, prepared, skip_symbolic_shape=True)
        nodes = onnx.load(prepared).graph.node
        convolutions = [node for node in nodes if node.op_type == "Conv"]
        if not convolutions:
            raise ModelError(f"{fp32.path}: wanted a network with convolutions, got one without")
        before_head = nodes_leading_to(convolutions[-1].input, nodes)
        chosen = [node.name for node in convolutions if node.name in before_head]
        unknown = set(exclude) - {node.name for node in nodes}
        if unknown:
            raise ModelError(
                f"wanted nodes out of {', '.join(chosen)}, got {', '.join(sorted(unknown))}"
            )
        head = [node.name for node in nodes if node.name not in before_head]
        quantization.quantize_static(
            prepared,
            target,
            SimpleNamespace(get_next=partial(next, inputs_of(fp32, queries), None)),
            op_types_to_quantize=list(OPERATORS),
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            nodes_to_exclude=[*head, *exclude],
        )
    made = onnx.load(target)
    in_int8 = set(chosen) - set(exclude)
    inputs = list(islice(inputs_of(fp32, queries), LAYERS_COMPARED_ON))
    names = [node.name for node in convolutions]
    layers = []
    outputs = (_behind(names, model, inputs) for model in (onnx.load(prepared), made))
    for name, exact, rounded in zip(names, *outputs, strict=True):
        error = np.linalg.norm(rounded - exact) / np.linalg.norm(exact)
        layers.append(Convolution(name, name in in_int8, float(error)))
    return made, tuple(sorted(layers, key=lambda layer: -layer.error))


def _behind(
    names: Sequence[str], model: onnx.ModelProto, inputs: Sequence[dict[str, Array]]
) -> list[Float32s]:
    """The outputs of a graph's nodes for all inputs, by the nodes' names."""
    of_node = {node.name: node.output[0] for node in model.graph.node}
    shown = onnx.ModelProto()
    shown.CopyFrom(model)
    wanted = [of_node[name] for name in names]
    shown.graph.output.extend(onnx.ValueInfoProto(name=name) for name in wanted)
    session = ort.InferenceSession(shown.SerializeToString(), providers=["CPUExecutionProvider"])
    found = [session.run(wanted, each) for each in inputs]
    return [np.array(each) for each in zip(*found, strict=True)]


def inputs_of(model: NetworkModel, queries: "Queries") -> Iterator[dict[str, Array]]:
    """Inputs of a network for each query, by name, as `model` lays them out."""
    for number in range(len(queries)):
        answer(model, queries, number)  # lays out the inputs
        yield {name: array.copy() for name, array in model.inputs.items()}


def int8_file(model: onnx.ModelProto, fp32: NetworkModel, facts: Mapping[str, object]) -> bytes:
    """The file: our metadata with facts on the calibration, no operator sets but those in use, and
    checked.
    """
    versions = {
        "nnpp_edge": __version__,
        "onnxruntime": ort.__version__,
        "onnx": onnx.__version__,
    }
    how = {"method": "minmax", "reduce_range": True, "versions": versions}
    training = {**fp32.metadata.training, "calibration": {**facts, **how}}
    metadata = replace(fp32.metadata, precision="int8", training=training)
    stored = fp32.session.get_modelmeta().custom_metadata_map
    onnx.helper.set_model_props(model, stored | {METADATA_KEY: metadata.to_json()})
    used = {node.domain or "ai.onnx" for node in model.graph.node}
    kept = [each for each in model.opset_import if (each.domain or "ai.onnx") in used]
    del model.opset_import[:]
    model.opset_import.extend(kept)
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def answer(model: NetworkModel, queries: "Queries", number: int) -> Float32s:
    """A network's answer to a query, or to a map known by its blocks: (B, B) or (3, B, B). It and
    the inputs stay until the next call.
    """
    if isinstance(queries, KnownMaps):
        rows, cols = queries.heights[number].shape
        queries.encode(number, model.inputs["input"][0, :, :rows, :cols])
        return model.answers()[:, :rows, :cols]
    planes, start, goal = queries.query(number)
    model.set_map(planes)
    return model.answer(start, goal)


def answers(model: NetworkModel, queries: "Queries") -> Float32s:
    """The answers to all queries, (Q, B, B) or (Q, 3, B, B)."""
    return np.array([answer(model, queries, number).copy() for number in range(len(queries))])
