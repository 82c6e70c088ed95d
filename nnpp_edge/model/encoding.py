"""The inputs of `runtime.network.encoding` and `runtime.network.unseen`, of a whole batch at once,
on any device.

The numbers are the runtime's within float32 rounding, and a test holds them to it: a network runs
on what it was trained on.
"""

import torch
from torch import Tensor
from torch.nn import functional

from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.network.model_file import QUERY_SPACING
from nnpp_edge.runtime.tuning import SlopePrice

_NUMBERS = SlopePrice()


def encode_queries(spec: Spec, ends: Tensor) -> Tensor:
    """Starts and goals (N, 2, 2), rows and columns in network cells, as they are shown to a
    network: (N, C, E, E) float32.
    """
    sigma = spec.sigma * spec.input_size
    if spec.encoding == "ends":
        return _encode_ends(ends, spec.input_size, sigma)
    cells = torch.arange(spec.input_size, device=ends.device)
    away = (cells - ends[..., None]) / sigma
    rows, cols = torch.exp(-0.5 * away**2).unbind(2)
    return rows[..., None] * cols[..., None, :]


def _encode_ends(ends: Tensor, side: int, sigma: float) -> Tensor:
    """As `encode_ends`: six planes for each end, three for both."""
    size = side // QUERY_SPACING
    number = torch.arange(size, device=ends.device)
    offset = (QUERY_SPACING - 1.0) / 2.0
    # the points' own rows and columns, and the share that each has in an end: (N, 2, 2, size)
    way = ends[..., None] - (number * QUERY_SPACING + offset)
    place = ((ends - offset) / QUERY_SPACING).clamp(0.0, size - 1.0)
    over_rows, over_cols = (1.0 - (number - place[..., None]).abs()).clamp_min(0.0).unbind(2)
    down, right = way.unbind(2)
    square = down[..., None] ** 2 + right[..., None, :] ** 2
    distance = square.sqrt()
    of_each = (
        over_rows[..., None] * over_cols[..., None, :],
        (down / side)[..., None].expand_as(square),
        (right / side)[..., None, :].expand_as(square),
        distance / side,
        torch.exp(-0.5 / sigma**2 * square),
        torch.exp(-8.0 / sigma**2 * square),
    )
    # how much of a detour each point is from the straight way between the two
    between = ends[:, 0] - ends[:, 1]
    apart = between.norm(dim=-1).clamp_min(QUERY_SPACING)[:, None, None]
    detour = (distance.sum(1) - apart).clamp_min(0.0)
    of_both = (
        torch.exp(-detour / (0.25 * apart)),
        detour / side,
        (apart / side).expand_as(detour),
    )
    return torch.cat((torch.stack(of_each, 2).flatten(1, 2), torch.stack(of_both, 1)), 1)


def encode_unseen_maps(heights: Tensor, facts: Tensor) -> Tensor:
    """As `encode_unseen`: for mean heights (N, B, B) of square blocks, NaN where unknown, (N, 12,
    B, B) float32.

    `facts` (N, 4) are each map's cells to a block's side, side of a cell in metres, limit of the
    slope and hard limit in degrees.
    """
    factor, cell_m, limit_deg, hard_deg = facts[..., None, None].unbind(1)
    limit = torch.deg2rad(limit_deg)
    tangent = torch.tan(limit)
    known = (heights == heights).float()  # NaN is no number's equal
    height = torch.nan_to_num(heights / (factor * cell_m * tangent))
    cells = known.sum((1, 2), keepdim=True).clamp_min(1)
    mean = (height * known).sum((1, 2), keepdim=True) / cells
    height = (height - mean) * known
    layers = torch.stack((height, known), 1)
    near, wide, far = (_mean(layers, blocks) for blocks in (3, 7, 15))
    filled = height + near * (1.0 - known)
    edged = functional.pad(filled, (1, 1, 1, 1), "replicate")
    there = functional.pad(known, (1, 1, 1, 1))
    down, step_down = _rises(edged, there)
    across, step_across = (each.mT for each in _rises(edged.mT, there.mT))
    slope = torch.atan((down**2 + across**2).sqrt() * tangent)
    # a logistic function of the slope where it is limited, as in `expected_by_slope`
    limited = hard_deg.isfinite().float()
    over = (slope / torch.deg2rad(hard_deg) - 1.0) / (_NUMBERS.spread * (factor / 8.0).sqrt()) + 0.9
    cell = cell_m * tangent / 2.0
    planes = (
        functional.softsign(across),
        functional.softsign(down),
        functional.softsign(4.0 * (height - near)),
        functional.softsign(2.0 * (near - wide)),
        functional.softsign(wide - far),
        (slope / limit).clamp_max(2.0) / 2.0,
        functional.softsign(torch.maximum(step_down, step_across)),
        limited * torch.sigmoid(over.clamp(-30.0, 30.0)),
        known,
        limited.expand_as(known),
        (factor.log2() / 4.0).expand_as(known),
        (cell / (1.0 + cell)).expand_as(known),
    )
    return torch.stack(planes, 1) * known[:, None]


def _mean(layers: Tensor, blocks: int) -> Tensor:
    """Mean of the known heights over blocks × blocks, of heights and whether they are known
    (N, 2, B, B).
    """
    number = torch.arange(layers.shape[-1], device=layers.device)
    near = ((number[:, None] - number).abs() <= blocks // 2).float()
    total = near @ layers @ near  # sums over rows, then columns
    return total[:, 0] / total[:, 1].clamp_min(1e-6)


def _rises(edged: Tensor, there: Tensor) -> tuple[Tensor, Tensor]:
    """Mean rise from row to row over the neighbours that are there, and the greater step to one of
    the two; of maps with a border.
    """
    steps = edged[:, :, 1:-1].diff(dim=1)
    after = there[:, 2:, 1:-1]
    before = there[:, :-2, 1:-1]
    onward = steps[:, 1:]
    hither = steps[:, :-1]
    rise = (onward * after + hither * before) / (after + before).clamp_min(1.0)
    return rise, torch.maximum(onward.abs(), hither.abs())
