"""The paper's network: a cost map, a start and a goal in; where the optimal path may pass, out.

NNPP (arXiv 2308.04792v3, section Network Structure), built from STDC (arXiv 2104.13188, "Rethinking
BiSeNet for real-time semantic segmentation") and PP-LiteSeg (arXiv 2204.02681). The paper gives no
channel counts; the decoder's are PP-LiteSeg-T's at full width.
"""

from functools import reduce
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

INPUT_CHANNELS = 3
SCALES = (1, 2, 4)
PRIOR_LOGIT = -2.0
"""Of an untrained network: a path covers few cells, and the many empty ones should not dominate the
first steps.
"""


class Conv2d(nn.Conv2d):
    """A convolution that is computed in float32 on a CPU where it is strided and depthwise.

    oneDNN has no fast gradient of such a one in bfloat16: three took half of a training step of the
    paper's network.
    """

    def forward(self, input: Tensor) -> Tensor:
        slow = self.groups > 1 and self.stride != (1, 1)
        if not (slow and torch.is_autocast_enabled("cpu")):
            return super().forward(input)
        with torch.autocast("cpu", enabled=False):
            return super().forward(input.float())


class Average(nn.AvgPool2d):
    """Means over 3 × 3 places, two apart, 0 beyond the edge; exported as a convolution, which is
    faster in int8.
    """

    def __init__(self) -> None:
        super().__init__(3, stride=2, padding=1)

    def forward(self, input: Tensor) -> Tensor:
        if not torch.compiler.is_exporting():
            return super().forward(input)
        channels = input.shape[1]
        kernel = torch.full((channels, 1, 3, 3), 1 / 9)
        return functional.conv2d(input, kernel, stride=2, padding=1, groups=channels)


