"""STDC backbone: short-term dense concatenation, the encoder of the paper's network.

STDC (arXiv 2104.13188, "Rethinking BiSeNet for real-time semantic segmentation"); NNPP (arXiv 2308.04792v3,
section Network Structure) takes it as its backbone.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from nnpp_edge.model.blocks import ConvBNReLU
from nnpp_edge.runtime.errors import ModelError

CONVS_PER_MODULE = 4


class STDCModule(nn.Module):
    """Four convolutions in a row whose outputs, each half as wide as the one before, are concatenated.

    (N, in_channels, H, W) to (N, out_channels, H / stride, W / stride), stride 1 or 2. The widths are 1/2,
    1/4, 1/8 and 1/8 of `out_channels`. The first convolution is 1×1 and stays at full resolution; at stride 2
    a depthwise 3×3 takes it down for the second one, and an average over 3×3 for the concatenation.

    STDC, arXiv 2104.13188, Fig. 3 (b) and (c).
    """

    def __init__(self, in_channels: int, out_channels: int, stride: int = 1) -> None:
        super().__init__()
        widths = halved_widths(out_channels)
        self.first = ConvBNReLU(in_channels, widths[0], 1)
        self.shortcut: nn.Module = nn.Identity()
        self.down: nn.Module = nn.Identity()
        if stride == 2:
            self.shortcut = nn.AvgPool2d(3, stride=2, padding=1)
            self.down = ConvBNReLU(widths[0], widths[0], 3, stride=2, groups=widths[0], relu=False)
        self.rest = nn.ModuleList(ConvBNReLU(wider, narrower, 3) for wider, narrower in pairwise(widths))

    def forward(self, x: Tensor) -> Tensor:
        first = self.first(x)
        outputs = [self.shortcut(first)]
        x = self.down(first)
        for conv in self.rest:
            x = conv(x)
            outputs.append(x)
        return torch.cat(outputs, dim=1)


class STDC(nn.Module):
    """The five stages; each halves the resolution.

    Parameters
    ----------
    width : int
        Channels after stage 2; even. Stages 1 to 5 give width × (1/2, 1, 4, 8, 16). 64 is full width.
    depth : three ints
        STDC modules in stages 3, 4 and 5; the first of each has stride 2. (2, 2, 2) is STDC1,
        (4, 5, 3) is STDC2.

    Notes
    -----
    STDC, arXiv 2104.13188, Table 2, without the classifier that follows stage 5 there.
    """

    def __init__(self, width: int = 64, depth: Sequence[int] = (2, 2, 2), in_channels: int = 3) -> None:
        super().__init__()
        if width < 2 or width % 2:
            raise ModelError(f"width must be a positive even number, got {width}")
        if len(depth) != 3 or min(depth) < 1:
            raise ModelError(f"depth must be three positive numbers, got {tuple(depth)}")
        self.out_channels = (4 * width, 8 * width, 16 * width)
        self.stage1 = ConvBNReLU(in_channels, width // 2, 3, stride=2)
        self.stage2 = ConvBNReLU(width // 2, width, 3, stride=2)
        self.stage3 = _stage(width, self.out_channels[0], depth[0])
        self.stage4 = _stage(self.out_channels[0], self.out_channels[1], depth[1])
        self.stage5 = _stage(self.out_channels[1], self.out_channels[2], depth[2])

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features of stages 3, 4 and 5 for (N, in_channels, H, W): at 1/8, 1/16 and 1/32 of H and W."""
        stage3 = self.stage3(self.stage2(self.stage1(x)))
        stage4 = self.stage4(stage3)
        return stage3, stage4, self.stage5(stage4)


def halved_widths(out_channels: int) -> list[int]:
    """Widths of a module's convolutions: 1/2, 1/4, 1/8, …, the last one twice; they sum to `out_channels`."""
    if out_channels % 2 ** (CONVS_PER_MODULE - 1):
        raise ModelError(f"out_channels must be a multiple of 8, got {out_channels}")
    widths = [out_channels >> (i + 1) for i in range(CONVS_PER_MODULE - 1)]
    return [*widths, widths[-1]]


def _stage(in_channels: int, out_channels: int, modules: int) -> nn.Sequential:
    """One module of stride 2, the others of stride 1."""
    rest = (STDCModule(out_channels, out_channels) for _ in range(modules - 1))
    return nn.Sequential(STDCModule(in_channels, out_channels, stride=2), *rest)
