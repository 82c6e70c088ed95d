"""The paper's network: shapes, cost, gradients, its modules' properties, and its ONNX graph."""

from collections import Counter
from pathlib import Path
from typing import TypeVar

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from torch import nn

from nnpp_edge.export.to_onnx import quiet
from nnpp_edge.model.network import count_macs
from nnpp_edge.model.nnpp import NNPP, PRIOR_LOGIT, SPPM, STDC, UAFM, Conv2d, SpatialAttention, STDCModule
from nnpp_edge.runtime.errors import ModelError

M = TypeVar("M", bound=nn.Module)


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


def on_meta(*args, **kwargs) -> NNPP:
    """A network of shapes alone: nothing is allocated or computed."""
    with torch.device("meta"):
        return NNPP(*args, **kwargs)


def maps(batch: int, size: int, device: str = "cpu") -> torch.Tensor:
    return torch.rand(batch, 3, size, size, device=device)


def with_lived_in_statistics(module: M) -> M:
    """Give the normalisations running statistics, scales and shifts that are not the identity."""
    for norm in module.modules():
        if isinstance(norm, nn.BatchNorm2d):
            assert norm.running_mean is not None
            assert norm.running_var is not None
            nn.init.normal_(norm.running_mean, std=0.1)
            nn.init.uniform_(norm.running_var, 0.5, 1.5)
            nn.init.uniform_(norm.weight, 0.5, 1.5)
            nn.init.normal_(norm.bias, std=0.1)
    return module.eval()


def without_last_convolution(module: nn.Module) -> None:
    """Show what the last convolution reads."""
    module.out = nn.Identity()


def silence(branch: nn.Module) -> None:
    """Make a conv-norm-ReLU branch answer zero."""
    for norm in branch.modules():
        if isinstance(norm, nn.BatchNorm2d):
            nn.init.zeros_(norm.weight)
            nn.init.zeros_(norm.bias)


# ---- the whole network


