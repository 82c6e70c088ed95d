"""The passage network: with what chance a vehicle passes the blocks of a map of heights, and what that costs.

A few convolutions over blocks of 4 × 4 cells, so it takes maps of any size. What a vehicle is decides the
convolutions' weights: each is a mixture of a few kernels, by shares that a small network works out from the vehicle's
numbers. Once those are known it is a plain convolutional network (`PassageNet.of_vehicle`), and as fast as one.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.kernels.blocks import CHANNELS
from nnpp_edge.runtime.network.passage import NUMBERS
from nnpp_edge.runtime.terrain.vehicle import HEADINGS

ANSWERS = 4 * len(HEADINGS)
"""Of a block, each by heading: logits of the chance that a pose passes, of the mean T of those that do, of the chance
that a way leads to the next block, and of half the T of that way."""


class PassageNet(nn.Module):
    """Convolutions of blocks whose weights depend on the vehicle.

    Parameters
    ----------
    widths : ints
        Channels after each convolution.
    kernels : ints
        Sides of each convolution's kernel, in blocks; odd.
    mixtures : int
        Kernels that each convolution is mixed of.
    described : int
        Units of the two layers that look at the vehicle's numbers.
    """

    def __init__(
        self,
        widths: Sequence[int] = (40, 40, 40),
        kernels: Sequence[int] = (3, 3, 3),
        mixtures: int = 4,
        described: int = 64,
    ) -> None:
        super().__init__()
        if len(widths) != len(kernels) or not widths or min(*widths, mixtures, described) < 1:
            raise ModelError(f"widths and kernels must be as many positive numbers, got {widths} and {kernels}")
        if any(side < 1 or side % 2 == 0 for side in kernels):
            raise ModelError(f"kernels must be odd, got {kernels}")
        self.describe = nn.Sequential(
            nn.Linear(len(NUMBERS), described), nn.SiLU(), nn.Linear(described, described), nn.SiLU()
        )
        layers = zip((CHANNELS, *widths[:-1]), widths, kernels, strict=True)
        self.convolutions = nn.ModuleList(VehicleConv(*layer, mixtures, described) for layer in layers)
        self.head = VehicleConv(widths[-1], ANSWERS, 1, mixtures, described)

    def forward(self, blocks: Tensor, numbers: Tensor) -> Tensor:
        """Logits.

        Parameters
        ----------
        blocks : (V, N, 19, R, C) float
            What is shown of N maps of each of V vehicles, in [-1, 1].
        numbers : (V, 12) float
            The vehicles.

        Returns
        -------
        (V, N, 16, R, C) float
        """
        described = self.describe(numbers)
        folded = [layer.weights(described) for layer in (*self.convolutions, self.head)]
        answers = []
        for v, each in enumerate(blocks):
            x = each.contiguous(memory_format=torch.channels_last)
            for weight, bias in folded[:-1]:
                x = functional.relu(functional.conv2d(x, weight[v], bias[v], padding=weight.shape[-1] // 2))
            answers.append(functional.conv2d(x, folded[-1][0][v], folded[-1][1][v]))
        return torch.stack(answers)

    def of_vehicle(self, numbers: Tensor) -> nn.Sequential:
        """The plain network of one vehicle, (12,): (N, 19, R, C) to (N, 16, R, C)."""
        described = self.describe(numbers[None])
        layers: list[nn.Module] = []
        for layer in (*self.convolutions, self.head):
            weight, bias = layer.weights(described)
            plain = nn.Conv2d(weight.shape[2], weight.shape[1], weight.shape[3], padding=weight.shape[3] // 2)
            plain.load_state_dict({"weight": weight[0].detach(), "bias": bias[0].detach()})
            layers += [plain, nn.ReLU()]
        return nn.Sequential(*layers[:-1])


class VehicleConv(nn.Module):
    """Weights and biases of a convolution, by what is described of a vehicle."""

    def __init__(self, inputs: int, outputs: int, side: int, mixtures: int, described: int) -> None:
        super().__init__()
        self.kernels = nn.Parameter(torch.empty(mixtures, outputs, inputs, side, side))
        self.shares = nn.Linear(described, mixtures)
        self.gain, self.bias = nn.Linear(described, outputs), nn.Linear(described, outputs)
        for kernel in self.kernels:
            nn.init.kaiming_normal_(kernel, nonlinearity="relu")
        nn.init.normal_(self.shares.weight, std=0.1)
        nn.init.constant_(self.shares.bias, mixtures**-0.5)
        for layer in (self.gain, self.bias):
            nn.init.normal_(layer.weight, std=0.01)
            nn.init.zeros_(layer.bias)

    def weights(self, described: Tensor) -> tuple[Tensor, Tensor]:
        """(V, D) to (V, outputs, inputs, side, side) and (V, outputs)."""
        mixed = torch.einsum("vk,koihw->voihw", self.shares(described), self.kernels)
        return mixed * (1.0 + self.gain(described))[:, :, None, None, None], self.bias(described)
