"""Chances that come true: a passage network's logits, stretched and shifted to what is so on maps held out."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from nnpp_edge.model.passage import PassageNet
from nnpp_edge.terrain.passage import CLOSED
from nnpp_edge.training.passage_batches import PassageBatch

POSES, LINKS = slice(0, 4), slice(8, 12)
"""The answers that are chances."""
_ROUNDS, _RIDGE = 25, 1e-6


def make_chances_true(network: PassageNet, batches: Sequence[PassageBatch]) -> None:
    """Stretch and shift both kinds of chances, in the network's head, to what is likeliest on these maps (Platt).

    On average a chance is then what came true. `batches` are of one vehicle each, which no training has seen.
    """
    head, fitted = network.head, []
    with torch.no_grad():
        found = [network(batch.blocks, batch.numbers)[0, ..., 1:-1, 1:-1].numpy() for batch in batches]
        for part in (POSES, LINKS):
            said = np.concatenate([logits[:, part].ravel() for logits in found])
            true = np.concatenate([came_true(batch, part).ravel() for batch in batches])
            fitted.append((part, *_stretch_and_shift(said, true)))
        for part, by, more in fitted:
            head.kernels[:, part] *= by
            head.bias.weight[part] *= by
            head.bias.bias[part] = by * head.bias.bias[part] + more


def came_true(batch: PassageBatch, part: slice) -> NDArray[np.float64]:
    """(N, 4, R, C): the share of a block's poses that pass, or whether there is a way to the next block."""
    if part is POSES:
        return np.asarray(batch.labels["passing"][0].numpy() / 16.0, np.float64)
    return np.asarray(batch.labels["link"][0].numpy() != CLOSED, np.float64)


def _stretch_and_shift(said: NDArray[np.floating], true: NDArray[np.float64]) -> tuple[float, float]:
    """The likeliest a and b of chances of logits a · x + b, by Newton's steps."""
    x = np.stack([said.astype(np.float64), np.ones(len(said))])
    found = np.array([1.0, 0.0])
    for _ in range(_ROUNDS):
        chance = 1.0 / (1.0 + np.exp(-found @ x))
        bend = (x * (chance * (1.0 - chance))) @ x.T + _RIDGE * len(said) * np.eye(2)
        found = found - np.linalg.solve(bend, x @ (chance - true))
    return float(found[0]), float(found[1])
