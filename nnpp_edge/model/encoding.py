"""Start and goal as `runtime.network.encoding` shows them, of a whole batch at once, on any device.

The numbers are the runtime's within float32 rounding, and a test holds them to it: a network runs
on what it was trained on.
"""

import torch
from torch import Tensor

from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.network.model_file import QUERY_SPACING


def encode_gaussians(spec: Spec, ends: Tensor, out: Tensor) -> None:
    """Starts and goals (N, 2, 2), rows and columns in network cells, as Gaussians: written to
    `out`, (N, 2, S, S) float32.
    """
    cells = torch.arange(spec.input_size, device=ends.device)
    away = (cells - ends[..., None]) / (spec.sigma * spec.input_size)
    rows, cols = torch.exp(-0.5 * away**2).unbind(2)
    torch.mul(rows[..., None], cols[..., None, :], out=out)


def encode_ends(spec: Spec, ends: Tensor) -> Tensor:
    """Starts and goals (N, 2, 2) by six planes for each, three for both: (N, 15, E, E) float32."""
    side = spec.input_size
    sigma = spec.sigma * side
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
