"""A picture of a plan, with matplotlib."""

from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.errors import optional_module
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.runtime.search.region import Region

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PATH = "#d55e00"
_RIM = "#1e1e1e"
_ENDS = ((0, "s", 6, "#f0e442", "start"), (-1, "*", 12, "#cc79a7", "end"))


def draw(
    line: Line,
    region: Region | None,
    title: str,
    axes: "Axes | None",
    sides_m: tuple[float, float] | None,
) -> "Axes":
    """Draw a line, (N, 2), with its ends; see `Plan.plot`. Where the sides of a cell are known the
    axes count metres.
    """
    drawn: Axes = (
        axes
        or optional_module("matplotlib.pyplot", "plan.plot()", "viz").subplots(
            layout="constrained"
        )[1]
    )
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
