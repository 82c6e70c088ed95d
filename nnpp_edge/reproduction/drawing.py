"""The experiments' pictures: charts of rows, and maps with regions and paths."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction.episode import Patch
from nnpp_edge.reproduction.planners import PLANNERS, OneMap
from nnpp_edge.reproduction.regions import NETWORK, best_path
from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.viz.figures import new_figure

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nnpp_edge.reproduction.experiment import Context

PAPER = "#7f7f7f"
COLOURS = {name: f"C{at}" for at, name in enumerate((*PLANNERS, "inference"))}
"""Of the planners; the paper's are grey."""
_CHANGED = "#ff3b1f"
_IMPASSABLE = (0.38, 0.17, 0.13)
_CYAN = np.array([0.0, 0.9, 1.0])
_TINT = 0.45


class Curve(NamedTuple):
    """Numbers, or names, along both axes of a panel."""

    x: Sequence[object] | Floats
    y: Sequence[object] | Floats
    style: str = "o-"
    label: str = ""
    colour: str | None = None


class Panel(NamedTuple):
    """A panel of a chart."""

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    log: str = ""
    """The axes that are logarithmic."""


class RegionPicture(NamedTuple):
    """A picture of a map with the paper's region and paths."""

    title: str
    map: OneMap
    before: OneMap | None = None
    """The plan before, whose path is drawn too."""
    patches: Sequence[Patch] = ()
    """Changes since then."""


def chart(panels: Sequence[Panel], columns: int = 2) -> "Figure":
    """Panels in lines of so many, each with its legend."""
    lines = -(-len(panels) // columns)
    figure = new_figure(5.8 * columns, 4.6 * lines)
    for axes, panel in zip(
        figure.subplots(lines, columns, squeeze=False).flat, panels, strict=True
    ):
        for x, y, style, label, colour in panel.curves:
            axes.plot(x, y, style, color=colour, label=label or None, markersize=4)
        axes.set_title(panel.title, fontsize="medium")
        axes.set(xlabel=panel.x, ylabel=panel.y, axisbelow=True)
        for axis in panel.log:
            axes.set(**{f"{axis}scale": "log"})
        axes.grid(alpha=0.25)
        if any(curve.label for curve in panel.curves):
            axes.legend(fontsize="small")
    return figure


def by_size(rows: Rows, name: str, styles: Mapping[str, str], title: str, unit: str) -> Panel:
    """Means of the planners' figures against the map's side."""
    curves = []
    for planner, style in styles.items():
        groups = rows.of(planner).by("size")
        means = [of.mean(name) for of in groups.values()]
        curves.append(Curve([*groups], means, style, planner, COLOURS.get(planner, PAPER)))
    return Panel(title, "side of the map, cells", unit, curves, "xy")


def by_planner(groups: Mapping[object, Rows]) -> "Figure":
    """For each group the planners' mean times and their CC above that of exact A*."""
    panels = []
    for label, rows in groups.items():
        timed = rows.having("time_s").by("planner")
        times_s = [of.mean("time_s") for of in timed.values()]
        increases = [100.0 * of.increase() for of in timed.values()]
        names = [*timed]
        times = Curve(times_s, names, "o")
        panels.append(Panel(f"{label}: mean time", "seconds", "", [times], "x"))
        above = Curve(increases, names, "o")
        panels.append(Panel(f"{label}: CC above that of exact A*", "%", "", [above]))
    return chart(panels)


def frame(at: int) -> str:
    """A plan's name in the paper."""
    return ("T", "T + Δt")[at] if at < 2 else f"T + {at}Δt"


def scenes(rows: Rows, context: "Context") -> "Figure":
    """The lines of maps that an experiment has left, with a legend below."""
    from matplotlib.patches import Patch as Filled

    lines = context.scenes
    columns = max(map(len, lines))
    figure = new_figure(2.6 * columns, 1.0 + 2.4 * len(lines))
    panels = figure.subplots(len(lines), columns, squeeze=False)
    legend: dict[str, Artist] = {}
    for line, drawn in zip(panels, lines, strict=True):
        for axes, scene in zip(line, drawn, strict=False):
            _draw(axes, scene)
            handles, labels = axes.get_legend_handles_labels()
            legend |= dict(zip(labels, handles, strict=True))
        for axes in line[len(drawn) :]:
            axes.set_visible(False)
    legend["region"] = Filled(facecolor=tuple(0.35 * (1.0 - _TINT) + _TINT * _CYAN))
    figure.legend(
        list(legend.values()),
        list(legend),
        loc="outside lower center",
        ncols=4,
        fontsize="small",
        frameon=False,
    )
    return figure


def _draw(axes: "Axes", scene: RegionPicture) -> None:
    """A map's cost in grey, the whiter the dearer, brown where impassable, cyan inside the region;
    start and goal lie above all paths.
    """
    from matplotlib.patches import Rectangle

    here = scene.map
    region = here.regions[NETWORK]
    passable = here.cost < 1.0
    picture = np.where(passable[..., None], here.cost[..., None], _IMPASSABLE)
    tint = _TINT * (passable & region.mask())[..., None]
    axes.imshow(picture * (1.0 - tint) + _CYAN * tint, interpolation="nearest")
    axes.set_title(scene.title, fontsize="small")
    axes.set(xticks=[], yticks=[])
    for number, (row, col, patch) in enumerate(scene.patches):
        height, width = patch.shape
        changed = Rectangle((col - 0.5, row - 0.5), width, height, fill=False, ec=_CHANGED)
        changed.set(lw=1.3, zorder=4, label="_" if number else "changed")
        axes.add_patch(changed)
    in_region = best_path(here.grid, here.query, region)
    paths = [
        (here.optimum, "-", "#e0218a", 3.0, "optimal path"),
        (in_region, "-", "#ffe100", 1.2, "path in the region"),
    ]
    if scene.before is not None:
        paths.insert(0, (scene.before.optimum, ":", "#b8b8b8", 1.2, "path before"))
    for path, style, colour, width, label in paths:
        axes.plot(*path.T[::-1], style, color=colour, linewidth=width, label=label)
    start, goal = here.query
    for (row, col), marker, colour, size, label in (
        (start, "s", "gold", 6, "start"),
        (goal, "*", "red", 11, "goal"),
    ):
        axes.plot(
            col,
            row,
            marker,
            color=colour,
            mec="black",
            markersize=size,
            label=label,
            zorder=5,
        )
