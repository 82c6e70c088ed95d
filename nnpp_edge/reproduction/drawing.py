"""The experiments' pictures: panels of curves, over a map or not."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction.planners import PLANNERS, OneMap
from nnpp_edge.reproduction.regions import NETWORK, best_path
from nnpp_edge.reproduction.table import written
from nnpp_edge.viz.figures import Curve, Panel, chart
from nnpp_edge.viz.palette import GOAL, GRID, OPTIMUM, PATH, REGION
from nnpp_edge.viz.picture import MapDrawing
from nnpp_edge.viz.relief import Chart

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER_GREY = "#7f7f7f"
COLOURS = {name: f"C{at}" for at, name in enumerate(PLANNERS)}
"""Of the planners; the paper's are grey."""


def maps(scenes: Sequence[Panel]) -> "Figure":
    """Maps in lines of three."""
    return chart([scenes[first : first + 3] for first in range(0, len(scenes), 3)], wide=4.2)


def by_size(names: Mapping[str, tuple[str, str]], rows: Rows) -> "Figure":
    """A panel for each of these figures, whose title and unit are given: the means of each planner
    that has it against the map's side.
    """
    panels = []
    for name, (title, unit) in names.items():
        curves = []
        for planner, own in rows.having(name).by("planner").items():
            groups = own.by("size")
            means = [of.mean(name) for of in groups.values()]
            style = "o-" if planner in COLOURS else "o--"
            colour = COLOURS.get(planner, PAPER_GREY)
            curves.append(Curve([*groups], means, style, planner, colour))
        panels.append(Panel(title, curves, "side of the map, cells", unit, "xy"))
    return chart([panels])


def by_planner(name: str, rows: Rows) -> "Figure":
    """For each value under a name the planners' mean times and their CC above that of exact A*."""
    lines = []
    for value, group in rows.having("time_s").by(name).items():
        label = written(name, value)
        planners = group.by("planner")
        times = Curve([of.mean("time_s") for of in planners.values()], [*planners], "o")
        above = Curve([100.0 * of.increase() for of in planners.values()], [*planners], "o")
        title = f"{label}: CC above that of exact A*"
        mean = Panel(f"{label}: mean time", [times], "seconds", log="x")
        lines.append([mean, Panel(title, [above], "%")])
    return chart(lines)


def frame(at: int) -> str:
    """A plan's name in the paper."""
    return ("T", "T + Δt")[at] if at < 2 else f"T + {at}Δt"


def scene(title: str, here: OneMap, before: OneMap | None = None) -> Panel:
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

    return Panel(title, (), draw=draw)
