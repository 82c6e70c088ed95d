"""The experiments' pictures: charts of rows, and maps with regions and paths."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction.episode import Patch
from nnpp_edge.reproduction.planners import PLANNERS, OneMap
from nnpp_edge.reproduction.regions import NETWORK, best_path
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


class Panel(NamedTuple):
    """A panel of means against the map's side."""

    rows: Rows
    figure: str
    """Name of the figure that the rows have."""
    styles: Mapping[str, str]
    """By planner."""
    title: str
    unit: str = ""


class RegionPicture(NamedTuple):
    """A picture of a map with the paper's region and paths."""

    title: str
    map: OneMap
    before: OneMap | None = None
    """The plan before, whose path is drawn too."""
    patches: Sequence[Patch] = ()
    """Changes since then."""


def tidy(axes: "Axes", title: str, x: str = "", y: str = "") -> None:
    """Title, labels and a light grid."""
    axes.set_title(title, fontsize="medium")
    axes.set(xlabel=x, ylabel=y, axisbelow=True)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def by_size(charts: Sequence[Panel]) -> "Figure":
    """Means against the map's side, a panel for each chart."""
    figure = new_figure(5.8 * len(charts), 5.2)
    for axes, chart in zip(figure.subplots(1, len(charts)), charts, strict=True):
        for name, style in chart.styles.items():
            groups = chart.rows.of(name).by("size")
            means = [of.mean(chart.figure) for of in groups.values()]
            axes.plot(list(groups), means, style, color=COLOURS.get(name, PAPER), label=name)
        sizes = chart.rows.by("size")
        axes.set_xscale("log", base=2)
        axes.set_xticks(list(sizes), [f"{size}²" for size in sizes])
        axes.minorticks_off()
        axes.set_yscale("log")
        tidy(axes, chart.title, "map", chart.unit)
        axes.legend(
            fontsize="small",
            loc="upper center",
            bbox_to_anchor=(0.5, -0.12),
            ncols=3,
            frameon=False,
        )
    return figure


def bars(groups: Mapping[str, Rows]) -> "Figure":
    """For each group the planners' mean times and their CC above that of exact A*, as bars."""
    figure = new_figure(11, 4.4 * len(groups))
    lines = figure.subplots(len(groups), 2, squeeze=False)
    for (label, rows), (left, right) in zip(groups.items(), lines, strict=True):
        planners = [name for name, of in rows.by("planner").items() if of.all("time_s")]
        colours = [COLOURS.get(name, PAPER) for name in planners]
        times_s = [rows.of(name).mean("time_s") for name in planners]
        increases = [100.0 * rows.increase(name) for name in planners]
        for axes, values, form in ((left, times_s, "%.3g"), (right, increases, "%.2f")):
            bar = axes.barh(planners, values, color=colours)
            axes.bar_label(bar, fmt=form, padding=3, fontsize="small")
            axes.margins(x=0.2)
            axes.invert_yaxis()
        tidy(left, f"{label}: mean time", "seconds")
        tidy(right, f"{label}: CC above that of exact A*", "%")
        left.set_xscale("log")
    return figure


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
