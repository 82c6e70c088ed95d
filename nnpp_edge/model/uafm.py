"""Unified attention fusion: coarse features and fine ones, weighed against each other cell by cell."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from nnpp_edge.model.blocks import ConvBNReLU


class UAFM(nn.Module):
    """One step of the decoder: coarse features come up by two and are fused with the encoder's.

    high (N, high_channels, H, W) and low (N, low_channels, 2H, 2W) to (N, out_channels, 2H, 2W).

    Notes
    -----
    NNPP (arXiv 2308.04792v3, section Network Structure) takes this module from PP-LiteSeg (arXiv 2204.02681,
    section 3.2), with its spatial attention. `low` is first brought to `high_channels`. We double the
    resolution by repetition (nearest) where PP-LiteSeg interpolates: two 3×3 convolutions read the result,
    and nearest leaves int8 values as they are.
    """

    def __init__(self, high_channels: int, low_channels: int, out_channels: int) -> None:
        super().__init__()
        self.reduce = ConvBNReLU(low_channels, high_channels, 3)
        self.attention = SpatialAttention()
        self.out = ConvBNReLU(high_channels, out_channels, 3)

    def forward(self, high: Tensor, low: Tensor) -> Tensor:
        up = F.interpolate(high, scale_factor=2.0, mode="nearest")
        low = self.reduce(low)
        fused: Tensor = self.out(fuse(up, low, self.attention(up, low)))
        return fused


class SpatialAttention(nn.Module):
    """Weight of the coarse features at each cell, from the mean and the maximum over channels of both.

    up and low, (N, C, H, W) each, to alpha (N, 1, H, W) in [0, 1].
    """

    def __init__(self) -> None:
        super().__init__()
        self.hidden = ConvBNReLU(4, 2, 3)
        self.weight = ConvBNReLU(2, 1, 3, relu=False)

    def forward(self, up: Tensor, low: Tensor) -> Tensor:
        statistics = [f(x) for x in (up, low) for f in (_channel_mean, _channel_max)]
        return torch.sigmoid(self.weight(self.hidden(torch.cat(statistics, dim=1))))


def fuse(up: Tensor, low: Tensor, alpha: Tensor) -> Tensor:
    """alpha · up + (1 - alpha) · low, written with one product instead of two."""
    return low + alpha * (up - low)


def _channel_mean(x: Tensor) -> Tensor:
    """Mean over channels, (N, 1, H, W)."""
    return x.mean(dim=1, keepdim=True)


def _channel_max(x: Tensor) -> Tensor:
    """Maximum over channels, (N, 1, H, W)."""
    return x.amax(dim=1, keepdim=True)
