"""`nnpp-edge models`: the list and the card of a model, held to the metadata of its file."""

import hashlib
import json
from pathlib import Path

import pytest

from nnpp_edge.runtime.network.model_file import ModelMetadata, read_model_file

MODELS = Path(__file__).parents[2] / "nnpp_edge" / "models"
SHIPPED = sorted(path.stem for path in MODELS.glob("*.onnx"))


@pytest.fixture
def model(make_tiny_model):
    """A model of one's own, with room for a card beside it."""
    return make_tiny_model(
        training={"dataset": {"maps": 7}, "workloads": [["soft", 0.5]], "excluded": []}
    )


def test_the_list_says_what_each_shipped_model_is_for(run, told):
    rows = {line.split()[0]: line for line in run("models").out.splitlines() if line.strip()}
    listed = {each["name"]: each for each in told("models")}
    assert list(listed) == SHIPPED
    for name, each in listed.items():
        digest = hashlib.sha256((MODELS / f"{name}.onnx").read_bytes()).hexdigest()
        assert each["sha256"] == digest and "card" not in each
        size = f"{each['size_bytes'] / 1e6:.2f}"
        for word in (each["purpose"], each["metadata"]["precision"], size, digest[:8]):
            assert word in rows[name]
    assert listed["edge"]["metadata"]["precision"] == "int8"


def stages(training):
    """What a training says of itself and of the one that it began with, the first of them first."""
    before = training.get("begun_with")
    return [*(stages(before) if before else []), training]


OF_MODELS = [name for name in SHIPPED if not name.endswith("-fp32")]


@pytest.mark.parametrize("name", OF_MODELS)
def test_a_card_is_that_of_its_file(name):
    found = read_model_file(name)
    m = found.metadata
    for words in (
        f"sha256 {found.sha256[:8]}",
        f"`{name}.onnx` ({m.precision}, ",
        f"QDQ {m.precision} on {m.training['calibration']['samples']} queries",
        f"{m.blocks} × {m.blocks} ",
        *(f"{stage['steps']:,} steps" for stage in stages(m.training)),
        *([f"{{p ≥ {m.region_factor:g} · td}}"] if m.encoding != "unseen" else []),
    ):
        assert words in found.card


def test_a_file_of_ones_own_is_shown_with_what_lies_beside_it(run, told, model):
    ended = run("models changed.onnx")
    assert (ended.code, ended.err) == (0, "")
    assert all(word in ended.out for word in ('"maps": 7', '"excluded": []', '"architecture": "'))
    found = told("models changed.onnx")
    assert (found["name"], found["metadata"]["name"]) == ("changed", "tiny")
    assert found["sha256"] in ended.out
    assert found["card"] is None
    model.with_suffix(".md").write_text("# A card of its own\n")
    assert "# A card of its own" in run("models changed.onnx").out


def test_a_shipped_model_is_meant_by_its_name_whatever_lies_here_and_a_factor_may_be_left_out(run):
    Path("edge").write_bytes(b"no model")
    assert run("models edge").code == 0
    found = read_model_file("edge")
    assert found.path.parent == MODELS
    told = json.loads(found.metadata.to_json())
    del told["region_factor"]
    assert ModelMetadata.from_json(json.dumps(told), "older.onnx").region_factor == 0.5


def test_what_is_no_model_is_refused_in_one_line(run, model, make_tiny_model):
    for key, value in (("input_size", "64"), ("encoding", ["ends"]), ("sigma", None)):
        make_tiny_model(**{key: value})
        run("models changed.onnx").refused("wanted metadata of format", f"$.{key}")
    model.write_bytes(b"no model at all")
    run("models changed.onnx").refused("changed.onnx", "wanted an ONNX model")
    run("models nosuch").refused(", ".join(SHIPPED), "'nosuch'")
    run("models .").refused("wanted a model file")
    make_tiny_model(architecture="split")  # its former name
    assert '"architecture": "edge"' in run("models changed.onnx").out
