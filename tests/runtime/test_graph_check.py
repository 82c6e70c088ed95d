"""Model files that would run forever, read other files, fail while they answer, or say what nobody can read."""

import json
import random

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from nnpp_edge.runtime import NetworkModel
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.model_file import METADATA_KEY, read_model_file


def value(name, kind=TensorProto.FLOAT, shape=()):
    return helper.make_tensor_value_info(name, kind, shape)


def constant(name, number, kind=TensorProto.INT64, shape=()):
    return helper.make_tensor(name, kind, shape, [number])


def endless_loop():
    """A node that counts while true stays true."""
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["on"]), helper.make_node("Identity", ["sum"], ["more"])],
        "body",
        [value("count", TensorProto.INT64), value("go", TensorProto.BOOL), value("sum")],
        [value("on", TensorProto.BOOL), value("more")],
    )
    return helper.make_node("Loop", ["", "yes", "zero"], ["ever"], body=body)


def branch(depth):
    """An `If` whose branches hold an `If` and so on."""
    inner = helper.make_node("Identity", ["zero"], ["out"]) if depth == 0 else branch(depth - 1)
    graph = helper.make_graph([inner], "branch", [], [value("out")])
    return helper.make_node("If", ["yes"], ["out"], then_branch=graph, else_branch=graph)


def with_node(path, *nodes):
    """The tiny model with nodes more, and what they need."""
    model = onnx.load(path)
    model.graph.initializer.extend([constant("yes", True, TensorProto.BOOL), constant("zero", 0, TensorProto.FLOAT)])
    model.graph.node.extend(nodes)
    onnx.save(model, path)
    return path


def refusal(path):
    """Both who list models and who run them refuse it alike, in one line."""
    messages = set()
    for read in (NetworkModel, read_model_file):
        with pytest.raises(ModelError) as caught:
            read(path)
        messages.add(str(caught.value))
    (message,) = messages
    assert message.startswith(f"{path}: ") and "\n" not in message
    return message


def test_a_loop_is_refused_before_it_can_hang(make_tiny_model):
    path = with_node(make_tiny_model(), endless_loop())
    assert "the operator 'Loop', which may run forever" in refusal(path)
    inside = helper.make_graph([endless_loop()], "branch", [], [value("ever")])
    hidden = helper.make_node("If", ["yes"], ["out"], then_branch=inside, else_branch=inside)
    assert "'Loop'" in refusal(with_node(make_tiny_model(), hidden))


def test_branches_are_read_but_not_without_end(make_tiny_model):
    NetworkModel(with_node(make_tiny_model(), branch(3)))
    assert "nested more than 8 deep" in refusal(with_node(make_tiny_model(), branch(9)))


def test_functions_and_sparse_tensors_are_refused(make_tiny_model):
    path = make_tiny_model()
    model = onnx.load(path)
    node = helper.make_node("Identity", ["a"], ["b"])
    model.functions.append(helper.make_function("own", "Twice", ["a"], ["b"], [node], model.opset_import))
    onnx.save(model, path)
    assert "functions of its own" in refusal(path)
    model = onnx.load(make_tiny_model())
    model.graph.sparse_initializer.append(
        helper.make_sparse_tensor(constant("s", 1.0, TensorProto.FLOAT, (1,)), constant("i", 0, shape=(1,)), [4])
    )
    onnx.save(model, path)
    assert "sparse tensors" in refusal(path)


