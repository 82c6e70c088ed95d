"""The exported model: its answers, its metadata, and how it is written."""

import copy
import math
import re
from types import SimpleNamespace

import msgspec
import onnx
import pytest
import torch
from torch import nn

from nnpp_edge.export import to_onnx as export
from nnpp_edge.export.to_onnx import dataset_facts, export_network, parity
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime import NetworkModel
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.model_file import HEAD_KEY, model_path
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.training.checkpoint import Checkpoint, Progress, load_checkpoint
from nnpp_edge.training.settings import TrainSettings

EDGE = Spec(
    "edge", 64, options={"widths": (8, 8, 8, 8), "stem": 8, "relation": 12, "hidden": (9, 7)}
)
NNPP = Spec("nnpp", 128, 0.3, options={"width": 2})

TOLD = {"name": "small", "region_factor": 0.4, "omega": 0.037, "training": {"steps": 3}}
LIMITS = Traversability(slope_limit_deg=21.0)


def lived_in(spec: Spec) -> Network:
    """An untrained network whose norms are not the identity and whose answers are spread out."""
    torch.manual_seed(3)
    network = Network(spec)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            for values in (module.running_mean, module.bias):
                nn.init.normal_(values, std=0.2)
            for values in (module.running_var, module.weight):
                nn.init.uniform_(values, 0.5, 1.5)
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
    """A network, its ONNX `file`, and the `report` of the export."""
    folder = tmp_path_factory.mktemp("export")
    network = lived_in(request.param)
    saved = load_checkpoint(checkpoint(folder / "checkpoint.pt", network))
    file = folder / "model.onnx"
    report = export_network(saved.trained(), file, **TOLD, limits=LIMITS)
    return SimpleNamespace(network=network, spec=network.spec, file=file, report=report)


@pytest.mark.parametrize("text", ["", "no numbers", "AACAPw==", None])
def test_a_head_without_its_parameters_is_refused(tmp_path, text):
    model = onnx.load(model_path("edge-fp32"))
    stored = {each.key: each.value for each in model.metadata_props}
    del stored[HEAD_KEY]
    if text is not None:
        stored[HEAD_KEY] = text
    onnx.helper.set_model_props(model, stored)
    onnx.save(model, tmp_path / "other.onnx")
    with pytest.raises(ModelError, match="does not fit its metadata"):
        NetworkModel(tmp_path / "other.onnx")


def test_the_runtime_answers_what_the_network_answers(exported):
    """Cell for cell, on maps without any symmetry: the layouts of input and output agree."""
    found = parity(exported.network, exported.file)
    assert (found.passed, found.queries) == (True, 32)
    assert found.mean_difference <= found.max_difference <= 1e-4


def test_another_network_is_noticed(exported):
    """The edge network's blocks come in another order."""
    other = lived_in(exported.spec)
    layer = last_layer(other)
    layer.weight.data = layer.weight.data.flip(0) if len(layer.weight) > 1 else -layer.weight.data
    assert not parity(other, exported.file).passed


def test_the_file_is_whole_folded_and_free_of_local_paths(exported):
    file = exported.file
    graph = onnx.load(file, load_external_data=False)
    assert graph.opset_import[0].version == 18
    graph = graph.graph
    assert exported.report.macs > 10_000
    assert exported.report.size_bytes == file.stat().st_size
    assert exported.report.nodes == len(graph.node)
    assert not any(tensor.external_data for tensor in graph.initializer)
    unwanted = {"BatchNormalization", "Identity", "Shape", "Gather", "Pad"}
    assert not unwanted & {node.op_type for node in graph.node}
    assert not re.search(rb"\.py\b", file.read_bytes())
    for node in graph.node:
        modes = [attribute.s for attribute in node.attribute if attribute.name == "mode"]
        assert node.op_type != "Resize" or modes == [b"nearest"]  # int8 values stay as they are


def test_the_file_says_how_the_maps_were_made_that_it_was_trained_on(exported):
    found = vars(NetworkModel(exported.file).metadata)
    spec = exported.spec
    sizes = {"input_size": spec.input_size, "blocks": spec.blocks, "sigma": spec.sigma}
    assert found == found | TOLD | sizes
    assert found["cost_limits"]["slope_limit_deg"] == 21.0
    assert "hard_slope_deg" not in found["cost_limits"], "JSON has no infinity"


@pytest.fixture(scope="module")
def graph():
    """Of the edge network, as torch writes it."""
    return export.to_onnx(lived_in(EDGE))


@pytest.fixture
def written(graph, monkeypatch):
    """Torch, which takes seconds to write it, is not asked again."""
    monkeypatch.setattr(export, "to_onnx", lambda network: copy.deepcopy(graph))


def test_a_model_that_the_runtime_would_refuse_is_not_written(tmp_path, written):
    output = tmp_path / "out.onnx"
    with pytest.raises(ModelError, match=f"^{output}: .*region_factor"):
        export_network(lived_in(EDGE), output, name="x", region_factor=1.5)
    infinite = lived_in(EDGE)
    infinite.body.head.way.weight.data[0, 0] = math.inf
    with pytest.raises(ModelError, match=f"^{output}: .* finite parameters of its head"):
        export_network(infinite, output, name="x")
    assert not list(tmp_path.iterdir())


def test_metadata_names_terrain_without_its_folders():
    recipe = Recipe(("/somewhere/private/moon.tif",))
    assert dataset_facts(recipe) == msgspec.structs.asdict(recipe) | {"terrain": ["moon.tif"]}


def test_the_command_reports_and_ends_well(nnpp_edge, tmp_path, written):
    path = checkpoint(tmp_path / "checkpoint.pt", lived_in(EDGE))
    file = tmp_path / "lunar.onnx"
    ended = nnpp_edge("export", path, "-o", file)
    assert (ended.code, ended.err) == (0, "")
    assert "parity passed" in ended.out
    found = nnpp_edge("export", path, "-o", file, "--region-factor", 0.25, "--json").json
    assert found["parity"]["passed"]
    assert found["size_bytes"] == file.stat().st_size
    metadata = NetworkModel(file).metadata
    assert (metadata.name, metadata.region_factor) == ("lunar", 0.25)
    nnpp_edge("export", tmp_path / "none.pt", "-o", file).refused("wanted a checkpoint")
