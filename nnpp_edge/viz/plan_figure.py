"""A figure of a plan for a paper, with matplotlib: the ground and the path in the map's coordinates
above the heights along the way.
"""

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.cells import Cell, Rectangle, slices
from nnpp_edge.runtime.errors import optional_module
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.terrain.georeference import Georeference, Place
from nnpp_edge.viz.figures import new_figure
from nnpp_edge.viz.palette import GOAL, IMPASSABLE, INK, PATH, START, hexed
from nnpp_edge.viz.picture import Chart, hillshade

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDE = 6.9
"""Inches: the width of a page of two columns."""
_MOST_CELLS = 1000
"""Of a side that is drawn."""
_MARKS = {"edgecolors": hexed(INK), "zorder": 5, "linewidths": 0.8}


def plan_figure(
    chart: Chart, place: Place, along: Along, stops: Sequence[Cell], names: Sequence[str], kind: str
) -> bytes:
    """A figure, of a `kind` such as ``.pdf``, of the way along a chart with heights, by stops of these
    names; MissingExtraError without matplotlib.
    """
    matplotlib = optional_module("matplotlib", "a figure", "viz")
    cells = np.array(stops, np.float64)
    line = along.points if len(along.points) else cells[:1]
    part = chart.around(np.concatenate((cells, line)))
    frame, factor, axis_names = _frame(place)
    high = _WIDE * min(max(part[2] / part[3], 0.5), 1.3) * 0.85
    figure = new_figure(_WIDE, high + 1.7)
    above, below = figure.subplots(2, 1, height_ratios=(high, 1.5))
    _draw_ground(above, chart, part, frame, factor)

    def placed(points: Floats) -> tuple[Floats, Floats]:
        x, y = frame.map_coordinates(*points.T)
        return np.asarray(x) / factor, np.asarray(y) / factor

    # the path, and the stops with their names
    for colour, width in ((hexed(INK), 3.2), (hexed(PATH), 1.8)):
        above.plot(*placed(line), color=colour, linewidth=width, solid_joinstyle="round")
    x, y = placed(cells)
    above.scatter(x[1:-1], y[1:-1], s=28, color="white", **_MARKS)
    above.scatter(x[:1], y[:1], s=42, marker="s", color=hexed(START), **_MARKS)
    above.scatter(x[-1:], y[-1:], s=110, marker="*", color=hexed(GOAL), **_MARKS)
    white = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.8, "linewidth": 0}
    for name, *at in zip(names, x, y, strict=True):
        above.annotate(
            name, at, (6, 6), textcoords="offset points", fontsize=8, zorder=6, bbox=white
        )
    above.set(xlabel=axis_names[0], ylabel=axis_names[1], aspect=_aspect(place, frame))

    # heights along the way
    distance, unit = along.distance_m, "m"
    if len(distance) and distance[-1] >= 2000.0:
        distance, unit = distance / 1000.0, "km"
    below.plot(distance, along.heights_m, color=hexed(PATH), linewidth=1.4)
    below.set(xlabel=f"distance along the path, {unit}", ylabel="height, m")
    for name, cell in zip(names, stops, strict=True):
        apart = np.abs(along.points - cell).max(axis=1)
        if len(apart) and apart.min() < 1.0:
            at = distance[apart.argmin()]
            below.axvline(at, color="0.6", linewidth=0.7, zorder=0)
            below.annotate(
                name, (at, 1.0), (0, 2), xycoords=("data", "axes fraction"), fontsize=7,
                textcoords="offset points", ha="center",
            )  # fmt: skip
    below.spines[["top", "right"]].set_visible(False)
    below.margins(x=0.01)

    content = io.BytesIO()
    when = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(kind)
    with matplotlib.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42}):
        figure.savefig(content, format=kind[1:], dpi=200, metadata=when)
    return content.getvalue()


def _frame(place: Place) -> tuple[Georeference, float, tuple[str, str]]:
    """The coordinates of a figure's axes, what these are divided by, and their names."""
    located = place.located
    _, b, _, d, _, _ = located.transform
    if b or d:  # turned against the map: kilometres along its sides
        size = place.cell_size_m
        width = place.cell_width_m
        located = Georeference(None, (width, 0.0, 0.0, 0.0, -size, size * place.shape[0]))
        return located, 1000.0, ("along the rows, km", "along the columns, km")
    if located.crs and located.crs.lstrip().startswith(("GEOG", "GEODCRS")):
        return located, 1.0, ("longitude, °", "latitude, °")
    return located, 1000.0, ("x, km", "y, km")


def _aspect(place: Place, frame: Georeference) -> float:
    """Height of a unit of y over the width of one of x, as they lie on the ground."""
    a, _, _, _, e, _ = frame.transform
    return (place.cell_size_m / abs(e)) / (place.cell_width_m / abs(a))


def _draw_ground(
    axes: "Axes", chart: Chart, part: Rectangle, frame: Georeference, factor: float
) -> None:
    """The relief, tinted by height, with a key; dark where impassable, white where unknown."""
    assert chart.elevation is not None and chart.sides_m is not None
    step = -(-max(part[2:]) // _MOST_CELLS)
    heights = chart.elevation[slices(part)][::step, ::step]
    cost = chart.cost[slices(part)][::step, ::step]
    colours = optional_module("matplotlib", "a figure", "viz").colormaps["cividis"]
    known = np.isfinite(heights)
    low, high = np.quantile(heights[known], (0.01, 0.99)) if known.any() else (0.0, 1.0)
    tint = colours(np.clip((heights - low) / max(high - low, 1e-6), 0.0, 1.0))[..., :3]
    light = hillshade(heights, *(step * side for side in chart.sides_m)) / 245.0
    picture = (0.35 + 0.65 * tint) * (0.3 + 0.7 * light[..., None])
    picture[~(cost < 1.0)] = np.array(IMPASSABLE[::-1]) / 255.0
    picture[~known] = 1.0
    row, col = part[:2]
    corners = np.array([(row, col), (row + step * len(heights), col + step * heights.shape[1])])
    x, y = frame.map_coordinates(*(corners - 0.5).T)
    extent = (*(np.asarray(x) / factor), *(np.asarray(y)[::-1] / factor))
    axes.imshow(np.clip(picture, 0.0, 1.0), extent=extent, interpolation="nearest")
    axes.ticklabel_format(useOffset=False, style="plain")
    kinds = optional_module("matplotlib.cm", "a figure", "viz")
    key = kinds.ScalarMappable(cmap=colours)
    key.set_clim(low, high)
    axes.figure.colorbar(key, ax=axes, label="height, m", shrink=0.7, pad=0.02)