def test_a_graph_that_fails_while_it_answers_is_one_line(make_tiny_model, nnpp_edge, tmp_path):
    path = make_tiny_model()
    model = onnx.load(path)
    model.graph.initializer.append(constant("far", 99.0, TensorProto.FLOAT))
    model.graph.node[-1].output[0] = "almost"
    model.graph.node.extend(
        [
            helper.make_node("ReduceMax", ["input"], ["most"], keepdims=0),
            helper.make_node("Add", ["most", "far"], ["index"]),
            helper.make_node("Cast", ["index"], ["whole"], to=TensorProto.INT64),
            helper.make_node("Gather", ["far_away", "whole"], ["none"]),
            helper.make_node("Add", ["almost", "none"], ["probability"]),
        ]
    )
    model.graph.initializer.append(constant("far_away", 1.0, TensorProto.FLOAT, (1,)))
    onnx.save(model, path)
    network = NetworkModel(path)
    with pytest.raises(ModelError, match="got one whose graph fails ") as caught:
        network.try_out()
    assert "\n" not in str(caught.value)
    ground = np.random.default_rng(0).random((64, 64)).astype(np.float32)
    np.savez(tmp_path / "dem.npz", elevation_m=ground, cell_size_m=5.0)
    words = ("--start", "5,5", "--goal", "60,60", "--method", "nnpp", "--model", path)
    nnpp_edge("plan", tmp_path / "dem.npz", *words).refused("whose graph fails")


def with_metadata(path, text):
    """The model with these bytes as its metadata, whatever they are."""
    model = onnx.load(path)
    content = text.encode() if isinstance(text, str) else text
    helper.set_model_props(model, {METADATA_KEY: "x" * len(content)})
    path.write_bytes(model.SerializeToString().replace(b"x" * len(content), content))
    return path


def test_damage_anywhere_ends_in_an_answer_or_in_one_line(tiny_model, tmp_path, capfd):
    whole, rng = tiny_model.read_bytes(), random.Random(3)
    path = tmp_path / "damaged.onnx"
    refused = 0
    for _ in range(150):
        content = bytearray(whole)
        for _ in range(rng.choice((1, 1, 2, 8))):
            content[rng.randrange(len(content))] = rng.randrange(256)
        path.write_bytes(content)
        try:
            read_model_file(path)
            NetworkModel(path).try_out()
        except ModelError as error:
            assert "\n" not in str(error)
            refused += 1
    assert 0 < refused < 150
    assert capfd.readouterr() == ("", "")


def test_tensors_in_other_files_are_refused(make_tiny_model):
    for attribute in (False, True):
        path = make_tiny_model()
        path.with_name("weights").write_bytes(np.float32(0.5).tobytes())
        model = onnx.load(path)
        tensor = TensorProto(name="told", data_type=TensorProto.FLOAT) if attribute else model.graph.initializer[0]
        tensor.ClearField("float_data")
        tensor.raw_data = b"\0\0\0\0"
        onnx.external_data_helper.set_external_data(tensor, location="weights")
        tensor.ClearField("raw_data")
        if attribute:
            model.graph.node.append(helper.make_node("Constant", [], ["told"], value=tensor))
        path.write_bytes(model.SerializeToString())
        assert "tensors in other files" in refusal(path)


def test_metadata_that_cannot_be_read_or_is_out_of_range_is_one_line(make_tiny_model):
    odd = ("[" * 100_000, '{"a":' * 100_000, b'{"format": "nnpp-edge-model-1", "name": "\xff\xfe"}', "null", "3")
    for text in (*odd, '{"format": ["nnpp-edge-model-1"]}', '{"format": "nnpp-edge-model-1"}', "9" * 6000):
        assert "metadata" in refusal(with_metadata(make_tiny_model(), text))
    for changes in (
        {"blocks": 0},
        {"blocks": 24},
        {"omega": 0.0},
        {"omega": float("nan")},
        {"sigma": float("inf")},
        {"input_size": 1 << 40, "blocks": 8},
        {"training": {"deep": json.loads("[" * 100 + "]" * 100)}},
    ):
        assert "metadata" in refusal(make_tiny_model(**changes))


def test_figures_that_cannot_be_read_are_one_line(make_tiny_model):
    path = make_tiny_model()
    for content in (b"[" * 100_000, b'{"format": "\xff"}', b"9" * 6000):
        path.with_suffix(".json").write_bytes(content)
        with pytest.raises(ModelError, match="wanted figures as JSON") as caught:
            read_model_file(path)
        assert "\n" not in str(caught.value)
