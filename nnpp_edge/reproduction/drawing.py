"""The experiments' pictures: panels of curves, over a map or not."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction.episode import Patch
from nnpp_edge.reproduction.planners import PLANNERS, OneMap
from nnpp_edge.reproduction.regions import NETWORK, best_path
from nnpp_edge.reproduction.table import written
from nnpp_edge.runtime.arrays import Int32
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.viz.figures import Curve, Panel, chart

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER = "#7f7f7f"
COLOURS = {name: f"C{at}" for at, name in enumerate((*PLANNERS, "inference"))}
"""Of the planners; the paper's are grey."""
_IMPASSABLE = (0.38, 0.17, 0.13)
_CYAN = np.array([0.0, 0.9, 1.0])
_TINT = 0.45


def maps(scenes: Sequence[Panel]) -> "Figure":
    """Maps in lines of five."""
    return chart([scenes[first : first + 5] for first in range(0, len(scenes), 5)], wide=2.6)


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
            curves.append(Curve([*groups], means, "o-", planner, COLOURS.get(planner, PAPER)))
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


def scene(
    title: str, here: OneMap, before: OneMap | None = None, patches: Sequence[Patch] = ()
) -> Panel:
    """A map's cost in grey, the whiter the dearer, brown where impassable, cyan inside the region;
    with the optimal path, the one in the region, that of the plan before, and what has changed.
    """
    region = here.regions[NETWORK]
    passable = here.cost < 1.0
    picture = np.where(passable[..., None], here.cost[..., None], _IMPASSABLE)
    tint = _TINT * (passable & region.mask())[..., None]
    start, goal = here.query
    path = best_path(here.grid, here.query, region)
    curves = [
        _curve("optimal path", here.optimum, "-", "#e0218a", 3.0),
        _curve("path in the region", path, "-", "#ffe100", 1.2),
        _curve("start", [start], "s", "gold"),
        _curve("goal", [goal], "*", "red"),
    ]
    if before is not None:
        curves.append(_curve("path before", before.optimum, ":", "#b8b8b8"))
    for row, col, patch in patches:
        low = row + patch.shape[0]
        right = col + patch.shape[1]
        corners = [(row, col), (low, col), (low, right), (row, right), (row, col)]
        curves.append(_curve("changed", corners, "-", "#ff3b1f"))
    return Panel(title, curves, image=picture * (1.0 - tint) + _CYAN * tint)


def _curve(
    label: str, cells: Int32 | list[Cell], style: str, colour: str, width: float = 1.3
) -> Curve:
    rows, cols = np.reshape(cells, (-1, 2)).T
    return Curve(cols, rows, style, label, colour, width)
