"""The paper's network: shapes, cost, gradients, and that it is the one whose weights are
shipped.
"""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from nnpp_edge.model.network import Network, count_macs, encode
from nnpp_edge.model.nnpp import NNPP, PRIOR_LOGIT, Conv2d
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.training.checkpoint import load_checkpoint

PAPER = Path(__file__).parents[2] / "training-state" / "paper.pt"


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


def on_meta(*args, **kwargs) -> NNPP:
    """A network of shapes alone: nothing is allocated or computed."""
    with torch.device("meta"):
        return NNPP(*args, **kwargs)


def maps(batch: int, size: int, device: str = "cpu") -> torch.Tensor:
    return torch.rand(batch, 3, size, size, device=device)


def test_the_shipped_weights_give_the_shipped_models_answers():
    """All of the architecture at once; the model is in int8."""
    network = load_checkpoint(PAPER).trained()
    model = NetworkModel("paper")
    rough = np.random.default_rng(0).random((2, 32, 32), np.float32).repeat(8, 1).repeat(8, 2)
    start = (20.5, 60.0)
    goal = (200.0, 180.25)
    model.set_map(rough)
    query = torch.from_numpy(encode(network.spec, start, goal))
    with torch.no_grad():
        wanted = torch.sigmoid(network(torch.from_numpy(rough)[None], query[None]))[0].numpy()
    assert wanted.max() > 0.1 and wanted.std() > 0.01
    answer = model.answer(start, goal)
    assert np.abs(answer - wanted).mean() < 0.01
    assert np.corrcoef(answer.ravel(), wanted.ravel())[0, 1] > 0.98


def test_what_cannot_be_built_or_shown_is_refused():
    for size, width in ((0, 64), (192, 64), (256, 0), (256, 15)):
        with pytest.raises(ModelError, match="must be"), torch.device("meta"):
            Network(Spec("nnpp", size, options={"width": width}))
    for shape in ((1, 3, 256, 256), (1, 1, 128, 128), (3, 128, 128)):
        with pytest.raises(ModelError, match=r"input must be \(N, 3, 128, 128\)"):
            on_meta(128, 2)(torch.empty(shape, device="meta"))


def test_the_gradient_reaches_every_parameter():
    network = NNPP(128, 8)
    network(maps(4, 128)).square().sum().backward()
    for name, p in network.named_parameters():
        assert p.grad is not None and p.grad.any() and p.grad.isfinite().all(), name


def test_an_untrained_network_answers_a_low_probability_everywhere_and_flat_inputs_too():
    assert NNPP(128, 16)(maps(2, 128)).detach().numpy() == pytest.approx(PRIOR_LOGIT, abs=1.0)
    for value in (0.0, 1.0):
        network = NNPP(128, 8)
        x = torch.full((2, 3, 128, 128), value)
        assert network(x).isfinite().all() and network.eval()(x).isfinite().all()


def test_the_network_costs_what_its_size_promises():
    model = nn.Sequential(
        nn.Conv2d(3, 8, 3, stride=2, padding=1), nn.BatchNorm2d(8), nn.Conv2d(8, 8, 5, groups=4)
    )
    assert count_macs(model, (torch.rand(4, 3, 10, 10),)) == 4 * (
        8 * 5 * 5 * 3 * 3 * 3 + 8 * 1 * 1 * 2 * 5 * 5
    )
    assert model.training and not model[1].num_batches_tracked
    for width, least, most in ((64, 1.2e9, 1.45e9), (16, 75e6, 95e6)):
        assert least < count_macs(on_meta(256, width), (maps(1, 256, "meta"),)) < most


def test_strided_depthwise_convolutions_stay_in_float32_on_a_cpu_in_bfloat16():
    x = torch.rand(2, 8, 16, 16)
    down = Conv2d(8, 8, 3, 2, 1, groups=8, bias=False)
    plain = Conv2d(8, 8, 3, 2, 1, bias=False)
    with torch.autocast("cpu", torch.bfloat16):
        half = down(x.to(torch.bfloat16))
        assert plain(x).dtype is torch.bfloat16
    assert half.dtype is torch.float32
    torch.testing.assert_close(half, down(x.to(torch.bfloat16).float()))
