"""The paper's network: gradients, cost, and that it is the one whose weights are shipped."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nnpp_edge.model.network import Network, count_macs
from nnpp_edge.model.nnpp import NNPP, PRIOR_LOGIT, Conv2d
from nnpp_edge.model.registry import PRESETS, Spec
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.training.checkpoint import load_checkpoint

PAPER = Path(__file__).parents[2] / "training-state" / "paper.pt"


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


def test_the_shipped_weights_give_the_shipped_models_answers():
    """All of the architecture at once; the model is in int8."""
    network = load_checkpoint(PAPER).trained()
    model = NetworkModel("paper")
    rough = np.random.default_rng(0).random((2, 32, 32), np.float32).repeat(8, 1).repeat(8, 2)
    ends = ((20.5, 60.0), (200.0, 180.25))
    wanted = network.answers(rough[None], np.array([ends], np.float32))[0]
    assert wanted.max() > 0.1
    assert wanted.std() > 0.01
    model.set_map(rough)
    answer = model.answer(*ends)
    assert np.abs(answer - wanted).mean() < 0.01
    assert np.corrcoef(answer.ravel(), wanted.ravel())[0, 1] > 0.98


def test_maps_in_bytes_are_shown_in_255ths():
    network = Network(Spec("nnpp", 128, options={"width": 2}))
    rng = np.random.default_rng(0)
    planes = rng.integers(0, 256, (2, 2, 128, 128), np.uint8)
    ends = rng.uniform(0.0, 127.0, (2, 2, 2)).astype(np.float32)
    wanted = network.answers(planes / np.float32(255.0), ends)
    np.testing.assert_array_equal(network.answers(planes, ends), wanted)


@pytest.mark.parametrize("size", [0, 192])
def test_a_size_that_cannot_be_built_is_refused(size):
    with pytest.raises(ModelError, match=f"must be a positive multiple of 128, got {size}"):
        Spec("nnpp", size)


def test_the_gradient_reaches_every_parameter():
    network = NNPP(128, 8)
    network(torch.rand(4, 3, 128, 128)).square().sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad.any(), name
        assert parameter.grad.isfinite().all(), name


def test_an_untrained_network_answers_a_low_probability_everywhere():
    answer = NNPP(128, 16)(torch.rand(2, 3, 128, 128)).detach().numpy()
    assert answer == pytest.approx(PRIOR_LOGIT, abs=1.0)


def test_strided_depthwise_convolutions_stay_in_float32_on_a_cpu_in_bfloat16():
    down = Conv2d(8, 8, 3, 2, 1, groups=8, bias=False)
    plain = Conv2d(8, 8, 3, 2, 1, bias=False)
    half = torch.rand(2, 8, 16, 16).to(torch.bfloat16)
    with torch.autocast("cpu", torch.bfloat16):
        assert (down(half).dtype, plain(half).dtype) == (torch.float32, torch.bfloat16)


MACS = {"edge": 3.5e6, "nnpp-w16": 87e6, "nnpp": 1.3e9, "unseen": 159e6}
"""Multiply-accumulates, by the table of docs/models.md."""


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_can_be_built(name):
    """It costs what its size promises, and answers on its blocks."""
    spec = PRESETS[name]
    unseen = spec.encoding == "unseen"
    with torch.device("meta"):
        network = Network(spec)
        maps = torch.zeros(1, 12 if unseen else 2, spec.input_size, spec.input_size)
        facts = torch.zeros(1, 2, 2)
    shown = network.shown(maps, facts)
    shape = (3, spec.blocks, spec.blocks) if unseen else (spec.blocks, spec.blocks)
    assert count_macs(network, shown) == pytest.approx(MACS[name], rel=0.05)
    assert network.training
    assert network.eval()(*shown).shape == (1, *shape)
