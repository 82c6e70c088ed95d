import numpy as np
import pytest

from nnpp_edge.runtime import NetworkModel, plan_path
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.model_file import ModelMetadata


def test_a_model_answers_with_probabilities_of_its_blocks(network):
    rng = np.random.default_rng(0)
    network.set_map(rng.random((2, 64, 64)).astype(np.float32))
    first = network.answer((5.0, 6.0), (50.0, 40.0)).copy()
    assert first.shape == (8, 8)
    assert 0.0 <= first.min() <= first.max() <= 1.0
    assert not np.array_equal(first, network.answer((60.0, 60.0), (3.0, 5.0)))
    np.testing.assert_array_equal(first, network.answer((5.0, 6.0), (50.0, 40.0)))


def test_metadata_that_does_not_fit_is_refused(make_tiny_model):
    for change, word in (
        ({"format": "other"}, "format"),
        ({"channels": ("start_map", "cost", "goal_map")}, "channels"),
        ({"encoding": "sine"}, "encoding"),
        ({"input_size": 128}, "inputs"),
        ({"blocks": 16}, "output"),
        ({"blocks": 7}, "go together"),
        ({"region_factor": 0.0}, "region_factor"),
        ({"sigma": -1.0}, "sigma"),
    ):
        path = make_tiny_model(**change)
        with pytest.raises(ModelError, match=word) as caught:
            NetworkModel(path)
        assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_files_that_are_no_models_are_refused(tiny_model, tmp_path):
    whole = tiny_model.read_bytes()
    for name, content in (("empty", b""), ("half", whole[: len(whole) // 2]), ("text", b"no model at all")):
        path = tmp_path / f"{name}.onnx"
        path.write_bytes(content)
        with pytest.raises(ModelError, match="wanted an ONNX model") as caught:
            NetworkModel(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(ModelError, match=r"shipped model \(.*edge"):
        NetworkModel("nosuch")


def test_a_model_of_others_is_refused(tiny_model, tmp_path):
    import onnx

    model = onnx.load(tiny_model)
    del model.metadata_props[:]
    onnx.save(model, tmp_path / "plain.onnx")
    with pytest.raises(ModelError, match="metadata"):
        NetworkModel(tmp_path / "plain.onnx")


def test_metadata_survives_its_json(network):
    assert ModelMetadata.from_json(network.metadata.to_json(), "x") == network.metadata


def test_the_shipped_model_plans():
    cost = np.random.default_rng(0).random((256, 256)).astype(np.float32) * 0.5
    cost[100:120, :230] = 1.0
    model = NetworkModel("edge")
    assert model.metadata.precision == "int8"
    assert model.path.stat().st_size <= 3e6
    plan = plan_path(cost, (10, 10), (240, 20), method="nnpp", model=model)
    exact = plan_path(cost, (10, 10), (240, 20), method="astar")
    assert plan.ok
    assert plan.cost <= 1.05 * exact.cost
    assert 0.0 < plan.threshold <= 1.0