class ConvBNReLU(nn.Sequential):
    """Convolution without bias, batch normalisation, ReLU (or not); padded so that stride 1 keeps
    the size.

    The normalisation carries the bias and folds into the convolution on export: one node of an int8
    graph.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        kernel: int = 3,
        stride: int = 1,
        *,
        groups: int = 1,
        relu: bool = True,
    ) -> None:
        super().__init__(
            Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False),
            nn.BatchNorm2d(outputs),
        )
        if relu:
            self.append(nn.ReLU(inplace=True))


class NNPP(nn.Module):
    """STDC1 encoder, simple pyramid pooling, a decoder of two attention fusions, a classifier of
    one channel.

    `input_size`, S, is a multiple of 128 (1/32 of it is pooled to 4×4); `width`, even, are the
    channels after the encoder's second stage, 64 in the paper. The output is at 1/8, where the
    decoder ends, and nothing enlarges it. Averages and features are repeated (nearest) where
    PP-LiteSeg interpolates, so that int8 values stay as they are.
    """

    def __init__(self, input_size: int = 256, width: int = 64) -> None:
        super().__init__()
        self.backbone = STDC(width)
        self.context = SPPM(16 * width, 2 * width, input_size // 32)
        self.fuse4 = UAFM(2 * width, 8 * width, width)
        self.fuse3 = UAFM(width, 4 * width, width // 2)
        self.classifier = nn.Conv2d(width // 2, 1, 3, padding=1)
        initialise(self, self.classifier)

    def forward(self, x: Tensor) -> Tensor:
        """Logits (N, 1, S/8, S/8) for (N, 3, S, S): cost, start_map and goal_map, each in
        [0, 1].
        """
        stage3, stage4, stage5 = self.backbone(x)
        fused4 = self.fuse4(self.context(stage5), stage4)
        logits: Tensor = self.classifier(self.fuse3(fused4, stage3))
        return logits


def initialise(network: nn.Module, answer: nn.Conv2d | nn.Linear) -> None:
    """First weights by Kaiming, and of the layer that answers such that it begins with
    `PRIOR_LOGIT`.
    """
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.Linear):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
    nn.init.normal_(answer.weight, std=0.01)
    assert answer.bias is not None
    nn.init.constant_(answer.bias, PRIOR_LOGIT)


class STDC(nn.Module):
    """Five stages, each at half the resolution (STDC, Table 2), of width × (1/2, 1, 4, 8, 16)
    channels.

    (N, 3, H, W) to the features of stages 3, 4 and 5, at 1/8, 1/16 and 1/32 of H and W.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.stage1 = ConvBNReLU(INPUT_CHANNELS, width // 2, 3, stride=2)
        self.stage2 = ConvBNReLU(width // 2, width, 3, stride=2)
        self.stage3 = _stage(width, 4 * width)
        self.stage4 = _stage(4 * width, 8 * width)
        self.stage5 = _stage(8 * width, 16 * width)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        stage3 = self.stage3(self.stage2(self.stage1(x)))
        stage4 = self.stage4(stage3)
        return stage3, stage4, self.stage5(stage4)


def _stage(inputs: int, outputs: int) -> nn.Sequential:
    """A module that halves the resolution, and one that keeps it."""
    return nn.Sequential(STDCModule(inputs, outputs, stride=2), STDCModule(outputs, outputs))


class STDCModule(nn.Module):
    """Four convolutions in a row, 1/2, 1/4, 1/8 and 1/8 of `outputs` wide, concatenated (STDC, Fig.
    3 b and c).
    """

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        widths = [outputs // part for part in (2, 4, 8, 8)]
        half = widths[0]
        self.first = ConvBNReLU(inputs, half, 1)
        self.shortcut: nn.Module = nn.Identity()
        self.down: nn.Module = nn.Identity()
        if stride == 2:
            self.shortcut = Average()
            self.down = ConvBNReLU(half, half, 3, stride=2, groups=half, relu=False)
        self.rest = nn.ModuleList(ConvBNReLU(*pair) for pair in pairwise(widths))

    def forward(self, x: Tensor) -> Tensor:
        first = self.first(x)
        outputs = [self.shortcut(first)]
        x = self.down(first)
        for convolution in self.rest:
            x = convolution(x)
            outputs.append(x)
        return torch.cat(outputs, dim=1)


class SPPM(nn.Module):
    """Simple pyramid pooling: averages over 1×1, 2×2 and 4×4 parts of the map, projected, repeated
    and summed.

    (N, inputs, size, size) to (N, outputs, size, size), as in PP-LiteSeg (section 3.3), but with
    fixed kernels, which export to ONNX. While training, the 1×1 branch needs a batch of two or more
    to normalise over.
    """

    def __init__(self, inputs: int, outputs: int, size: int) -> None:
        super().__init__()
        self.pools = nn.ModuleList(nn.AvgPool2d(size // scale) for scale in SCALES)
        self.branches = nn.ModuleList(ConvBNReLU(inputs, outputs, 1) for _ in SCALES)
        self.out = ConvBNReLU(outputs, outputs, 3)

    def forward(self, x: Tensor) -> Tensor:
        parts = []
        for pool, branch in zip(self.pools, self.branches, strict=True):
            part = branch(pool(x))
            scale = x.shape[-1] // part.shape[-1]
            parts.append(functional.interpolate(part, scale_factor=float(scale), mode="nearest"))
        pooled: Tensor = self.out(reduce(torch.add, parts))
        return pooled


class UAFM(nn.Module):
    """Unified attention fusion (PP-LiteSeg, section 3.2): coarse features at twice their side,
    fused with the encoder's.

    high (N, high, H, W) and low (N, low, 2H, 2W) to (N, outputs, 2H, 2W).
    """

    def __init__(self, high: int, low: int, outputs: int) -> None:
        super().__init__()
        self.reduce = ConvBNReLU(low, high, 3)
        self.attention = SpatialAttention()
        self.out = ConvBNReLU(high, outputs, 3)

    def forward(self, high: Tensor, low: Tensor) -> Tensor:
        up = doubled(high)
        low = self.reduce(low)
        alpha = self.attention(up, low)
        fused: Tensor = self.out(low + alpha * (up - low))
        return fused


class SpatialAttention(nn.Module):
    """Weight (N, 1, H, W) in [0, 1] of the coarse features, from the mean and maximum over channels
    of both.
    """

    def __init__(self) -> None:
        super().__init__()
        self.hidden = ConvBNReLU(4, 2, 3)
        self.weight = ConvBNReLU(2, 1, 3, relu=False)

    def forward(self, up: Tensor, low: Tensor) -> Tensor:
        statistics = []
        for features in (up, low):
            statistics.append(features.mean(dim=1, keepdim=True))
            statistics.append(features.amax(dim=1, keepdim=True))
        return torch.sigmoid(self.weight(self.hidden(torch.cat(statistics, dim=1))))


def doubled(x: Tensor) -> Tensor:
    """At twice the side, every value repeated."""
    return functional.interpolate(x, scale_factor=2.0, mode="nearest")
