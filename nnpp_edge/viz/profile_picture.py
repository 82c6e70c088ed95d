"""A path's profile: the ground below it, its slope and its cost, over the way from the start. With matplotlib."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.map.along import Along

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ENDINGS = (".png", ".svg", ".pdf")
_KILOMETRE = 1000.0
_GROUND, _LINE, _UP, _DOWN, _COST = "#e6ded0", "#6b5233", "#c8501e", "#2f7fc0", "#555b66"
_STOP = "#1e1e1e"


def profile_picture(
    path: Path, along: Along, cost: NDArray[np.float32], title: str = "", stops: Sequence[int] = ()
) -> bytes:
    """A picture in the format that `path` ends with, one of `ENDINGS`; it says so where there is no way or height to
    draw.

    `cost` is (N,) float32 at each point of the way; `stops` are numbers of the points at which it stops.
    """
    from matplotlib.figure import Figure

    figure, out = Figure(figsize=(9.0, 5.2), layout="constrained"), io.BytesIO()
    form = path.suffix[1:].lower()
    if len(along.points) < 2 or not np.isfinite(along.heights_m).any():
        figure.text(0.5, 0.5, "no way with known heights", ha="center")
        figure.savefig(out, format=form, dpi=150)
        return out.getvalue()
    ground, slope, price = figure.subplots(3, 1, sharex=True, height_ratios=(3.0, 1.4, 1.4))
    far = along.distance_m[-1] >= 2.0 * _KILOMETRE
    at = along.distance_m / (_KILOMETRE if far else 1.0)
    _draw_ground(ground, at, along)
    _draw_slope(slope, at, along)
    price.fill_between(at, cost, step="mid", color=_COST, alpha=0.35, linewidth=0)
    price.plot(at, cost, color=_COST, linewidth=0.8, drawstyle="steps-mid")
    price.set(ylabel="cost T", ylim=(0.0, 1.0), xlabel=f"way from the start, {'km' if far else 'm'}")
    for axes in (ground, slope, price):
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
        for stop in stops:
            axes.axvline(at[stop], color=_STOP, linewidth=0.8, linestyle=":")
    ground.set_title(title, fontsize=10, loc="left")
    figure.savefig(out, format=form, dpi=150)
    return out.getvalue()


def _draw_ground(axes: "Axes", at: NDArray[np.float64], along: Along) -> None:
    heights = along.heights_m
    low, high = np.nanmin(heights), np.nanmax(heights)
    room = max(0.08 * (high - low), 0.5)
    axes.fill_between(at, heights, low - room, color=_GROUND, linewidth=0)
    axes.plot(at, heights, color=_LINE, linewidth=1.4)
    axes.set(ylabel="height, m", ylim=(low - room, high + room))


def _draw_slope(axes: "Axes", at: NDArray[np.float64], along: Along) -> None:
    """Between two points each."""
    slopes = np.degrees(np.arctan2(along.rises_m[1:], along.steps_m[1:]))
    for part, colour in ((np.maximum(slopes, 0.0), _UP), (np.minimum(slopes, 0.0), _DOWN)):
        axes.stairs(part, at, fill=True, color=colour, linewidth=0)
    axes.set(ylabel="slope, °")
