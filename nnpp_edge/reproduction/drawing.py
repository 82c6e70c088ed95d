"""The experiments' pictures: panels of curves or maps."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction.planners import PLANNERS, OneMap
from nnpp_edge.reproduction.regions import NETWORK, best_path
from nnpp_edge.reproduction.table import written
from nnpp_edge.viz.figures import panels, with_legend
from nnpp_edge.viz.palette import GOAL, GRID, OPTIMUM, PATH, REGION
from nnpp_edge.viz.picture import MapDrawing
from nnpp_edge.viz.relief import Chart

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER_GREY = "#7f7f7f"
COLOURS = {name: f"C{at}" for at, name in enumerate(PLANNERS)}
"""Of the planners; the paper's are grey."""


Scene = Callable[["Axes"], object]
"""Draws a map on a panel."""


def maps(scenes: Sequence[Scene]) -> "Figure":
    """Maps in lines of three."""
    columns = min(len(scenes), 3)
    figure, places = panels(math.ceil(len(scenes) / columns), columns, wide=4.2)
    for axes, draw in zip(places, scenes, strict=False):
        draw(axes)
    for axes in places[len(scenes) :]:
        axes.set_visible(False)
    return with_legend(figure)


def by_size(names: Mapping[str, tuple[str, str]], rows: Rows) -> "Figure":
    """A panel for each of these figures, whose title and unit are given: the means of each planner
    that has it against the map's side.
    """
    figure, places = panels(1, len(names))
    for axes, (name, (title, unit)) in zip(places, names.items(), strict=True):
        for planner, own in rows.having(name).by("planner").items():
            groups = own.by("size")
            means = [of.mean(name) for of in groups.values()]
            style = "o-" if planner in COLOURS else "o--"
            axes.plot(
                [*groups], means, style, color=COLOURS.get(planner, PAPER_GREY), label=planner
            )
        axes.set(title=title, xlabel="side of the map, cells", ylabel=unit)
        axes.set(xscale="log", yscale="log")
    return with_legend(figure)


def by_planner(name: str, rows: Rows) -> "Figure":
    """For each value under a name the planners' mean times and their CC above that of exact A*."""
    groups = rows.having("time_s").by(name)
    figure, places = panels(len(groups), 2)
    for at, (value, group) in enumerate(groups.items()):
        planners = group.by("planner")
        label = written(name, value)
        times, above = places[2 * at : 2 * at + 2]
        times.plot([of.mean("time_s") for of in planners.values()], [*planners], "o")
        times.set(title=f"{label}: mean time", xlabel="seconds", xscale="log")
        above.plot([100.0 * of.increase() for of in planners.values()], [*planners], "o")
        above.set(title=f"{label}: CC above that of exact A*", xlabel="%")
    return figure


def frame(at: int) -> str:
    """A plan's name in the paper."""
    return ("T", "T + Δt")[at] if at < 2 else f"T + {at}Δt"


def scene(title: str, here: OneMap, before: OneMap | None = None) -> Scene:
    """A map with the network's region, the path in it and the exact optimum; beside the plan
    `before` also that one's path, and what has changed.
    """
    region = here.regions[NETWORK]
    path = best_path(here.grid, here.query, region).path

    def draw(axes: "Axes") -> None:
        drawing = MapDrawing(Chart(here.cost), axes=axes)
        drawing.tint(region.mask(), 0.4, REGION, "region")
        if before is not None:
            drawing.tint(here.cost != before.cost, 0.6, GOAL, "changed")
            drawing.line(before.optimum.path, GRID, 1.5, "path before")
        drawing.line(path, PATH, 2.5, "path in the region")
        drawing.line(here.optimum.path, OPTIMUM, 0.8, "exact optimum", None)
        drawing.ends(*here.query)

        axes.set_title(title, fontsize="medium")

    return draw
