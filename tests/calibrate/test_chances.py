"""Chances of passage networks, brought in line with what came true."""

import numpy as np
import torch

from nnpp_edge.calibrate.chances import LINKS, POSES, came_true, make_chances_true
from nnpp_edge.calibrate.passage_searches import reliability
from nnpp_edge.model.passage import PassageNet
from nnpp_edge.terrain.passage import CLOSED
from nnpp_edge.training.passage_batches import PassageBatch


def batch_of(seed, network, too_sure):
    """A vehicle's maps on which each chance comes true as often as it says once it is 1 / `too_sure` as sure."""
    rng = np.random.default_rng(seed)
    blocks = torch.from_numpy(rng.uniform(-1.0, 1.0, (1, 2, 19, 14, 14)).astype(np.float32))
    numbers = torch.from_numpy(rng.uniform(-1.0, 1.0, (1, 12)).astype(np.float32))
    with torch.no_grad():
        logits = network(blocks, numbers)[..., 1:-1, 1:-1].numpy() / too_sure - 0.5
    so = rng.random(logits.shape) < 1.0 / (1.0 + np.exp(-logits))
    passing, link = 16 * so[:, :, POSES], np.where(so[:, :, LINKS], 0, CLOSED)
    labels = {"passing": passing, "cost": 0 * passing, "link": link}
    return PassageBatch(blocks, numbers, {k: torch.from_numpy(v.astype(np.uint8)) for k, v in labels.items()})


def test_chances_that_were_too_sure_come_true_afterwards():
    torch.manual_seed(0)
    network = PassageNet((8,), (3,), 2, 8).eval()
    with torch.no_grad():
        network.head.kernels *= 3.0
    batches = [batch_of(seed, network, 2.0) for seed in range(24)]
    before = [network(batch.blocks, batch.numbers)[0].detach().numpy() for batch in batches]
    make_chances_true(network, batches)
    after = [network(batch.blocks, batch.numbers)[0].detach().numpy() for batch in batches]
    for name, part in (("pose", POSES), ("link", LINKS)):
        wrong = [
            sum(weight * abs(said - so) for said, so, weight in reliability(each, batches)[name])
            for each in (before, after)
        ]
        assert wrong[0] > 0.08 and wrong[1] < 0.02
        said = np.mean([1.0 / (1.0 + np.exp(-each[:, part, 1:-1, 1:-1])) for each in after])
        assert abs(said - np.mean([came_true(batch, part) for batch in batches])) < 1e-3
