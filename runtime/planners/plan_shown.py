"""A plan as notebooks show it: a table in HTML and, with matplotlib, a picture."""

from collections.abc import Mapping
from html import escape
from io import StringIO
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.errors import MissingExtraError, optional_module
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.runtime.search.region import Region

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIDE = 2.4
"""Inches of the small picture."""
_PATH = "#d55e00"
_RIM = "#1e1e1e"
_ENDS = ((0, "s", 6, "#f0e442", "start"), (-1, "*", 12, "#cc79a7", "end"))
_ROW = (
    "<tr><th style='text-align:left;font-weight:normal'>{}</th><td "
    "style='text-align:right'>{}</td></tr>"
)


def html_of(rows: Mapping[str, object], line: Line, region: Region | None) -> str:
    """A table and, where there is matplotlib, a picture of a line (N, 2) over the region where it
    was found.
    """
    table = "".join(_ROW.format(escape(name), escape(str(rows[name]))) for name in rows)
    picture = StringIO()
    try:
        if len(line) > 1:
            figure = optional_module("matplotlib.figure", "a picture", "viz").Figure(
                (_SIDE, _SIDE), layout="constrained"
            )
            draw(line, region, "", figure.subplots())
            figure.savefig(picture, format="svg")
    except MissingExtraError:
        pass
    svg = picture.getvalue()
    return (
        "<div style='display:flex;align-items:center;gap:1.5em'>"
        f"{svg[max(svg.find('<svg'), 0) :]}<table>{table}</table></div>"
    )


def draw(
    line: Line,
    region: Region | None,
    title: str,
    axes: "Axes | None" = None,
    sides_m: tuple[float, float] | None = None,
) -> "Axes":
    """Draw a line, (N, 2), with its ends; see `Plan.plot`. Where the sides of a cell are known the
    axes count metres.
    """
    if axes is None:
        axes = optional_module("matplotlib.pyplot", "plan.plot()", "viz").subplots(
            layout="constrained"
        )[1]
    drawn: Axes = axes
    if region is not None:
        drawn.imshow(
            np.where(region.mask(), 1.0, np.nan), cmap="cool", vmin=1.0, vmax=2.0, alpha=0.35
        )
    if len(line):
        drawn.plot(line[:, 1], line[:, 0], color=_RIM, linewidth=3.5)
        drawn.plot(line[:, 1], line[:, 0], color=_PATH, linewidth=2.0, label="path")
        for at, marker, size, color, label in _ENDS:
            drawn.plot(
                *line[at, ::-1],
                marker,
                color=color,
                markeredgecolor=_RIM,
                markersize=size,
                label=label,
            )
    drawn.set(xlabel="column", ylabel="row", title=title, aspect="equal")
    if sides_m is not None:
        high, wide = sides_m
        drawn.xaxis.set_major_formatter(lambda col, _: f"{col * wide:.6g}")
        drawn.yaxis.set_major_formatter(lambda row, _: f"{row * high:.6g}")
        drawn.set(xlabel="along a row, m", ylabel="along a column, m")
    if not drawn.yaxis_inverted():
        drawn.invert_yaxis()  # rows go down
    return drawn
