"""Model files: what they answer, and what is refused: endless, failing and damaged ones, ones that
read others.
"""

import json
import random

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from nnpp_edge.runtime import NetworkModel
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.model_file import METADATA_KEY, read_model_file
from tests.conftest import TINY_MODEL
from tests.strategies import uniform
from tests.tables import cases, keywords


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


def changed(path, change):
    """The model of a file, changed in place."""
    model = onnx.load(path)
    change(model)
    path.write_bytes(model.SerializeToString())
    return path


def with_nodes(nodes):
    """The tiny model's text with nodes more before its own, and what they need."""
    text = TINY_MODEL.replace(
        "<float least", "<bool yes = {1}, float zero = {0}, float[1] one_cell = {1}, float least"
    )
    return text.replace("{\n    cost,", f"{{\n    {nodes}\n    cost,")


ENDLESS = """out = Loop ("", yes, zero) <body = counting (int64 count, bool go, float sum) => (bool on, float more)
    { on = Identity (go) more = Identity (sum) }>"""


def branches(inner, depth=1):
    """An `If` whose branches hold an `If` and so on."""
    for _ in range(depth):
        ways = (f"{way}_branch = {way} () => (float out) {{ {inner} }}" for way in ("then", "else"))
        inner = f"out = If (yes) <{', '.join(ways)}>"
    return inner


def test_graphs_that_may_not_end_or_are_not_read_are_refused(make_tiny_model):
    twice = '\n<domain: "own", opset_import: ["" : 18]> Twice (a) => (b) { b = Identity (a) }'
    for text, words in (
        (with_nodes(ENDLESS), "the operator 'Loop', which may run forever"),
        (with_nodes(branches(ENDLESS)), "'Loop'"),
        (with_nodes(branches("out = Identity (zero)", 10)), "nested more than 8 deep"),
        (TINY_MODEL + twice, "functions of its own"),
    ):
        assert words in refusal(make_tiny_model(text=text))
    NetworkModel(make_tiny_model(text=with_nodes(branches("out = Identity (zero)", 4))))


def test_sparse_tensors_and_tensors_in_other_files_are_refused(make_tiny_model):
    def with_sparse(model):
        parts = [
            helper.make_tensor(kind[0], kind[1], (1,), [0])
            for kind in (("s", 1), ("i", TensorProto.INT64))
        ]
        model.graph.sparse_initializer.append(helper.make_sparse_tensor(*parts, [4]))

    assert "sparse tensors" in refusal(changed(make_tiny_model(), with_sparse))
    for attribute in (False, True):

        def with_file(model, attribute=attribute):
            told = TensorProto(name="told", data_type=TensorProto.FLOAT)
            tensor = told if attribute else model.graph.initializer[0]
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
    beyond = """most = ReduceMax <keepdims = 0> (input)
    index = Add (most, minus)
    whole = Cast <to = 7> (index)
    none = Gather (one_cell, whole)"""
    text = with_nodes(beyond).replace("probability = Average", "almost = Average")
    path = make_tiny_model(
        text=text.replace("(fine)", "(fine)\n    probability = Add (almost, none)")
    )
    with pytest.raises(ModelError, match="got one whose graph fails ") as caught:
        NetworkModel(path).try_out()
    assert "\n" not in str(caught.value)
    ground = uniform(0, (64, 64))
    np.savez(tmp_path / "dem.npz", elevation_m=ground, cell_size_m=5.0)
    words = ("--start", "5,5", "--goal", "60,60", "--method", "nnpp", "--model", path)
    nnpp_edge("plan", tmp_path / "dem.npz", *words).refused("whose graph fails")


def test_damage_anywhere_ends_in_an_answer_or_in_one_line(tiny_model, tmp_path, capfd):
    whole = tiny_model.read_bytes()
    rng = random.Random(3)
    path = tmp_path / "damaged.onnx"
    refused = 0
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


METADATA = """
blocks=0 | metadata
blocks=24 | metadata
omega=0.0 | metadata
omega=float('nan') | metadata
sigma=float('inf') | metadata
sigma=-1.0 | sigma
input_size=1 << 40, blocks=8 | metadata
format='other' | format
channels=('start_map', 'cost', 'goal_map') | channels
encoding='sine' | encoding
blocks=7 | go together
encoding='ends', channels=('cost', 'blocked', 'ends'), head=(1, 1, 1) | go together
region_factor=0.0 | region_factor
"""


def test_metadata_that_cannot_be_read_or_do_not_fit_are_one_line(make_tiny_model):
    odd = (
        "[" * 100_000,
        '{"a":' * 100_000,
        b'{"format": "nnpp-edge-model-1", "name": "\xff\xfe"}',
        "null",
        "3",
        None,
    )
    for text in (
        *odd,
        '{"format": ["nnpp-edge-model-1"]}',
        '{"format": "nnpp-edge-model-1"}',
        "9" * 6000,
    ):
        content = text.encode() if isinstance(text, str) else text or b""
        path = changed(make_tiny_model(), lambda model: model.ClearField("metadata_props"))
        if text is not None:
            named = {METADATA_KEY: "x" * len(content)}
            changed(path, lambda model, named=named: helper.set_model_props(model, named))
            path.write_bytes(path.read_bytes().replace(b"x" * len(content), content))
        assert "metadata" in refusal(path)
    for changes, word in (each.values for each in cases(METADATA)):
        assert word in refusal(make_tiny_model(**keywords(changes, {"json": json})))
    for changes, word in (({"input_size": 128}, "inputs"), ({"blocks": 16}, "output")):
        with pytest.raises(ModelError, match=word):
            NetworkModel(make_tiny_model(**changes))
