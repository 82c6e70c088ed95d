"""A network of encoder and head as one graph, whose head runs only where an input says so."""

from collections.abc import Iterable, MutableSequence, Sequence
from typing import TypeVar

import onnx
from onnx import TensorProto, helper

from nnpp_edge.runtime.network.inference import ASK, HEAD, OUTPUT, PLACES

M = TypeVar("M", onnx.NodeProto, onnx.TensorProto, onnx.ValueInfoProto)


def make_head_optional(model: onnx.ModelProto) -> None:
    """Put all that leads to the probability, and to nothing else, into one branch of an ``If``.

    The graph gets one more input, `ASK` (1,) bool. Where it is false the probability is 0 and the encoder alone runs:
    onnxruntime takes longer to run a part of a graph's outputs than to run all of it.
    """
    graph = model.graph
    kept = nodes_leading_to((PLACES, HEAD), graph)
    inside = [node for node in graph.node if node.name not in kept]
    outside = [node for node in graph.node if node.name in kept]
    needed = {name for node in outside for name in node.input} | {value.name for value in graph.output}
    weights = [tensor for tensor in graph.initializer if tensor.name not in needed]
    moved = {name for node in inside for name in node.output} | {tensor.name for tensor in weights}
    choice = _choice(inside, weights, next(value for value in graph.output if value.name == OUTPUT))
    rest = [tensor for tensor in graph.initializer if tensor.name not in moved]
    known = [value for value in graph.value_info if value.name not in moved]
    _replace(graph.node, [*outside, choice])
    _replace(graph.initializer, rest)
    _replace(graph.value_info, known)
    graph.input.append(helper.make_tensor_value_info(ASK, TensorProto.BOOL, [1]))


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


def _choice(
    nodes: list[onnx.NodeProto], weights: list[onnx.TensorProto], probability: onnx.ValueInfoProto
) -> onnx.NodeProto:
    """An ``If`` that runs these nodes, or gives 0."""
    shape = [d.dim_value for d in probability.type.tensor_type.shape.dim]
    computed, zero, shape_name = f"{OUTPUT}_computed", f"{OUTPUT}_zero", f"{OUTPUT}_shape"
    for node in nodes:
        node.output[:] = [computed if name == OUTPUT else name for name in node.output]
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in (computed, zero)]
    fill = helper.make_tensor("", TensorProto.FLOAT, [1], [0.0])
    zeros = helper.make_node("ConstantOfShape", [shape_name], [zero], name="head/Zero", value=fill)
    sizes = helper.make_tensor(shape_name, TensorProto.INT64, [len(shape)], shape)
    then_branch = helper.make_graph(nodes, "head", [], values[:1], weights)
    else_branch = helper.make_graph([zeros], "zero", [], values[1:], [sizes])
    return helper.make_node("If", [ASK], [OUTPUT], name="head/If", then_branch=then_branch, else_branch=else_branch)


def _replace(field: MutableSequence[M], values: Sequence[M]) -> None:
    """Put copies of the messages in the place of what the field holds."""
    copies = [type(value).FromString(value.SerializeToString()) for value in values]
    del field[:]
    field.extend(copies)
