"""The edge network: few, large int8-friendly nodes, and the query joined in where the map is small."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.encoding import PAIR_CHANNELS

MAP_CHANNELS = 2
UNSHUFFLE = 4
QUERY_STRIDE = 8
OUTPUT_STRIDE = 4
SIZE_STEP = 64
PRIOR_LOGIT = -2.0


class ConvBlock(nn.Sequential):
    """Convolution, batch norm, ReLU; the norm folds into the convolution at export."""

    def __init__(self, inputs: int, outputs: int, kernel_size: int = 3, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, kernel_size, stride, kernel_size // 2, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


class Residual(nn.Module):
    """Two convolutions beside a short cut: (N, C, H, W) to the same."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = ConvBlock(channels, channels)
        self.second = nn.Sequential(nn.Conv2d(channels, channels, 3, padding=1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        """Apply the block."""
        return functional.relu(x + self.second(self.first(x)))


class Up(nn.Module):
    """Double the side of `deep` and add it to `shallow`, then convolve."""

    def __init__(self, deep: int, shallow: int, residual: bool) -> None:
        super().__init__()
        self.match = ConvBlock(deep, shallow, 1)
        self.merge = Residual(shallow) if residual else ConvBlock(shallow, shallow)

    def forward(self, deep: Tensor, shallow: Tensor) -> Tensor:
        """(N, D, H, W) and (N, C, 2H, 2W) to (N, C, 2H, 2W)."""
        return self.merge(shallow + functional.interpolate(self.match(deep), scale_factor=2, mode="nearest"))


def _down(inputs: int, outputs: int, residuals: int) -> nn.Sequential:
    """Half the side, then so many residual blocks."""
    return nn.Sequential(ConvBlock(inputs, outputs, stride=2), *(Residual(outputs) for _ in range(residuals)))


class Pyramid(nn.Module):
    """Down from 1/8 resolution to 1/64, and up again.

    Parameters
    ----------
    widths : four ints
        Channels at 1/8, 1/16, 1/32 and 1/64 resolution.
    depth : four ints
        Residual blocks after each of the three reductions, and on the way up at 1/16 (0 or 1; 0 leaves one
        convolution there).
    """

    def __init__(self, widths: tuple[int, ...], depth: tuple[int, ...]) -> None:
        super().__init__()
        if len(widths) != 4 or min(widths) < 1:
            raise ModelError(f"widths must be four positive numbers of channels, got {widths}")
        if len(depth) != 4 or min(depth) < 0 or depth[3] > 1:
            raise ModelError(f"depth must be four numbers of at least 0, the last 0 or 1, got {depth}")
        w8, w16, w32, w64 = widths
        d16, d32, d64, up16 = depth
        self.down16 = _down(w8, w16, d16)
        self.down32 = _down(w16, w32, d32)
        self.down64 = _down(w32, w64, d64)
        self.up32 = Up(w64, w32, residual=False)
        self.up16 = Up(w32, w16, residual=bool(up16))
        self.up8 = Up(w16, w8, residual=False)

    def forward(self, at8: Tensor) -> Tensor:
        """(N, W, S/8, S/8) to the same."""
        at16 = self.down16(at8)
        at32 = self.down32(at16)
        at32 = self.up32(self.down64(at32), at32)
        return self.up8(self.up16(at32, at16), at8)


def check_input(size: int) -> None:
    """ModelError where the pyramid does not divide a map of this side."""
    if size < SIZE_STEP or size % SIZE_STEP:
        raise ModelError(f"input_size must be a positive multiple of {SIZE_STEP}, got {size}")


class EdgeNet(nn.Module):
    """A convolutional pyramid with the query joined in at 1/8 resolution.

    Parameters
    ----------
    input_size : int
        Side S of the map; a multiple of 64.
    widths, depth
        Of the `Pyramid`.
    stem : int
        Channels of the map's own features at 1/8.

    Notes
    -----
    Where it departs from the paper's network, and why: the map comes as 4 × 4 cells to a pixel, so that the
    first convolution is one large node; start and goal enter at 1/8, being smooth; the share of impassable
    cells is a second plane, as averages alone hide walls and passes on large maps; the answer is given at
    1/4 by four channels at 1/8, which costs nothing.
    """

    def __init__(
        self, input_size: int = 256, widths: tuple[int, ...] = (48, 64, 96, 96), stem: int = 32,
        depth: tuple[int, ...] = (1, 2, 1, 1),
    ) -> None:  # fmt: skip
        super().__init__()
        check_input(input_size)
        if stem < 1:
            raise ModelError(f"stem must be a positive number of channels, got {stem}")
        self.pyramid = Pyramid(widths, depth)
        self.stem = ConvBlock(MAP_CHANNELS * UNSHUFFLE**2, stem, stride=2)
        self.join = ConvBlock(stem + PAIR_CHANNELS, widths[0])
        self.head = nn.Conv2d(widths[0], (QUERY_STRIDE // OUTPUT_STRIDE) ** 2, 1)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
        nn.init.normal_(self.head.weight, std=0.01)
        nn.init.constant_(self.head.bias, PRIOR_LOGIT)  # type: ignore[arg-type]

    def forward(self, planes: Tensor, query: Tensor) -> Tensor:
        """Logits of the probability that a nearly optimal path passes.

        Parameters
        ----------
        planes : (N, 32, S/4, S/4) float
            The map's two planes, in [0, 1], 4 × 4 cells to a pixel (`torch.pixel_unshuffle`).
        query : (N, 3, S/8, S/8) float
            Start and goal (`runtime.encoding.encode_pair`), in [0, 1].

        Returns
        -------
        (N, 4, S/8, S/8) float
            Four blocks of a quarter's resolution to a pixel (`torch.pixel_shuffle` puts them in place).
        """
        return self.head(self.pyramid(self.join(torch.cat((self.stem(planes), query), 1))))
