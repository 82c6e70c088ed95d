"""Common parts of the examples: where they write, and how ground, paths and ends are drawn. Nothing
here plans.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from nnpp_edge.terrain.dem import Dem
from nnpp_edge.viz.picture import hillshade
from nnpp_edge.viz.sheet import metres


def panels(count: int, *, width: float = 4.2, height: float = 4.9) -> tuple[Figure, list[Axes]]:
    """A figure with so many panels side by side, inches."""
    figure = Figure(figsize=(width * count, height), layout="constrained")
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


def relief(axes: Axes, dem: Dem, title: str, bar_m: float) -> None:
    """Draw a map's ground, lit from the north-west, and a scale bar."""
    axes.imshow(
        hillshade(dem.elevation, dem.cell_size_m, dem.cell_width_m), cmap="gray", vmin=0, vmax=255
    )
    axes.set(xticks=[], yticks=[])
    axes.set_title(title, fontsize=13)
    right = bar_m / (dem.cell_width_m or dem.cell_size_m)
    below = axes.get_xaxis_transform()
    axes.plot(
        [0, right], [-0.04, -0.04], color="black", linewidth=4.0, transform=below, clip_on=False
    )
    axes.text(
        right, -0.04, f"  {metres(bar_m)}", fontsize=13, verticalalignment="center", transform=below
    )


def line(axes: Axes, path: np.ndarray, label: str, color: str = "tab:orange") -> None:
    """Draw places (N, 2) (row, col) as a line with a dark rim."""
    rim = withStroke(linewidth=4.0, foreground="black")
    axes.plot(path[:, 1], path[:, 0], color=color, linewidth=2.4, label=label, path_effects=[rim])


def ends(axes: Axes, start: tuple[int, int], goal: tuple[int, int]) -> None:
    """Mark the start with a square and the goal with a star."""
    axes.plot(
        start[1], start[0], "s", color="gold", markeredgecolor="black", markersize=9, label="start"
    )
    axes.plot(
        goal[1], goal[0], "*", color="red", markeredgecolor="black", markersize=16, label="goal"
    )


def save(figure: Figure) -> None:
    """Write NAME.webp, with a legend: `python examples/NAME.py [FOLDER]` writes it there, else into
    examples/out.
    """
    folder = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parent / "out"
    folder.mkdir(parents=True, exist_ok=True)
    handles, labels = figure.axes[-1].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(labels), fontsize=13, frameon=False
    )
    written = folder / Path(sys.argv[0]).with_suffix(".webp").name
    figure.savefig(written, dpi=80, bbox_inches="tight")
    print(f"written: {written}")
