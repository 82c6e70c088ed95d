"""Common parts of the examples: where they write, and how ground, paths and ends are drawn. Nothing here plans."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nnpp_edge.terrain.dem import Dem
from nnpp_edge.viz.picture import hillshade

OUT = Path(__file__).parent / "out"


def panels(count: int, *, width: float = 4.2, height: float = 4.4) -> tuple[Figure, list[Axes]]:
    """A figure with so many panels side by side, inches."""
    figure = Figure(figsize=(width * count, height), layout="constrained")
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


def relief(axes: Axes, dem: Dem, title: str = "") -> None:
    """Draw a map's ground, lit from the north-west."""
    axes.imshow(hillshade(dem.elevation, dem.cell_size_m, dem.cell_width_m), cmap="gray", vmin=0, vmax=255)
    axes.set_title(title, fontsize=10)
    axes.set_xticks([])
    axes.set_yticks([])


def line(axes: Axes, path: np.ndarray, color: str = "tab:orange", label: str | None = None) -> None:
    """Draw places (N, 2) (row, col) as a line with a dark rim."""
    axes.plot(path[:, 1], path[:, 0], color="black", linewidth=3.2)
    axes.plot(path[:, 1], path[:, 0], color=color, linewidth=1.8, label=label)


def ends(axes: Axes, start: tuple[int, int], goal: tuple[int, int]) -> None:
    """Mark the start with a square and the goal with a star."""
    axes.plot(start[1], start[0], "s", color="gold", markeredgecolor="black", markersize=7)
    axes.plot(goal[1], goal[0], "*", color="red", markeredgecolor="black", markersize=12)


def save(figure: Figure) -> None:
    """Write NAME.webp: `python examples/NAME.py [FOLDER]` writes it there, else into examples/out."""
    folder = Path(sys.argv[1]) if sys.argv[1:] else OUT
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(written := folder / Path(sys.argv[0]).with_suffix(".webp").name, dpi=80)
    print(f"written: {written}")
