"""Common parts of the examples: where they write, and how ground, paths and ends are drawn. Nothing
here plans.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.transforms import ScaledTranslation

from nnpp_edge.runtime import Traversability
from nnpp_edge.runtime.terrain.traversability import traversability_cost
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.facts import metres
from nnpp_edge.viz.palette import GOAL, INK, PATH, START
from nnpp_edge.viz.picture import MapDrawing
from nnpp_edge.viz.relief import Chart

TEXT = 17
"""Points: read where a telephone shrinks the picture to half."""


def panels(
    rows: int, across: int, *, width: float = 4.4, height: float = 4.9
) -> tuple[Figure, list[Axes]]:
    """A figure with rows of panels, of so many inches each."""
    figure = Figure(figsize=(width * across, height * rows), layout="constrained")
    return figure, list(figure.subplots(rows, across, squeeze=False).ravel())


def relief(
    axes: Axes, dem: Dem, title: str, bar_m: float, limits: Traversability | None = None
) -> None:
    """Draw a map's ground, lit from the north-west, browner where it costs more, dark where it is
    impassable and striped where it is unknown, and a scale bar.
    """
    size, width = dem.cell_size_m, dem.cell_width_m
    limits = limits or Traversability.safe()
    cost = traversability_cost(dem.elevation, size, limits, cell_width_m=width, warn=False)
    MapDrawing(Chart(cost, dem.elevation, (size, width)), axes=axes)
    axes.set_title(title, fontsize=TEXT)
    right = bar_m / width
    down = ScaledTranslation(0.0, -0.15, axes.get_figure().dpi_scale_trans)
    below = axes.get_xaxis_transform() + down
    axes.plot([0, right], [0, 0], color="black", linewidth=4.0, transform=below, clip_on=False)
    axes.text(
        right,
        0.0,
        f"  {metres(bar_m)}",
        fontsize=TEXT,
        verticalalignment="center",
        transform=below,
    )


def line(axes: Axes, path: np.ndarray, label: str, color: str = PATH) -> None:
    """Draw places (N, 2) (row, col) as a line with a dark rim."""
    rim = withStroke(linewidth=4.5, foreground=INK)
    axes.plot(path[:, 1], path[:, 0], color=color, linewidth=2.8, label=label, path_effects=[rim])


def ends(axes: Axes, start: tuple[int, int], goal: tuple[int, int], begin: str = "start") -> None:
    """Mark the start, or what else the path begins at, with a square and the goal with a star."""
    for (row, col), mark, colour, size, name in (
        (start, "s", START, 11, begin),
        (goal, "*", GOAL, 19, "goal"),
    ):
        axes.plot(
            col,
            row,
            mark,
            color=colour,
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
    drawn = dict[str, Artist]()
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        drawn |= dict(zip(labels, handles, strict=True))
    keys = {"loc": "outside lower center", "ncols": 3 - (len(drawn) in (2, 4)), "frameon": False}
    figure.legend(drawn.values(), drawn.keys(), fontsize=TEXT, **keys)
    written = folder / Path(sys.argv[0]).with_suffix(".webp").name
    figure.savefig(written, dpi=80, bbox_inches="tight")
    print(f"written: {written}")
