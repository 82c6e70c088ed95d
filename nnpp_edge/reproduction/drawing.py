"""Parts of the experiments' pictures: charts of rows, and maps with regions and paths."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.reproduction.episode import Patch
from nnpp_edge.reproduction.planners import PLANNERS
from nnpp_edge.reproduction.regions import PaperRegions, best_path
from nnpp_edge.reproduction.rows import Rows
from nnpp_edge.runtime.arrays import Cells, Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.viz.figures import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER = "#7f7f7f"
COLOURS = {name: f"C{at}" for at, name in enumerate((*PLANNERS, "inference"))}
"""Of the planners; the paper's are grey."""
_PATHS = {
    "optimal path": ("#e0218a", 3.0, "-"),
    "path in the region": ("#ffe100", 1.2, "-"),
    "path before": ("#b8b8b8", 1.2, ":"),
}
"""Colour, width and style of a path by its label."""
_CHANGED = "#ff3b1f"
_CYAN = np.array([0.0, 0.9, 1.0])
_TINT = 0.45


def tidy(axes: "Axes", title: str, x: str = "", y: str = "") -> None:
    """Title, labels and a light grid."""
    axes.set_title(title, fontsize="medium")
    axes.set(xlabel=x, ylabel=y, axisbelow=True)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def by_size(panels: Sequence[tuple[Rows, str, Mapping[str, str], str, str]]) -> "Figure":
    """Panels of rows, the name of a figure, styles by planner, title and unit: means against the
    map's side.
    """
    figure = new_figure(5.8 * len(panels), 5.2)
    for axes, (rows, figures, styles, title, unit) in zip(
        figure.subplots(1, len(panels)), panels, strict=True
    ):
        for name, style in styles.items():
            groups = rows.of(name).by("size").items()
            points = sorted((at, of.mean(figures)) for (at,), of in groups if of.all(figures))
            axes.plot(*zip(*points, strict=True), style, color=COLOURS.get(name, PAPER), label=name)
        sizes = sorted(set(rows.all("size")))
        axes.set_xscale("log", base=2)
        axes.set_xticks(sizes, [f"{size:.0f}²" for size in sizes])
        axes.minorticks_off()
        axes.set_yscale("log")
        tidy(axes, title, "map", unit)
        axes.legend(
            fontsize="small",
            loc="upper center",
            bbox_to_anchor=(0.5, -0.12),
            ncols=3,
            frameon=False,
        )
    return figure


def bars(groups: Mapping[str, Rows]) -> "Figure":
    """For each group its planners' times and their CC above that of exact A*, in all, a bar a
    planner.
    """
    figure = new_figure(11, 4.4 * len(groups))
    for (label, rows), panels in zip(
        groups.items(), figure.subplots(len(groups), 2, squeeze=False), strict=True
    ):
        planners = {str(name): of for (name,), of in rows.by("planner").items() if of.all("time_s")}
        times_s = [of.mean("time_s") for of in planners.values()]
        increases = [100.0 * of.increase() for of in planners.values()]
        for axes, values, form, title, unit in (
            (panels[0], times_s, "%.3g", "mean time", "seconds"),
            (panels[1], increases, "%.2f", "CC above that of exact A*", "%"),
        ):
            drawn = axes.barh(
                list(planners), values, color=[COLOURS.get(name, PAPER) for name in planners]
            )
            axes.bar_label(drawn, fmt=form, padding=3, fontsize="small")
            axes.margins(x=0.2)
            axes.invert_yaxis()
            tidy(axes, f"{label}: {title}", unit)
        panels[0].set_xscale("log")
    return figure


class View(NamedTuple):
    """A plan by the paper's method: map, region and paths."""

    cost: Float2D
    region: NDArray[np.bool_]
    """The network's, by the paper's rule; or another planner's."""
    path: Cells
    """(N, 2) cells in the region; empty where it holds none."""
    optimum: Cells
    """The optimal path, which the robot follows."""
    patches: tuple[Patch, ...] = ()
    """Changes since the plan before."""


def view_plan(
    cost: Float2D, query: Endpoints, model: NetworkModel, patches: tuple[Patch, ...] = ()
) -> View:
    """A query by the paper's method with this network."""
    maker = PaperRegions(cost, model)
    region = maker.find(query)
    return View(
        cost,
        region.mask(),
        best_path(maker.grid, query, region),
        best_path(maker.grid, query),
        patches,
    )


def frame(at: int) -> str:
    """A plan's name in the paper."""
    return ("T", "T + Δt")[at] if at < 2 else f"T + {at}Δt"


def draw_view(axes: "Axes", view: View, title: str, *, before: View | None = None) -> None:
    """A plan on its cost in grey, the whiter the dearer, brown where impassable, and cyan inside
    the region.

    Start and goal lie above all paths. `before` is the plan before: its path is drawn, and what has
    changed since.
    """
    from matplotlib.patches import Rectangle

    passable = (view.cost < 1.0)[..., None]
    picture = np.where(
        passable, np.where(passable[..., 0], view.cost, 0.0)[..., None], [0.38, 0.17, 0.13]
    )
    tint = _TINT * passable * view.region[..., None]
    axes.imshow(np.clip(picture * (1.0 - tint) + _CYAN * tint, 0.0, 1.0), interpolation="nearest")
    axes.set_title(title, fontsize="small")
    axes.set(xticks=[], yticks=[])
    paths = {"optimal path": view.optimum, "path in the region": view.path}
    if before is not None:
        paths = {"path before": before.optimum} | paths
        for at, (row, col, patch) in enumerate(view.patches):
            label = "_" * bool(at) + "changed"
            sides = patch.shape[::-1]
            where = (col - 0.5, row - 0.5)
            axes.add_patch(
                Rectangle(where, *sides, fill=False, ec=_CHANGED, lw=1.3, zorder=4, label=label)
            )
    for label, path in paths.items():
        colour, width, style = _PATHS[label]
        axes.plot(path[:, 1], path[:, 0], style, color=colour, linewidth=width, label=label)
    start, goal = view.optimum[[0, -1]]
    axes.plot(
        start[1], start[0], "s", color="gold", mec="black", markersize=6, label="start", zorder=5
    )
    axes.plot(
        goal[1], goal[0], "*", color="red", mec="black", markersize=11, label="goal", zorder=5
    )


def map_legend(figure: "Figure", axes: "Axes") -> None:
    """A legend below the figure: what was drawn on `axes`, and regions."""
    from matplotlib.patches import Patch as Filled

    handles, labels = axes.get_legend_handles_labels()
    handles.append(Filled(facecolor=tuple(np.full(3, 0.35) * (1.0 - _TINT) + _TINT * _CYAN)))
    figure.legend(
        handles,
        [*labels, "region"],
        loc="outside lower center",
        ncols=4,
        fontsize="small",
        frameon=False,
    )
