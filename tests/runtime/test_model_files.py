"""Model files: what they answer, and what is refused: endless, failing and damaged ones, ones that read others."""

import json
import random

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from nnpp_edge.runtime import NetworkModel
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.model_file import METADATA_KEY, ModelMetadata, read_model_file


def test_a_model_answers_with_probabilities_of_its_blocks(network):
    network.set_map(np.random.default_rng(0).random((2, 64, 64)).astype(np.float32))
    first = network.answer((5.0, 6.0), (50.0, 40.0)).copy()
    assert first.shape == (8, 8) and 0.0 <= first.min() <= first.max() <= 1.0
    assert not np.array_equal(first, network.answer((60.0, 60.0), (3.0, 5.0)))
    np.testing.assert_array_equal(first, network.answer((5.0, 6.0), (50.0, 40.0)))
    assert ModelMetadata.from_json(network.metadata.to_json(), "x") == network.metadata


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


def value(name, kind=TensorProto.FLOAT, shape=()):
    return helper.make_tensor_value_info(name, kind, shape)


def constant(name, number, kind=TensorProto.INT64, shape=()):
    return helper.make_tensor(name, kind, shape, [number])


def changed(path, change):
    """The model of a file, changed in place."""
    model = onnx.load(path)
    change(model)
    path.write_bytes(model.SerializeToString())
    return path


def with_node(path, *nodes):
    """The tiny model with nodes more, and what they need."""

    def add(model):
        needed = constant("yes", True, TensorProto.BOOL), constant("zero", 0, TensorProto.FLOAT)
        model.graph.initializer.extend(needed)
        model.graph.node.extend(nodes)

    return changed(path, add)


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


def test_a_loop_is_refused_before_it_can_hang_and_branches_are_not_read_without_end(make_tiny_model):
    assert "the operator 'Loop', which may run forever" in refusal(with_node(make_tiny_model(), endless_loop()))
    inside = helper.make_graph([endless_loop()], "branch", [], [value("ever")])
    hidden = helper.make_node("If", ["yes"], ["out"], then_branch=inside, else_branch=inside)
    assert "'Loop'" in refusal(with_node(make_tiny_model(), hidden))
    NetworkModel(with_node(make_tiny_model(), branch(3)))
    assert "nested more than 8 deep" in refusal(with_node(make_tiny_model(), branch(9)))


def test_functions_sparse_tensors_and_tensors_in_other_files_are_refused(make_tiny_model):
    def with_function(model):
        node = helper.make_node("Identity", ["a"], ["b"])
        model.functions.append(helper.make_function("own", "Twice", ["a"], ["b"], [node], model.opset_import))

    def with_sparse(model):
        parts = constant("s", 1.0, TensorProto.FLOAT, (1,)), constant("i", 0, shape=(1,))
        model.graph.sparse_initializer.append(helper.make_sparse_tensor(*parts, [4]))

    assert "functions of its own" in refusal(changed(make_tiny_model(), with_function))
    assert "sparse tensors" in refusal(changed(make_tiny_model(), with_sparse))
    for attribute in (False, True):

        def with_file(model, attribute=attribute):
            tensor = (
                TensorProto(name="told", data_type=TensorProto.FLOAT) if attribute else model.graph.initializer[0]
            )
            tensor.ClearField("float_data")
            tensor.raw_data = b"\0\0\0\0"
            onnx.external_data_helper.set_external_data(tensor, location="weights")
            tensor.ClearField("raw_data")
            if attribute:
                model.graph.node.append(helper.make_node("Constant", [], ["told"], value=tensor))

        path = make_tiny_model()
        path.with_name("weights").write_bytes(np.float32(0.5).tobytes())
        assert "tensors in other files" in refusal(changed(path, with_file))


