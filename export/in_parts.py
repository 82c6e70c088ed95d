"""A network in two parts as one graph, whose head runs only when it is asked for."""

from collections.abc import Iterable

import onnx
from onnx import TensorProto, helper

from nnpp_edge.runtime.network.inference import ASK, HEAD, OUTPUT, PLACES


def ask_for_the_head(model: onnx.ModelProto) -> None:
    """Put all that leads to the answer, and to nothing else, into one branch of an ``If``.

    The graph gets one more input, `ASK` (1,) bool. Where it is false the answer is 0 and the encoder alone runs: to
    ask onnxruntime for a part of a graph's outputs takes it longer than running all of it.
    """
    graph = model.graph
    makers = {name: node for node in graph.node for name in node.output}
    kept = leading_to((PLACES, HEAD), makers)
    inside = [node for node in graph.node if node.name not in kept]
    outside = [node for node in graph.node if node.name in kept]
    needed = {name for node in outside for name in node.input} | {value.name for value in graph.output}
    own = [tensor for tensor in graph.initializer if tensor.name not in needed]
    answer = next(value for value in graph.output if value.name == OUTPUT)
    shape = [d.dim_value for d in answer.type.tensor_type.shape.dim]
    told, nothing = onnx.ValueInfoProto(), onnx.ValueInfoProto()
    told.CopyFrom(answer)
    nothing.CopyFrom(answer)
    told.name, nothing.name = f"{OUTPUT}_told", f"{OUTPUT}_nothing"
    for node in inside:
        for at, name in enumerate(node.output):
            if name == OUTPUT:
                node.output[at] = told.name
    zeros = helper.make_node(
        "ConstantOfShape", [f"{OUTPUT}_shape"], [nothing.name], name="head/Nothing",
        value=helper.make_tensor("", TensorProto.FLOAT, [1], [0.0]),
    )  # fmt: skip
    sizes = helper.make_tensor(f"{OUTPUT}_shape", TensorProto.INT64, [len(shape)], shape)
    choice = helper.make_node(
        "If", [ASK], [OUTPUT], name="head/If",
        then_branch=helper.make_graph(inside, "head", [], [told], own),
        else_branch=helper.make_graph([zeros], "nothing", [], [nothing], [sizes]),
    )  # fmt: skip
    moved = {name for node in inside for name in node.output} | {tensor.name for tensor in own}
    rest = [tensor for tensor in graph.initializer if tensor.name not in moved]
    known = [value for value in graph.value_info if value.name not in moved]
    for field, values in (
        (graph.node, [*outside, choice]), (graph.initializer, rest), (graph.value_info, known),
    ):  # fmt: skip
        copies = [type(value).FromString(value.SerializeToString()) for value in values]
        del field[:]
        field.extend(copies)
    graph.input.append(helper.make_tensor_value_info(ASK, TensorProto.BOOL, [1]))


def leading_to(names: Iterable[str], makers: dict[str, onnx.NodeProto]) -> set[str]:
    """Names of the nodes that these values are made from."""
    found: set[str] = set()
    waiting = [makers[name] for name in names if name in makers]
    while waiting:
        node = waiting.pop()
        if node.name not in found:
            found.add(node.name)
            waiting += [makers[name] for name in node.input if name in makers]
    return found
