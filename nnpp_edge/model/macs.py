"""What a network costs, counted and not timed: multiply-accumulates of its convolutions and linear layers."""

from copy import deepcopy

import torch
from torch import Tensor, nn


def count_macs(model: nn.Module, example_inputs: Tensor | tuple[Tensor, ...]) -> int:
    """Multiply-accumulates that the Conv2d and Linear layers spend on one forward pass over `example_inputs`.

    That is the sum over the layers of outputs × inputs read for each, for the whole batch. Biases, normalisation (it
    folds), additions, pooling and other kinds of layers are left out. The model is copied, so its mode, hooks and
    running statistics stay as they are. On the `meta` device nothing is computed.
    """
    inputs = example_inputs if isinstance(example_inputs, tuple) else (example_inputs,)
    counted = 0

    def count(layer: nn.Module, _: tuple[Tensor, ...], output: Tensor) -> None:
        nonlocal counted
        assert isinstance(layer, nn.Conv2d | nn.Linear)
        counted += output.numel() * layer.weight[0].numel()

    copy = deepcopy(model).eval()
    for module in copy.modules():
        if isinstance(module, nn.Conv2d | nn.Linear):
            module.register_forward_hook(count)
    with torch.no_grad():
        copy(*inputs)
    return counted
