"""A plan as notebooks show it: a small picture and a table in HTML, and a drawing with matplotlib."""

from collections.abc import Mapping
from html import escape
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnpp_edge.runtime.arrays import unmasked
from nnpp_edge.runtime.errors import InvalidMapError, optional_module
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.runtime.map.region import Region

_SIDE = 180.0
"""Pixels of the picture's longer side."""
_MOST_POINTS = 400
_PATH, _REGION, _START, _GOAL, _RIM = "#ff7814", "#00e6ff", "#ffd23f", "#e5322d", "#1d1d1d"
_ROW = "<tr><th style='text-align:left;font-weight:normal'>{}</th><td style='text-align:right'>{}</td></tr>"


class Axes(Protocol):
    """The part used of matplotlib's, which the runtime does not import."""

    def imshow(self, picture: NDArray[np.generic], /, **how: object) -> object:
        """Draw a picture, a cell a unit."""

    def plot(self, *what: object, **how: object) -> object:
        """Draw a line or a mark."""

    def set(self, **how: object) -> object:
        """Give it a title and names of the axes."""

    def set_aspect(self, aspect: str, /) -> None:
        """Have cells square."""

    def yaxis_inverted(self) -> bool:
        """Whether rows go down already."""

    def invert_yaxis(self) -> None:
        """Have rows go down."""


def html_of(rows: Mapping[str, object], line: Line, region: Region | None) -> str:
    """A picture of a line's shape, (N, 2), over the region where it was found, and a table beside it."""
    table = "".join(_ROW.format(escape(name), escape(str(value))) for name, value in rows.items())
    picture = _svg(line, region) if len(line) > 1 else ""
    return f"<div style='display:flex;align-items:center;gap:1.5em'>{picture}<table>{table}</table></div>"


def draw(
    line: Line, region: Region | None, title: str, axes: Axes | None = None, background: ArrayLike | None = None
) -> Axes:
    """Draw a line, (N, 2), with its ends; see `Plan.plot`."""
    ground = None if background is None else unmasked(background)
    if ground is not None and not (ground.ndim == 2 or (ground.ndim == 3 and ground.shape[2] in (3, 4))):
        raise InvalidMapError(f"background must be (H, W), or a picture (H, W, 3) or (H, W, 4), got {ground.shape}")
    pyplot = optional_module("matplotlib.pyplot", "plan.plot()", "viz")
    drawn: Axes = pyplot.subplots(layout="constrained")[1] if axes is None else axes
    if ground is not None:
        picture = np.where(np.isfinite(ground), ground, np.nan) if ground.ndim == 2 else ground
        drawn.imshow(picture, cmap="gray", interpolation="nearest")
    if region is not None:
        inside = region.mask()
        drawn.imshow(np.where(inside, 1.0, np.nan), cmap="cool", vmin=1.0, vmax=2.0, alpha=0.35)
    if len(line):
        drawn.plot(line[:, 1], line[:, 0], color=_RIM, linewidth=3.5)
        drawn.plot(line[:, 1], line[:, 0], color=_PATH, linewidth=2.0, label="path")
        drawn.plot(line[0, 1], line[0, 0], "s", color=_START, markeredgecolor=_RIM, label="start")
        drawn.plot(line[-1, 1], line[-1, 0], "*", color=_GOAL, markeredgecolor=_RIM, markersize=12, label="end")
    drawn.set(xlabel="column", ylabel="row", title=title)
    drawn.set_aspect("equal")
    if ground is None and region is None and not drawn.yaxis_inverted():
        drawn.invert_yaxis()  # rows go down
    return drawn


def _svg(points: Line, region: Region | None) -> str:
    """A line in a box of its own extent, over the region where that was kept."""
    line: Line = np.concatenate([points[: -1 : max(len(points) // _MOST_POINTS, 1)], points[-1:]])
    low, high = line.min(0), line.max(0)
    margin = 0.08 * float((high - low).max()) + 1.0
    (top, left), (rows, cols) = low - margin, high - low + 2.0 * margin
    scale = _SIDE / max(rows, cols)
    dot = margin / 2.0
    marks = (
        f"<rect x='{line[0, 1] - dot / 2:.2f}' y='{line[0, 0] - dot / 2:.2f}' width='{dot:.2f}' height='{dot:.2f}' "
        f"fill='{_START}' stroke='{_RIM}' stroke-width='{1.0 / scale:.3f}'/>"
        f"<circle cx='{line[-1, 1]:.2f}' cy='{line[-1, 0]:.2f}' r='{dot / 2:.2f}' fill='{_GOAL}'/>"
    )
    below = "" if region is None else f"<path d='{_blocks(region)}' fill='{_REGION}' fill-opacity='.35'/>"
    size = f"width='{cols * scale:.0f}' height='{rows * scale:.0f}'"
    return (
        f"<svg role='img' aria-label='path from start to goal' {size} "
        f"viewBox='{left:.2f} {top:.2f} {cols:.2f} {rows:.2f}'>{below}"
        f"<path d='{_moves(line)}' fill='none' stroke='{_PATH}' stroke-width='{2.5 / scale:.3f}' "
        f"stroke-linejoin='round'/>{marks}</svg>"
    )


def _moves(line: Line) -> str:
    """A line as an SVG path, columns to the right and rows down."""
    return "M" + "L".join(f"{col:.6g} {row:.6g}" for row, col in line.tolist())


def _blocks(region: Region) -> str:
    """A region as an SVG path: a rectangle for each run of blocks along a row of blocks."""
    inside, rows, cols = region.blocks(), _edges(region.row_block), _edges(region.col_block)
    runs = np.diff(np.pad(inside, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    found = []
    for row in range(inside.shape[0]):
        begins, ends = np.flatnonzero(runs[row] == 1), np.flatnonzero(runs[row] == -1)
        for first, last in zip(cols[begins], cols[ends], strict=True):
            found.append(f"M{first:g} {rows[row]:g}H{last:g}V{rows[row + 1]:g}H{first:g}Z")
    return "".join(found)


def _edges(block_of: NDArray[np.int32]) -> NDArray[np.float64]:
    """Where each block begins, and the last ends, in cells."""
    return np.searchsorted(block_of, np.arange(int(block_of[-1]) + 2)).astype(np.float64) - np.float64(0.5)
