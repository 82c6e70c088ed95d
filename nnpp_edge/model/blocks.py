"""What every architecture is built of."""

import torch
from torch import Tensor, nn


class Conv2d(nn.Conv2d):
    """torch's, which computes one that is strided and depthwise in float32 on a CPU.

    oneDNN has no quick gradient of it in bfloat16: three took half of a training step of the paper's network.
    """

    def forward(self, input: Tensor) -> Tensor:
        if self.groups == 1 or self.stride == (1, 1) or not torch.is_autocast_enabled("cpu"):
            return super().forward(input)
        with torch.autocast("cpu", enabled=False):
            return super().forward(input.float())


class ConvBNReLU(nn.Sequential):
    """Convolution without bias, batch normalisation, ReLU; padded so that stride 1 keeps the size.

    The normalisation carries the bias and folds into the convolution on export, so the three are one node
    of an int8 graph. `relu=False` leaves the last step out.
    """

    def __init__(
        self, inputs: int, outputs: int, kernel: int = 3, stride: int = 1, *, groups: int = 1, relu: bool = True
    ) -> None:
        layers: list[nn.Module] = [
            Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False),
            nn.BatchNorm2d(outputs),
        ]
        super().__init__(*layers, *([nn.ReLU(inplace=True)] if relu else []))
