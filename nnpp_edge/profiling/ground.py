"""Additions to a `Ground` that rivals plan on: costs of all its cells, and hills that come and go on it."""

import numpy as np

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.poses import pose_costs

Patch = tuple[int, int, Float2D]
"""Row and column of the first cell, and heights in metres."""
_PATCH_SIDE = 64


def patch_side(shape: tuple[int, ...]) -> int:
    """Cells to a side of the patches that a map of this shape gets: 64, on small maps a quarter of its side."""
    return min(_PATCH_SIDE, max(min(shape) // 4, 1))


def heights_of(ground: Ground) -> Float2D:
    """(H, W) float32, metres, of a ground of elevations."""
    assert ground.elevation is not None
    return as_map(ground.elevation, "elevation")


def whole_cost(ground: Ground) -> Float2D:
    """The whole cost map, (H, W) float32; with a vehicle that of each cell's best pose, inf where all fail."""
    if ground.vehicle is None:
        return ground.costs()
    (size, width), limits = ground.sides_m, ground.traversability
    poses = pose_costs(heights_of(ground), size, ground.vehicle, cell_width_m=width, traversability=limits)
    best: Float2D = poses.min(0)
    return best


def hill_on(ground: Ground, cell: Cell) -> Patch:
    """A square patch around a cell in which a hill stands that is too steep for most rovers: 42°."""
    side = patch_side(ground.shape)
    row, col = (min(max(at - side // 2, 0), n - side) for at, n in zip(cell, ground.shape, strict=True))
    along = (np.arange(side) - 0.5 * (side - 1)) / (side / 6.0)
    bump = np.exp(-0.5 * (along[:, None] ** 2 + along**2))
    height_m = 1.5 * side / 6.0 * ground.sides_m[0]
    heights = heights_of(ground)[row : row + side, col : col + side] + height_m * bump
    return row, col, heights.astype(np.float32)


def cut_out(ground: Ground, patch: Patch) -> Patch:
    """The elevations as they are where a patch lies."""
    row, col, heights = patch
    rows, cols = heights.shape
    return row, col, heights_of(ground)[row : row + rows, col : col + cols]
