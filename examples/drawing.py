"""Common parts of the examples: where they write, and how ground, paths and ends are drawn. Nothing
here plans.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from nnpp_edge.runtime import Traversability
from nnpp_edge.runtime.terrain.traversability import traversability_cost
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.viz.palette import GOAL, INK, PATH, START, hexed
from nnpp_edge.viz.picture import Chart
from nnpp_edge.viz.sheet import metres

TEXT = 17
"""Points: read where a telephone shrinks the picture to half."""


def panels(count: int, *, width: float = 4.4, height: float = 4.9) -> tuple[Figure, list[Axes]]:
    """A figure with so many panels, two side by side, inches; of three the legend takes the fourth
    place.
    """
    rows = -(-count // 2)
    figure = Figure(figsize=(width * min(count, 2), height * rows), layout="constrained")
    places = figure.subplots(rows, min(count, 2), squeeze=False).ravel()
    for axes in places[count:]:
        axes.set_axis_off()
    return figure, list(places[:count])


def relief(
    axes: Axes, dem: Dem, title: str, bar_m: float, limits: Traversability | None = None
) -> None:
    """Draw a map's ground, lit from the north-west, browner where it costs more and dark where it
    is impassable, and a scale bar.
    """
    size, width = dem.cell_size_m, dem.cell_width_m
    limits = limits or Traversability.safe()
    cost = traversability_cost(dem.elevation, size, limits, cell_width_m=width, warn=False)
    cost[np.isnan(dem.elevation)] = 0.0
    chart = Chart(cost, dem.elevation, (size, width))
    picture = chart.ground(chart.whole, 1)[..., ::-1].copy()
    picture[np.isnan(dem.elevation)] = 250
    axes.imshow(picture)
    axes.set(xticks=[], yticks=[])
    axes.set_title(title, fontsize=TEXT)
    right = bar_m / width
    below = axes.get_xaxis_transform()
    axes.plot(
        [0, right], [-0.04, -0.04], color="black", linewidth=4.0, transform=below, clip_on=False
    )
    axes.text(
        right,
        -0.04,
        f"  {metres(bar_m)}",
        fontsize=TEXT,
        verticalalignment="center",
        transform=below,
    )


def line(axes: Axes, path: np.ndarray, label: str, color: str = hexed(PATH)) -> None:
    """Draw places (N, 2) (row, col) as a line with a dark rim."""
    rim = withStroke(linewidth=4.5, foreground=hexed(INK))
    axes.plot(path[:, 1], path[:, 0], color=color, linewidth=2.8, label=label, path_effects=[rim])


def ends(axes: Axes, start: tuple[int, int], goal: tuple[int, int]) -> None:
    """Mark the start with a square and the goal with a star."""
    for (row, col), mark, colour, size, name in (
        (start, "s", START, 11, "start"),
        (goal, "*", GOAL, 19, "goal"),
    ):
        axes.plot(
            col,
            row,
            mark,
            color=hexed(colour),
            markeredgecolor="black",
            markersize=size,
            label=name,
        )


def save(figure: Figure) -> None:
    """Write NAME.webp, with a legend: `python examples/NAME.py [FOLDER]` writes it there, else into
    examples/out.
    """
    folder = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parent / "out"
    folder.mkdir(parents=True, exist_ok=True)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    words = {"fontsize": TEXT, "frameon": False}
    if figure.axes[-1].axison:
        figure.legend(handles, labels, loc="outside lower center", ncols=2, **words)
    else:
        figure.axes[-1].legend(handles, labels, loc="center", **words)
    written = folder / Path(sys.argv[0]).with_suffix(".webp").name
    figure.savefig(written, dpi=80, bbox_inches="tight")
    print(f"written: {written}")
