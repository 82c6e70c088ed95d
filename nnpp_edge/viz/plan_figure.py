"""A figure of a plan for a paper, with matplotlib: the ground and the path in the map's coordinates
above the heights along the way.
"""

import io
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.cells import Cell, slices
from nnpp_edge.runtime.errors import optional_module
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.terrain.georeference import Georeference, Place
from nnpp_edge.viz.figures import new_figure
from nnpp_edge.viz.palette import GOAL, INK, PAPER, PATH, START, hexed
from nnpp_edge.viz.picture import Chart

_WIDE = 6.9
"""Inches: the width of a page of two columns."""
_MOST_CELLS = 1000
"""Of a side that is drawn."""
_BOX = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.8, "linewidth": 0}
_NAMES = {"textcoords": "offset points", "fontsize": 8}


def plan_figure(
    chart: Chart, place: Place, along: Along, stops: Sequence[tuple[str, Cell]], kind: str
) -> bytes:
    """A figure, of a `kind` such as ``.pdf``, of the way along a chart with heights, by stops with
    their names; MissingExtraError without matplotlib.
    """
    matplotlib = optional_module("matplotlib", "a figure", "viz")
    cells = np.array([cell for _, cell in stops], np.float64)
    line = along.points if len(along.points) else cells[:1]
    row, col, rows, cols = part = chart.around(np.concatenate((cells, line)))
    high = _WIDE * min(max(rows / cols, 0.5), 1.3) * 0.85
    figure = new_figure(_WIDE, high + 1.7)
    above, below = figure.subplots(2, 1, height_ratios=(high, 1.5))

    # the ground, tinted by height
    frame, unit, names = _frame(place)
    step = max(max(rows, cols) // _MOST_CELLS, 1)
    plain = replace(chart, cost=np.where(chart.cost < 1.0, np.float32(0.0), chart.cost))
    corners = _on(frame, unit, np.array([(row, col), (row + rows, col + cols)]) - 0.5)
    extent = (*corners[0], *corners[1][::-1])
    a, _, _, _, e, _ = frame.transform
    aspect = abs(place.cell_size_m / e * a / place.cell_width_m)
    above.imshow(plain.ground(part, step)[..., ::-1], extent=extent)
    assert chart.elevation is not None
    heights = chart.elevation[slices(part)][::step, ::step]
    tint = above.imshow(heights, cmap="cividis", alpha=0.4, extent=extent)
    figure.colorbar(tint, ax=above, label="height, m", shrink=0.7, pad=0.02)
    above.set(xlabel=names[0], ylabel=names[1], aspect=aspect)
    above.ticklabel_format(useOffset=False, style="plain")

    # the path, and the heights along it
    far = bool(len(along.distance_m)) and along.distance_m[-1] >= 2000.0
    distance = along.distance_m / (1000.0 if far else 1.0)
    for colour, width in ((INK, 3.2), (PATH, 1.8)):
        above.plot(*_on(frame, unit, line), color=hexed(colour), linewidth=width)
    below.plot(distance, along.heights_m, color=hexed(PATH), linewidth=1.4)
    below.set(xlabel=f"distance along the path, {'km' if far else 'm'}", ylabel="height, m")
    below.spines[["top", "right"]].set_visible(False)

    # the stops
    between = [("o", PAPER, 5)] * (len(stops) - 2)
    marks = [("s", START, 6), *between, ("*", GOAL, 11)]
    for (name, stop), (mark, colour, size) in zip(stops, marks, strict=True):
        x, y = (float(each[0]) for each in _on(frame, unit, np.array([stop])))
        above.plot(x, y, mark, ms=size, color=hexed(colour), mec=hexed(INK), mew=0.8)
        above.annotate(name, (x, y), (6, 6), bbox=_BOX, **_NAMES)
        if (here := (along.points == stop).all(1)).any():
            at = distance[here.argmax()]
            below.axvline(at, color="0.6", linewidth=0.7, zorder=0)
            on_top = ("data", "axes fraction")
            below.annotate(name, (at, 1.0), (0, 2), xycoords=on_top, ha="center", **_NAMES)

    content = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(content, format=kind[1:], dpi=200)
    return content.getvalue()


def _frame(place: Place) -> tuple[Georeference, float, tuple[str, str]]:
    """The coordinates of the axes, what they are divided by, and their names: longitude and
    latitude or kilometres, along the sides of a map that is turned.
    """
    located = place.located
    if located.transform[1] or located.transform[3]:
        high = place.cell_size_m
        sides = (place.cell_width_m, 0.0, 0.0, 0.0, -high, high * place.shape[0])
        located = Georeference(None, sides)
    if (located.crs or "").lstrip().startswith(("GEOG", "GEODCRS")):
        return located, 1.0, ("longitude, °", "latitude, °")
    return located, 1000.0, ("x, km", "y, km")


def _on(frame: Georeference, unit: float, points: Floats) -> tuple[Floats, Floats]:
    """x and y of rows and columns (N, 2)."""
    x, y = frame.map_coordinates(*points.T)
    return np.asarray(x) / unit, np.asarray(y) / unit
