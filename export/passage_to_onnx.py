"""A passage network as an ONNX file: its weights are worked out in the graph from the vehicle's numbers.

The numbers stand in the file as the initializer `VEHICLE`. Whoever loads the file writes a vehicle's over them, and
onnxruntime then folds all that follows from them into constants: what runs is a plain convolutional network.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from nnpp_edge import __version__
from nnpp_edge.files import write_whole
from nnpp_edge.model.passage import ANSWERS, PassageNet, VehicleConv
from nnpp_edge.runtime.kernels.blocks import CHANNELS, MIDDLE
from nnpp_edge.runtime.network.model_file import METADATA_KEY, PassageMetadata
from nnpp_edge.runtime.network.passage import NUMBERS, STEPS
from nnpp_edge.runtime.network.passage_model import ANSWER_MIDDLE, ANSWER_STEPS, BLOCKS, OUTPUT, VEHICLE

OPSET = 18
_LARGEST = 127.0
"""Of a quantised weight."""
_FITTING = 4
"""int8 convolutions of so many channels, or multiples of it, are the fastest: 19 take a quarter more time than 20."""


class HiddenRanges(NamedTuple):
    """The greatest output of each of L hidden convolutions, by what a network of D units says of a vehicle."""

    weight: NDArray[np.float32]
    """(D, L): its logarithm is linear in what is said."""
    bias: NDArray[np.float32]
    """(L,)"""


class _Graph:
    """Nodes and constants of a graph that is being written."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, name: str, value: NDArray[np.generic] | np.generic) -> str:
        """A named constant."""
        self.constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def add(self, operator: str, inputs: list[str], output: str, **attributes: int | list[int]) -> str:
        """A node with one output, which is also its name."""
        self.nodes.append(helper.make_node(operator, inputs, [output], output, None, None, None, **attributes))
        return output