def test_the_output_has_one_channel_at_an_eighth_of_the_input():
    for width in (2, 16, 64):
        for size in (128, 256, 512):
            logits = on_meta(size, width).eval()(maps(2, size, "meta"))
            assert (logits.shape, logits.dtype) == ((2, 1, size // 8, size // 8), torch.float32)


def test_what_cannot_be_built_or_shown_is_refused():
    for arguments in ({"input_size": 0}, {"input_size": 192}, {"width": 0}, {"width": 15}):
        with pytest.raises(ModelError, match="must be"):
            on_meta(**arguments)
    for shape in ((1, 3, 256, 256), (1, 1, 128, 128), (3, 128, 128)):
        with pytest.raises(ModelError, match=r"input must be \(N, 3, 128, 128\)"):
            on_meta(128, 2)(torch.empty(shape, device="meta"))


def test_the_gradient_reaches_every_parameter():
    network = NNPP(128, 8)
    network(maps(4, 128)).square().sum().backward()
    silent = [name for name, p in network.named_parameters() if p.grad is None or not p.grad.any()]
    assert silent == []
    assert all(p.grad.isfinite().all() for p in network.parameters() if p.grad is not None)


def test_an_untrained_network_answers_a_low_probability_everywhere():
    logits = NNPP(128, 16)(maps(2, 128))
    assert logits.detach().numpy() == pytest.approx(PRIOR_LOGIT, abs=1.0)


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_a_flat_input_gives_finite_logits(value):
    x = torch.full((2, 3, 128, 128), value)
    network = NNPP(128, 8)
    assert network(x).isfinite().all()
    assert network.eval()(x).isfinite().all()


def test_a_map_is_answered_alike_alone_and_in_a_batch():
    network = with_lived_in_statistics(NNPP(128, 8))
    x = maps(3, 128)
    with torch.no_grad():
        torch.testing.assert_close(network(x)[1:2], network(x[1:2]), rtol=1e-4, atol=1e-5)


# ---- what it costs


def test_macs_are_counted_by_the_formula_and_the_model_stays_as_it_was():
    model = nn.Sequential(nn.Conv2d(3, 8, 3, stride=2, padding=1), nn.BatchNorm2d(8), nn.Conv2d(8, 8, 5, groups=4))
    before = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    strided, grouped = 8 * 5 * 5 * 3 * 3 * 3, 8 * 1 * 1 * 2 * 5 * 5
    assert count_macs(model, (torch.rand(4, 3, 10, 10),)) == 4 * (strided + grouped)
    assert model.training and not vars(model[0])["_forward_hooks"]
    assert all(torch.equal(tensor, before[name]) for name, tensor in model.state_dict().items())


def test_the_network_costs_what_its_size_promises():
    for width, least, most in ((64, 1.2e9, 1.45e9), (16, 75e6, 95e6)):
        assert least < count_macs(on_meta(256, width), (maps(1, 256, "meta"),)) < most


# ---- STDC


@pytest.mark.parametrize("stride", [1, 2])
def test_a_module_concatenates_its_first_convolution_before_the_others(stride):
    module = STDCModule(8, 32, stride).eval()
    x = torch.rand(1, 8, 12, 12)
    with torch.no_grad():
        out, first = module(x), module.first(x)
        expected = first if stride == 1 else nn.functional.avg_pool2d(first, 3, stride=2, padding=1)
    assert out.shape == (1, 32, 12 // stride, 12 // stride)
    assert torch.equal(out[:, :16], expected)


def test_features_move_with_the_map_away_from_its_border():
    backbone = with_lived_in_statistics(STDC(width=4))
    x = maps(1, 256)
    with torch.no_grad():
        here, there = backbone(x)[0], backbone(torch.roll(x, (8, 16), dims=(2, 3)))[0]
    inside = (..., slice(10, -10), slice(10, -10))
    torch.testing.assert_close(torch.roll(here, (1, 2), dims=(2, 3))[inside], there[inside])


# ---- pyramid pooling


def test_pyramid_pooling_averages_at_three_scales():
    sppm = SPPM(6, 4, size=8).eval()
    x = torch.rand(1, 6, 8, 8)
    pooled = [pool(x) for pool in sppm.pools]
    assert [p.shape[-1] for p in pooled] == [1, 2, 4]
    for p in pooled:
        torch.testing.assert_close(p, nn.functional.adaptive_avg_pool2d(x, p.shape[-1]))


def test_pyramid_pooling_sees_its_input_through_each_branch_and_in_no_other_way():
    x, other = torch.rand(2, 1, 6, 8, 8).unbind(0)
    with torch.no_grad():
        for heard in (0, 1, 2, None):
            sppm = with_lived_in_statistics(SPPM(6, 4, size=8))
            for i, branch in enumerate(sppm.branches):
                if i == heard:
                    nn.init.ones_(branch.get_parameter("1.bias"))
                else:
                    silence(branch)
            assert torch.equal(sppm(x), sppm(other)) == (heard is None)


def test_pyramid_pooling_sums_its_branches():
    sppm = with_lived_in_statistics(SPPM(6, 4, size=8))
    without_last_convolution(sppm)
    x = torch.rand(1, 6, 8, 8)
    with torch.no_grad():
        expected = sum(
            branch(pool(x)).repeat_interleave(k, 2).repeat_interleave(k, 3)
            for pool, branch, k in zip(sppm.pools, sppm.branches, (8, 4, 2), strict=True)
        )
        torch.testing.assert_close(sppm(x), expected)


# ---- attention fusion


@pytest.mark.parametrize("magnitude", [0.0, 1.0, 1e4])
def test_attention_lies_in_0_to_1(magnitude):
    alpha = SpatialAttention()(*(magnitude * torch.randn(2, 2, 6, 8, 8)))
    assert alpha.shape == (2, 1, 8, 8)
    assert ((alpha >= 0) & (alpha <= 1)).all()


@pytest.mark.parametrize(("shift", "follows_high"), [(-200.0, False), (200.0, True)])
def test_shut_attention_follows_the_encoder_and_open_attention_the_decoder(shift, follows_high):
    uafm = UAFM(6, 10, 4).eval()
    norm = uafm.attention.weight[1]
    assert isinstance(norm, nn.BatchNorm2d)
    nn.init.constant_(norm.bias, shift)
    without_last_convolution(uafm)
    high, low = torch.rand(1, 6, 4, 4), torch.rand(1, 10, 8, 8)
    with torch.no_grad():
        expected = high.repeat_interleave(2, 2).repeat_interleave(2, 3) if follows_high else uafm.reduce(low)
        torch.testing.assert_close(uafm(high, low), expected)


# ---- export


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> tuple[NNPP, Path]:
    torch.manual_seed(0)
    network = with_lived_in_statistics(NNPP(128, 8))
    nn.init.normal_(network.classifier.weight, std=0.5)
    path = tmp_path_factory.mktemp("onnx") / "nnpp.onnx"
    with quiet():
        torch.onnx.export(
            network, (maps(1, 128),), path, dynamo=True, opset_version=18, external_data=False, verbose=False
        )
    return network, path


def test_onnxruntime_answers_as_torch_does(exported):
    network, path = exported
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (name,) = (i.name for i in session.get_inputs())
    for _ in range(3):
        x = maps(1, 128)
        (answer,) = session.run(None, {name: x.numpy()})
        with torch.no_grad():
            expected = network(x).numpy()
        assert expected.std() > 0.01
        np.testing.assert_allclose(answer, expected, atol=1e-4)


def test_the_graph_is_static_and_resizes_by_nearest(exported):
    graph = onnx.load(exported[1]).graph
    shapes = [[d.dim_value for d in v.type.tensor_type.shape.dim] for v in (*graph.input, *graph.output)]
    assert shapes == [[1, 3, 128, 128], [1, 1, 16, 16]]
    resizes = [node for node in graph.node if node.op_type == "Resize"]
    modes = {a.s for node in resizes for a in node.attribute if a.name == "mode"}
    assert len(resizes) == 5
    assert modes == {b"nearest"}
    assert not {"Shape", "Gather", "Pad"} & {node.op_type for node in graph.node}


def test_normalisations_fold_into_the_convolutions(exported, tmp_path):
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
    options.optimized_model_filepath = str(tmp_path / "optimised.onnx")
    onnxruntime.InferenceSession(exported[1], options, providers=["CPUExecutionProvider"])
    kinds = Counter(node.op_type for node in onnx.load(options.optimized_model_filepath).graph.node)
    convolutions = sum(isinstance(m, nn.Conv2d) for m in exported[0].modules())
    assert kinds["Conv"] + kinds["FusedConv"] == convolutions
    assert kinds["BatchNormalization"] == 0


def test_strided_depthwise_convolutions_stay_in_float32_on_a_cpu_in_bfloat16():
    x = torch.rand(2, 8, 16, 16)
    down, plain = Conv2d(8, 8, 3, 2, 1, groups=8, bias=False), Conv2d(8, 8, 3, 2, 1, bias=False)
    with torch.autocast("cpu", torch.bfloat16):
        half = down(x.to(torch.bfloat16))
        assert plain(x).dtype is torch.bfloat16
    assert half.dtype is torch.float32
    torch.testing.assert_close(half, down(x.to(torch.bfloat16).float()))
