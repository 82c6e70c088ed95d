"""Simple pyramid pooling: averages over large parts of the map, brought to each cell of the coarsest features."""

from collections.abc import Sequence

from torch import Tensor, nn
from torch.nn import functional as F

from nnpp_edge.model.blocks import ConvBNReLU
from nnpp_edge.runtime.errors import ModelError

SCALES = (1, 2, 4)


class SPPM(nn.Module):
    """Averages over 1×1, 2×2 and 4×4 parts of the map, projected, brought back to full size and summed.

    (N, in_channels, size, size) to (N, out_channels, size, size).

    `size` is a multiple of each of the `scales`; there is a branch for each.

    Notes
    -----
    NNPP (arXiv 2308.04792v3, section Network Structure): the pyramid pooling of PSPNet with three scales in
    place of four, and no concatenation with the input: the input reaches the output through the averages
    alone. The sum and the 3×3 convolution after it are PP-LiteSeg's (arXiv 2204.02681, section 3.3).

    We depart in two places. The pooling kernels are fixed from `size`, where both papers pool adaptively:
    that gives the same figures, and exports to ONNX. The averages are repeated to full size (nearest),
    where PP-LiteSeg interpolates: the 3×3 convolution smooths the seams, and nearest leaves int8 values as
    they are.

    While training, the 1×1 branch has one value per map to normalise over: it needs a batch of two or more.
    """

    def __init__(self, in_channels: int, out_channels: int, size: int, scales: Sequence[int] = SCALES) -> None:
        super().__init__()
        if any(size % scale for scale in scales):
            raise ModelError(f"size must be a multiple of each of {tuple(scales)}, got {size}")
        self.factors = tuple(size // scale for scale in scales)
        self.pools = nn.ModuleList(nn.AvgPool2d(factor) for factor in self.factors)
        self.branches = nn.ModuleList(ConvBNReLU(in_channels, out_channels, 1) for _ in scales)
        self.out = ConvBNReLU(out_channels, out_channels, 3)

    def forward(self, x: Tensor) -> Tensor:
        whole, *parts = (
            F.interpolate(branch(pool(x)), scale_factor=float(factor), mode="nearest")
            for pool, branch, factor in zip(self.pools, self.branches, self.factors, strict=True)
        )
        for part in parts:
            whole = whole + part
        pooled: Tensor = self.out(whole)
        return pooled
