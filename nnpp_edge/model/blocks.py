"""What every architecture is built of."""

from torch import nn


class ConvBNReLU(nn.Sequential):
    """Convolution without bias, batch normalisation, ReLU; padded so that stride 1 keeps the size.

    The normalisation carries the bias and folds into the convolution on export, so the three are one node
    of an int8 graph. `relu=False` leaves the last step out.
    """

    def __init__(
        self, inputs: int, outputs: int, kernel: int = 3, stride: int = 1, *, groups: int = 1, relu: bool = True
    ) -> None:
        layers: list[nn.Module] = [
            nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False),
            nn.BatchNorm2d(outputs),
        ]
        super().__init__(*layers, *([nn.ReLU(inplace=True)] if relu else []))
