"""The paper's network: a cost map, a start and a goal in; where the optimal path may pass, out."""

from collections.abc import Sequence

from torch import Tensor, nn

from nnpp_edge.model.sppm import SCALES, SPPM
from nnpp_edge.model.stdc import STDC
from nnpp_edge.model.uafm import UAFM
from nnpp_edge.runtime.errors import ModelError

INPUT_CHANNELS = 3
SIZE_STEP = 32 * max(SCALES)
PRIOR_LOGIT = -2.0


class NNPP(nn.Module):
    """STDC encoder, simple pyramid pooling, a decoder of two attention fusions, a classifier of one channel.

    Parameters
    ----------
    input_size : int
        Side S of the input; a multiple of 128 (1/32 of it is pooled to 4×4).
    width : int
        Channels after the encoder's second stage; even. 64 is the paper's full width.
    depth : three ints
        STDC modules in stages 3, 4 and 5: (2, 2, 2) is STDC1, (4, 5, 3) is STDC2.
    decoder_channels : three ints, optional
        Channels of the decoder at 1/32, 1/16 and 1/8 resolution. By default width × (2, 1, 1/2), which at
        full width is PP-LiteSeg-T's 128, 64, 32.

    Raises
    ------
    ModelError
        A size, width, depth or decoder that the network cannot be built with.

    Notes
    -----
    NNPP (arXiv 2308.04792v3, section Network Structure), built from STDC (arXiv 2104.13188) and PP-LiteSeg
    (arXiv 2204.02681). The paper gives no channel counts; the decoder's are PP-LiteSeg's.

    We depart in the resolution of the output: the output is at 1/8, where the decoder ends, and
    nothing enlarges it. A region is wider than a cell, and whoever reads it looks up its cell in the
    small map. Pooling and enlarging are of fixed size: see `SPPM` and `UAFM`.
    """

    def __init__(
        self,
        input_size: int = 256,
        width: int = 64,
        depth: Sequence[int] = (2, 2, 2),
        decoder_channels: Sequence[int] | None = None,
    ) -> None:
        super().__init__()
        if input_size < SIZE_STEP or input_size % SIZE_STEP:
            raise ModelError(f"input_size must be a positive multiple of {SIZE_STEP}, got {input_size}")
        self.backbone = STDC(width, depth, INPUT_CHANNELS)
        if decoder_channels is None:
            decoder_channels = (2 * width, width, width // 2)
        if len(decoder_channels) != 3 or min(decoder_channels) < 1:
            raise ModelError(f"decoder_channels must be three positive numbers, got {decoder_channels}")
        at32, at16, at8 = decoder_channels
        self.input_size = input_size
        stage3, stage4, stage5 = self.backbone.out_channels
        self.context = SPPM(stage5, at32, input_size // 32)
        self.fuse4 = UAFM(at32, stage4, at16)
        self.fuse3 = UAFM(at16, stage3, at8)
        self.classifier = nn.Conv2d(at8, 1, 3, padding=1)
        _initialise(self)

    def forward(self, x: Tensor) -> Tensor:
        """Logits of the probability that the optimal path passes.

        Parameters
        ----------
        x : (N, 3, S, S) float32
            cost, start_map and goal_map, each in [0, 1].

        Returns
        -------
        (N, 1, S/8, S/8) float32
            Logits. The sigmoid belongs to the loss while training and to the exported graph afterwards.
        """
        if x.shape[1:] != (INPUT_CHANNELS, self.input_size, self.input_size):
            wanted = f"(N, {INPUT_CHANNELS}, {self.input_size}, {self.input_size})"
            raise ModelError(f"input must be {wanted}, got {tuple(x.shape)}")
        stage3, stage4, stage5 = self.backbone(x)
        features = self.fuse4(self.context(stage5), stage4)
        logits: Tensor = self.classifier(self.fuse3(features, stage3))
        return logits


def _initialise(network: NNPP) -> None:
    """Kaiming for the convolutions; a classifier that starts at a low probability everywhere.

    A path covers few cells: starting near their share (sigmoid(-2) = 0.12) keeps the many empty cells from
    ruling the first steps.
    """
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, mode="fan_in", nonlinearity="relu")
    nn.init.normal_(network.classifier.weight, std=0.01)
    assert network.classifier.bias is not None
    nn.init.constant_(network.classifier.bias, PRIOR_LOGIT)