def test_a_graph_that_fails_while_it_answers_is_one_line(make_tiny_model, nnpp_edge, tmp_path):
    def failing(model):
        single = constant("far_away", 1.0, TensorProto.FLOAT, (1,))
        model.graph.initializer.extend([constant("far", 99.0, TensorProto.FLOAT), single])
        model.graph.node[-1].output[0] = "almost"
        for operator, given, made, options in (
            ("ReduceMax", ["input"], "most", {"keepdims": 0}),
            ("Add", ["most", "far"], "index", {}),
            ("Cast", ["index"], "whole", {"to": TensorProto.INT64}),
            ("Gather", ["far_away", "whole"], "none", {}),
            ("Add", ["almost", "none"], "probability", {}),
        ):
            model.graph.node.append(helper.make_node(operator, given, [made], **options))

    path = changed(make_tiny_model(), failing)
    with pytest.raises(ModelError, match="got one whose graph fails ") as caught:
        NetworkModel(path).try_out()
    assert "\n" not in str(caught.value)
    ground = np.random.default_rng(0).random((64, 64)).astype(np.float32)
    np.savez(tmp_path / "dem.npz", elevation_m=ground, cell_size_m=5.0)
    words = ("--start", "5,5", "--goal", "60,60", "--method", "nnpp", "--model", path)
    nnpp_edge("plan", tmp_path / "dem.npz", *words).refused("whose graph fails")


def test_damage_anywhere_ends_in_an_answer_or_in_one_line(tiny_model, tmp_path, capfd):
    whole, rng, path, refused = tiny_model.read_bytes(), random.Random(3), tmp_path / "damaged.onnx", 0
    for _ in range(100):
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
    assert 0 < refused < 100
    for content in (b"", whole[: len(whole) // 2], b"no model at all"):
        path.write_bytes(content)
        with pytest.raises(ModelError, match="wanted an ONNX model") as caught:
            NetworkModel(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(ModelError, match=r"shipped model \(.*edge"):
        NetworkModel("nosuch")
    assert capfd.readouterr() == ("", "")


def test_metadata_and_figures_that_cannot_be_read_or_do_not_fit_are_one_line(make_tiny_model):
    odd = (
        "[" * 100_000,
        '{"a":' * 100_000,
        b'{"format": "nnpp-edge-model-1", "name": "\xff\xfe"}',
        "null",
        "3",
        None,
    )
    for text in (*odd, '{"format": ["nnpp-edge-model-1"]}', '{"format": "nnpp-edge-model-1"}', "9" * 6000):
        content = text.encode() if isinstance(text, str) else text or b""
        path = changed(make_tiny_model(), lambda model: model.ClearField("metadata_props"))
        if text is not None:
            named = {METADATA_KEY: "x" * len(content)}
            changed(path, lambda model, named=named: helper.set_model_props(model, named))
            path.write_bytes(path.read_bytes().replace(b"x" * len(content), content))
        assert "metadata" in refusal(path)
    for changes, word in (
        ({"blocks": 0}, "metadata"),
        ({"blocks": 24}, "metadata"),
        ({"omega": 0.0}, "metadata"),
        ({"omega": float("nan")}, "metadata"),
        ({"sigma": float("inf")}, "metadata"),
        ({"sigma": -1.0}, "sigma"),
        ({"input_size": 1 << 40, "blocks": 8}, "metadata"),
        ({"training": {"deep": json.loads("[" * 100 + "]" * 100)}}, "metadata"),
        ({"format": "other"}, "format"),
        ({"channels": ("start_map", "cost", "goal_map")}, "channels"),
        ({"encoding": "sine"}, "encoding"),
        ({"blocks": 7}, "go together"),
        ({"region_factor": 0.0}, "region_factor"),
    ):
        assert word in refusal(make_tiny_model(**changes))
    for changes, word in (({"input_size": 128}, "inputs"), ({"blocks": 16}, "output")):
        with pytest.raises(ModelError, match=word):
            NetworkModel(make_tiny_model(**changes))
    path = make_tiny_model()
    for content in (b"[" * 100_000, b'{"format": "\xff"}', b"9" * 6000):
        path.with_suffix(".json").write_bytes(content)
        with pytest.raises(ModelError, match="wanted figures as JSON") as caught:
            read_model_file(path)
        assert "\n" not in str(caught.value)