def passage_graph(network: PassageNet, ranges: HiddenRanges | None = None) -> onnx.ModelProto:
    """The network's graph in float32 or, by the greatest output of each hidden convolution, in int8."""
    graph = _Graph()
    graph.constant(VEHICLE, np.zeros((1, len(NUMBERS)), np.float32))
    described = _described(graph, network)
    graph.constant("unit", np.float32(1.0 / STEPS))
    graph.constant("middle", np.uint8(MIDDLE))
    layers = [*network.convolutions, network.head]
    count = len(layers)
    graph.constant("answer.step", np.float32(1.0 / ANSWER_STEPS))
    graph.constant("answer.middle", np.uint8(ANSWER_MIDDLE))
    if ranges is None:
        x = graph.add("DequantizeLinear", [BLOCKS, "unit", "middle"], "shown")
    else:
        x = _widened(graph, BLOCKS, "middle", "shown")
        steps = ["unit", *_hidden_steps(graph, described, ranges), "answer.step"]
        zeros = ["middle", *(graph.constant(f"zero{i}", np.uint8(0)) for i in range(1, count)), "answer.middle"]
    for i, layer in enumerate(layers):
        assert isinstance(layer, VehicleConv)
        weight, bias = _mixed(graph, layer, described, i)
        side = layer.kernels.shape[-1]
        shape = {"kernel_shape": [side, side], "pads": [side // 2] * 4}
        if ranges is not None:
            if i == 0:
                weight = _widened(graph, weight, graph.constant("nothing", np.float32(0.0)), "weight0.wide")
            x = _quantised(graph, x, (weight, bias), (steps[i : i + 2], zeros[i : i + 2]), i, shape)
        else:
            x = graph.add("Conv", [x, weight, bias], f"sum{i}", **shape)
            if i < count - 1:
                x = graph.add("Relu", [x], f"hidden{i}")
    if ranges is None:
        x = graph.add("QuantizeLinear", [x, "answer.step", "answer.middle"], "rounded")
    graph.add("Transpose", [x], OUTPUT, perm=[0, 2, 3, 1])
    shapes: tuple[list[str | int | None], ...] = [1, CHANNELS, "rows", "cols"], [1, "rows", "cols", ANSWERS]
    given = helper.make_tensor_value_info(BLOCKS, TensorProto.UINT8, shapes[0])
    answer = helper.make_tensor_value_info(OUTPUT, TensorProto.UINT8, shapes[1])
    made = helper.make_graph(graph.nodes, "passage", [given], [answer], graph.constants)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="nnpp-edge")
    model.ir_version = 9
    onnx.checker.check_model(model, full_check=True)
    return model


def write_passage(
    network: PassageNet,
    output: Path,
    *,
    name: str,
    training: Mapping[str, object],
    ranges: HiddenRanges | None = None,
) -> None:
    """Write a passage network as ONNX, whole or not at all, in int8 if `ranges` are given; or OutputError."""
    model = passage_graph(network, ranges)
    facts = PassageMetadata(
        name=name,
        ranges={number.name: (number.low, number.high) for number in NUMBERS},
        precision="fp32" if ranges is None else "int8",
        training=dict(training),
        version=__version__,
    )
    helper.set_model_props(model, {METADATA_KEY: facts.to_json()})
    write_whole(output, model.SerializeToString())


def _array(parameter: torch.Tensor) -> NDArray[np.float32]:
    return np.asarray(parameter.detach().float().numpy(), np.float32)


def _linear(graph: _Graph, layer: torch.nn.Linear, x: str, name: str) -> str:
    graph.constant(f"{name}.weight", np.ascontiguousarray(_array(layer.weight).T))
    graph.constant(f"{name}.bias", _array(layer.bias))
    return graph.add("Add", [graph.add("MatMul", [x, f"{name}.weight"], f"{name}.product"), f"{name}.bias"], name)


def _described(graph: _Graph, network: PassageNet) -> str:
    """(1, D): what the network says of the vehicle."""
    x = VEHICLE
    for i, layer in enumerate(network.describe):
        if isinstance(layer, torch.nn.Linear):
            x = _linear(graph, layer, x, f"describe{i}")
        else:
            x = graph.add("Mul", [x, graph.add("Sigmoid", [x], f"gate{i}")], f"described{i}")
    return x


def _hidden_steps(graph: _Graph, described: str, ranges: HiddenRanges) -> list[str]:
    """The step of each hidden convolution's bytes."""
    weight, bias = graph.constant("ranges.weight", ranges.weight), graph.constant("ranges.bias", ranges.bias)
    logs = graph.add("Add", [graph.add("MatMul", [described, weight], "ranges.product"), bias], "ranges.logs")
    greatest = graph.add("Exp", [logs], "ranges")
    all_steps = graph.add("Div", [greatest, graph.constant("most", np.float32(255.0))], "steps")
    steps = []
    for i in range(len(ranges.bias)):
        each = graph.add("Gather", [all_steps, graph.constant(f"layer{i}", np.int64(i))], f"step{i}.row", axis=1)
        steps.append(graph.add("Squeeze", [each], f"step{i + 1}"))
    return steps


def _mixed(graph: _Graph, layer: VehicleConv, described: str, i: int) -> tuple[str, str]:
    """Weight and bias of a convolution."""
    shape = tuple(layer.kernels.shape)
    flat = graph.constant(f"kernels{i}", _array(layer.kernels).reshape(shape[0], -1))
    mixed = graph.add("MatMul", [_linear(graph, layer.shares, described, f"shares{i}"), flat], f"mixed{i}")
    mixed = graph.add("Reshape", [mixed, graph.constant(f"shape{i}", np.array(shape[1:], np.int64))], f"kernel{i}")
    gain = graph.add(
        "Add",
        [_linear(graph, layer.gain, described, f"gain{i}"), graph.constant(f"one{i}", np.float32(1))],
        f"gains{i}",
    )
    gain = graph.add("Reshape", [gain, graph.constant(f"column{i}", np.array((-1, 1, 1, 1), np.int64))], f"scales{i}")
    weight = graph.add("Mul", [mixed, gain], f"weight{i}")
    bias = _linear(graph, layer.bias, described, f"bias{i}")
    return weight, graph.add("Reshape", [bias, graph.constant(f"row{i}", np.array((-1,), np.int64))], f"offset{i}")


def _widened(graph: _Graph, x: str, by: str, output: str) -> str:
    """(., 19, ., .) with a channel more, of the value named `by`."""
    sizes = graph.constant(f"{output}.sizes", np.array([0, 0, 0, 0, 0, -CHANNELS % _FITTING, 0, 0], np.int64))
    return graph.add("Pad", [x, sizes, by], output)


def _quantised(
    graph: _Graph,
    x: str,
    layer: tuple[str, str],
    about: tuple[list[str], list[str]],
    i: int,
    shape: dict[str, list[int]],
) -> str:
    """A convolution in int8, cut off at its least byte: weights by output channel, so that each fills its range."""
    (weight, bias), (steps, zeros) = layer, about
    axes = graph.constant(f"axes{i}", np.array((1, 2, 3), np.int64))
    most = graph.add("ReduceMax", [graph.add("Abs", [weight], f"size{i}"), axes], f"most{i}", keepdims=1)
    step = graph.add("Div", [most, graph.constant(f"largest{i}", np.float32(_LARGEST))], f"wstep{i}")
    whole = graph.add("Round", [graph.add("Div", [weight, step], f"ratio{i}")], f"whole{i}")
    small = graph.add("Cast", [whole], f"small{i}", to=TensorProto.INT8)
    flat = graph.add("Reshape", [step, graph.constant(f"each{i}", np.array((-1,), np.int64))], f"wsteps{i}")
    by = graph.add("Mul", [flat, steps[0]], f"bstep{i}")
    rounded = graph.add("Round", [graph.add("Div", [bias, by], f"bratio{i}")], f"bwhole{i}")
    offset = graph.add("Cast", [rounded], f"boffset{i}", to=TensorProto.INT32)
    zero = graph.constant(f"wzero{i}", np.int8(0))
    inputs = [x, steps[0], zeros[0], small, flat, zero, steps[1], zeros[1], offset]
    return graph.add("QLinearConv", inputs, f"quantised{i}", **shape)
