"""The network that prices unseen ground: fully convolutional, from blocks of a coarse map to the
same blocks.
"""

from torch import Tensor, nn

from nnpp_edge.model.edge import Up
from nnpp_edge.model.nnpp import ConvBNReLU, initialise
from nnpp_edge.runtime.network.model_file import UNSEEN
from nnpp_edge.runtime.network.unseen import ANSWERS


class UnseenNet(nn.Module):
    """Down to a quarter of the resolution and up again; `widths` are the channels at full, half and
    quarter.
    """

    def __init__(self, widths: tuple[int, int, int] = (32, 48, 48)) -> None:
        super().__init__()
        full, half, quarter = widths
        self.stem = nn.Sequential(ConvBNReLU(len(UNSEEN), full), ConvBNReLU(full, full))
        self.down = nn.Sequential(ConvBNReLU(full, half, stride=2), ConvBNReLU(half, half))
        self.deep = nn.Sequential(ConvBNReLU(half, quarter, stride=2), ConvBNReLU(quarter, quarter))
        self.up_half = Up(quarter, half)
        self.up_full = Up(half, full)
        self.answer = nn.Conv2d(full, ANSWERS, 1)
        initialise(self, self.answer)

    def forward(self, planes: Tensor) -> Tensor:
        """Logits (N, 3, H, W) of the answers for planes (N, 12, H, W) from `encode_unseen`."""
        full = self.stem(planes)
        half = self.down(full)
        half_again = self.up_half(self.deep(half), half)
        logits: Tensor = self.answer(self.up_full(half_again, full))
        return logits
