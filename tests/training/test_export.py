"""The exported model: what it answers, what it tells of itself, and how it is written."""

import json
import re
from types import SimpleNamespace

import msgspec
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from torch import nn

from nnpp_edge import __version__
from nnpp_edge.export.to_onnx import dataset_facts, export_network, parity
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import DataSetError, ModelError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import METADATA_KEY
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.training.checkpoint import Checkpoint, Progress, TrainSettings, load_checkpoint

EDGE = Spec(
    "edge", 64, options={"widths": (8, 8, 8, 8), "stem": 8, "relation": 12, "hidden": (9, 7)}
)
NNPP = Spec("nnpp", 128, options={"width": 2})


def lived_in(spec: Spec) -> Network:
    """An untrained network whose norms are not the identity and whose answers are spread out."""
    torch.manual_seed(3)
    network = Network(spec)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.normal_(module.running_mean, std=0.2)
            nn.init.uniform_(module.running_var, 0.5, 1.5)
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.normal_(module.bias, std=0.2)
    nn.init.normal_(last_layer(network).weight, std=0.3)
    return network.eval()


def last_layer(network: Network) -> nn.Module:
    """The one that the answer comes from."""
    return [module for module in network.modules() if isinstance(module, nn.Conv2d | nn.Linear)][-1]


def checkpoint(path, network):
    """A checkpoint of a network that is said to have been trained for 7 steps."""
    weights = network.state_dict()
    progress = Progress(epoch=2, step=7, spent_s=1.5)
    Checkpoint(network.spec, TrainSettings(), progress, weights, weights, {}).save(path)
    return path


@pytest.fixture(scope="module", params=[EDGE, NNPP], ids=lambda spec: spec.architecture)
def exported(request, tmp_path_factory):
    """A network, its ONNX file, and the report of the export."""
    folder = tmp_path_factory.mktemp("export")
    network = lived_in(request.param)
    saved = load_checkpoint(checkpoint(folder / "checkpoint.pt", network))
    file = folder / "model.onnx"
    facts = saved.facts() | {"of": "us"}
    return (
        network,
        file,
        export_network(saved.trained(), file, name="small", region_factor=0.4, training=facts),
    )


def some_samples(size):
    """Three maps of terrain-like blobs, two queries on each."""
    rng = np.random.default_rng(5)
    rough = rng.random((3, 2, size // 8, size // 8)).repeat(8, axis=2).repeat(8, axis=3)
    ends = rng.uniform(0, size - 1, (2, 6, 2)).astype(np.float32)
    labels = np.zeros((6, 8, 8), np.uint8)
    return Samples(
        (255 * rough).astype(np.uint8), np.arange(6, dtype=np.int32) // 2, *ends, labels, labels
    )


@pytest.fixture(scope="module")
def edge_model(tmp_path_factory):
    file = tmp_path_factory.mktemp("edge") / "model.onnx"
    export_network(lived_in(EDGE), file, name="edge")
    return file


def test_an_encoder_runs_once_for_each_map(edge_model):
    model = NetworkModel(edge_model)
    runs = []
    session = model.session
    model.session = SimpleNamespace(
        run_with_iobinding=lambda *words: runs.append(session.run_with_iobinding(*words))
    )
    whole = onnxruntime.InferenceSession(edge_model)
    rng = np.random.default_rng(2)
    for maps in (1, 2):
        model.set_map(rng.random((2, 64, 64), np.float32))
        for _ in range(3):
            ends = [(float(r), float(c)) for r, c in rng.uniform(0, 63, (2, 2))]
            got = model.answer(*ends)
            (wanted,) = whole.run(["probability"], model.inputs | {"ask": np.array([True])})
            assert got.std() > 0.01
            wanted = wanted.reshape(2, 2, 8, 8).transpose(2, 0, 3, 1).reshape(16, 16)
            np.testing.assert_allclose(got, wanted, atol=1e-5)
        assert len(runs) == maps + (maps - 1)
        np.testing.assert_array_equal(model.answer(*ends, anew=True), got)
        assert len(runs) == 2 * maps


def test_a_head_that_is_not_its_graphs_and_blocks_that_do_not_fit_the_places_are_refused(
    edge_model, tmp_path
):
    model = onnx.load(edge_model)
    (count,) = (
        v.type.tensor_type.shape.dim[0].dim_value for v in model.graph.output if v.name == "head"
    )
    (held,) = (t for t in model.graph.initializer if list(t.dims) == [count])
    numbers = onnx.numpy_helper.to_array(held).copy()
    numbers[-1] += 0.1
    held.CopyFrom(onnx.numpy_helper.from_array(numbers, held.name))
    onnx.save(model, tmp_path / "other.onnx")
    with pytest.raises(ModelError, match="not those of its graph"):
        NetworkModel(tmp_path / "other.onnx")
    model = onnx.load(edge_model)
    facts = json.loads(next(p.value for p in model.metadata_props if p.key == METADATA_KEY))
    facts |= {"blocks": 8}
    onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(facts)})
    onnx.save(model, tmp_path / "other.onnx")
    with pytest.raises(ModelError, match="that do not go together"):
        NetworkModel(tmp_path / "other.onnx")


