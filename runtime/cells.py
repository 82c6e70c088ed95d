"""Cells and rectangles of cells of a map."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, shown

Cell = tuple[int, int]
"""(row, col)."""
Shape = tuple[int, int]
"""Rows and columns of a map."""
Sides = tuple[float, float]
"""Height and width of a cell, metres."""
Endpoints = tuple[Cell, Cell]
"""Start and goal."""
Rectangle = tuple[int, int, int, int]
"""(row, col, rows, cols) of a part of a map."""


def as_cell(cell: Cell, name: str) -> Cell:
    """Two whole numbers; InvalidQueryError if it is anything else."""
    try:
        row, col = cell
        if int(row) == row and int(col) == col:
            return int(row), int(col)
    except (TypeError, ValueError, OverflowError):
        pass
    raise InvalidQueryError(f"{name} must be two whole numbers (row, col), got {shown(cell)}")


def cell_of(state: NDArray[np.signedinteger]) -> Cell:
    """The cell of a state of a path."""
    row, col = state[:2].tolist()
    return row, col


def coarser(cell: Cell, factor: int) -> Cell:
    """The cell of `factor` × `factor` cells that holds a cell."""
    return cell[0] // factor, cell[1] // factor


def above(part: Rectangle, factor: int) -> Rectangle:
    """The cells of `factor` × `factor` cells in which those of a rectangle lie."""
    row, col, rows, cols = part
    top, left = coarser((row, col), factor)
    bottom, right = coarser((row + rows - 1, col + cols - 1), factor)
    return top, left, bottom - top + 1, right - left + 1


def patch_at(origin: Cell, patch: tuple[int, ...], shape: tuple[int, int]) -> Rectangle:
    """Where a patch of (rows, cols) cells goes; InvalidMapError unless that lies inside a map of
    this shape.
    """
    row, col = as_cell(origin, "origin")
    rows, cols = patch
    if row < 0 or col < 0 or row + rows > shape[0] or col + cols > shape[1]:
        raise InvalidMapError(
            f"a patch must lie inside the map of {shape}, got {(row, col, rows, cols)}"
        )
    return row, col, rows, cols


def slices(part: Rectangle) -> tuple[slice, slice]:
    """The rows and columns of a rectangle, to index a map with."""
    row, col, rows, cols = part
    return slice(row, row + rows), slice(col, col + cols)


def widened(part: Rectangle, by: Cell, shape: tuple[int, ...]) -> Rectangle:
    """A rectangle and so many rows and columns around it, as far as they lie on a map of this
    shape.
    """
    row, col, rows, cols = part
    up, left = by
    row0 = max(row - up, 0)
    col0 = max(col - left, 0)
    return (
        row0,
        col0,
        min(row + rows + up, shape[0]) - row0,
        min(col + cols + left, shape[1]) - col0,
    )


def enclosing(parts: Sequence[Rectangle]) -> Rectangle:
    """The least rectangle that holds all of these, of which there is at least one."""
    row = min(part[0] for part in parts)
    col = min(part[1] for part in parts)
    bottom = max(part[0] + part[2] for part in parts)
    right = max(part[1] + part[3] for part in parts)
    return row, col, bottom - row, right - col


def holding(cells: NDArray[np.signedinteger]) -> Rectangle:
    """The least rectangle that holds these cells (N, 2), of which there is at least one."""
    row, col = cells.min(0).tolist()
    bottom, right = cells.max(0).tolist()
    return row, col, bottom - row + 1, right - col + 1


def common(one: Rectangle, other: Rectangle) -> Rectangle | None:
    """The common part of two rectangles; None where there is none."""
    row = max(one[0], other[0])
    col = max(one[1], other[1])
    rows = min(one[0] + one[2], other[0] + other[2]) - row
    cols = min(one[1] + one[3], other[1] + other[3]) - col
    return (row, col, rows, cols) if rows > 0 and cols > 0 else None


def apart(part: Rectangle, cell: tuple[int, int]) -> int:
    """Cells between a rectangle and a cell, as the king moves; 0 inside."""
    row, col, rows, cols = part
    above = row - cell[0]
    left = col - cell[1]
    return max(above, 1 - rows - above, left, 1 - cols - left, 0)


def nearest(mask: NDArray[np.bool_], place: tuple[float, float]) -> Cell:
    """The cell of a mask (H, W), which holds at least one, nearest to a place (row, col)."""
    cells = np.argwhere(mask)
    squares = ((cells - place) ** 2).sum(1)
    return cell_of(cells[squares.argmin()])