def test_the_runtime_answers_what_the_network_answers_and_another_network_is_noticed(exported):
    """Cell for cell, on maps without any symmetry: the layouts of input and output agree."""
    network, file, _ = exported
    for source, samples in (("dataset", some_samples(network.spec.input_size)), ("random", None)):
        found = parity(network, file, samples, n=4)
        assert found.passed and (found.queries, found.inputs) == (4, source)
        assert found.mean_difference <= found.max_difference <= 1e-4
    other = lived_in(network.spec)
    layer = last_layer(other)
    layer.weight.data = layer.weight.data.flip(0) if len(layer.weight) > 1 else -layer.weight.data
    assert not parity(other, file, n=2).passed  # of edge, with its blocks in another order
    with pytest.raises(DataSetError, match="wanted maps of"):
        parity(network, file, some_samples(2 * network.spec.input_size))


def test_metadata_comes_back_from_the_file(exported):
    network, file, _ = exported
    m = NetworkModel(file).metadata
    spec = network.spec
    assert (m.name, m.architecture, m.precision, m.version) == (
        "small",
        spec.architecture,
        "fp32",
        __version__,
    )
    assert (m.input_size, m.blocks, m.encoding) == (spec.input_size, spec.blocks, spec.encoding)
    assert (m.sigma, m.omega, m.region_factor) == (0.25, 0.011, 0.4)
    assert m.head == ((12, 9, 7) if spec.architecture == "edge" else ())
    assert Traversability(**m.cost_limits) == Traversability()
    assert [m.training[name] for name in ("steps", "seconds", "of")] == [7, 1.5, "us"]


def test_the_file_is_whole_folded_and_free_of_local_paths(exported):
    network, file, report = exported
    model = onnx.load(file, load_external_data=False)
    assert model.opset_import[0].version == 18 and report.macs > 10_000
    assert (report.size_bytes, report.nodes) == (file.stat().st_size, len(model.graph.node))
    assert not any(tensor.external_data for tensor in model.graph.initializer)
    assert not {"BatchNormalization", "Identity"} & {node.op_type for node in model.graph.node}
    names = [node.name for node in model.graph.node]
    assert len(set(names)) == len(names)
    if network.spec.architecture == "edge":
        assert {"encoder.stem.1/Conv", "encoder.describe/Conv", "If"} <= set(names)
        assert all(name.startswith(("encoder.", "If")) for name in names)
    assert not re.search(rb"\.py\b", file.read_bytes())
    modes = {
        a.s
        for n in model.graph.node
        if n.op_type == "Resize"
        for a in n.attribute
        if a.name == "mode"
    }
    assert modes == {b"nearest"}  # int8 values stay as they are
    assert not {"Shape", "Gather", "Pad"} & {node.op_type for node in model.graph.node}


def test_what_the_runtime_would_refuse_is_not_written_and_a_data_set_is_told_without_its_folders(
    tmp_path,
):
    with pytest.raises(ModelError, match="region_factor"):
        export_network(lived_in(EDGE), tmp_path / "out.onnx", name="x", region_factor=1.5)
    mad = lived_in(EDGE)
    next(mad.body.encoder.parameters()).data.view(-1)[0] = 3e38
    mad.body.head.way.weight.data[:] = 3e38
    with pytest.raises(ModelError, match=f"^{tmp_path}/out.onnx: the head"):
        export_network(mad, tmp_path / "out.onnx", name="x")
    assert not list(tmp_path.iterdir())
    recipe = Recipe(("/somewhere/private/moon.tif",))
    assert dataset_facts(recipe) == msgspec.structs.asdict(recipe) | {"terrain": ["moon.tif"]}


def test_the_command_reports_and_ends_well(nnpp_edge, tmp_path):
    path = checkpoint(tmp_path / "checkpoint.pt", lived_in(EDGE))
    file = tmp_path / "lunar.onnx"
    told = nnpp_edge("export", path, "-o", file)
    assert (told.code, told.err) == (0, "")
    assert "parity passed" in told.out
    found = json.loads(nnpp_edge("export", path, "-o", file, "--region-factor", 0.25, "--json").out)
    assert found["parity"]["passed"] and found["size_bytes"] == file.stat().st_size
    metadata = NetworkModel(file).metadata
    assert (metadata.name, metadata.region_factor) == ("lunar", 0.25)
    nnpp_edge("export", tmp_path / "none.pt", "-o", tmp_path / "out.onnx").refused(
        "wanted a checkpoint"
    )
