"""What the experiments' pictures share. matplotlib, without its global state."""

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

Cells = NDArray[np.int32]
"""(N, 2) cells (row, col)."""
PAPER, OURS = "#7f7f7f", "#0072b2"
COLOURS = {
    "plain A*": "#d55e00",
    "plain A*NN": "#0072b2",
    "astar": "#e69f00",
    "corridor": "#009e73",
    "nnpp": "#56b4e9",
    "inference": "#cc79a7",
    "plain A*, corridor": "#444444",
    "plain A*, straight band": "#888888",
    "plain A*, shuffled weights": "#bbbbbb",
}
"""Of the planners, told apart by the colour-blind too (Okabe and Ito)."""
MARKERS = {"plain A*": "o", "plain A*NN": "s", "astar": "^", "corridor": "D", "nnpp": "v", "inference": "x"}
MARKERS |= {"plain A*, corridor": "P", "plain A*, straight band": "|", "plain A*, shuffled weights": "."}

OPTIMUM, PATH = "#e0218a", "#ffe100"
"""The optimal path, and a path in a region."""
_CYAN = np.array([0.0, 0.9, 1.0])
_TINT = 0.45
REGION = tuple(((1.0 - _TINT) * np.full(3, 0.35) + _TINT * _CYAN).tolist())
"""A region on ground of middling cost, for legends."""


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure, so many inches wide and high."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def png(figure: "Figure") -> bytes:
    """The figure as PNG."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=130)
    return content.getvalue()


def tidy(axes: "Axes", title: str, x: str, y: str) -> None:
    """Title, labels and a light grid."""
    axes.set_title(title, fontsize="medium")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.25)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def sides_axis(axes: "Axes", sizes: Sequence[int]) -> None:
    """A logarithmic axis of map sides, each marked."""
    axes.set_xscale("log", base=2)
    axes.set_xticks(list(sizes), [f"{size}²" for size in sizes])
    axes.minorticks_off()


def legend_below(axes: "Axes", columns: int) -> None:
    """A legend under the axes, in so many columns."""
    axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=columns, frameon=False)


def map_legend(figure: "Figure", axes: "Axes", region: str, *, columns: int, changed: str = "") -> None:
    """A legend below the figure: what was drawn on `axes`, regions and, with its colour, what has changed."""
    from matplotlib.patches import Patch

    handles, labels = axes.get_legend_handles_labels()
    handles.append(Patch(facecolor=REGION))
    labels.append(region)
    if changed:
        handles.append(Patch(facecolor="none", edgecolor=changed))
        labels.append("changed")
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize="small", frameon=False)


def bare(axes: "Axes", title: str) -> None:
    """A title, and no ticks."""
    axes.set_title(title, fontsize="small")
    axes.set_xticks([])
    axes.set_yticks([])


def draw_path(axes: "Axes", path: Cells, colour: str, width: float, label: str = "", style: str = "-") -> "Line2D":
    """A path on a map."""
    (line,) = axes.plot(path[:, 1], path[:, 0], style, color=colour, linewidth=width, label=label)
    return line


def draw_ends(axes: "Axes", start: Sequence[int] | Cells, goal: Sequence[int] | Cells) -> None:
    """Start and goal on a map."""
    draw_mark(axes, start, "s", "gold", 6, "start")
    draw_mark(axes, goal, "*", "red", 11, "goal")


def draw_mark(
    axes: "Axes", cell: Sequence[int] | Cells, marker: str, colour: str, size: float, label: str = ""
) -> "Line2D":
    """A cell on a map, marked above all paths."""
    (mark,) = axes.plot(cell[1], cell[0], marker, color=colour, markersize=size, label=label)
    mark.set(markeredgecolor="black", clip_on=False, zorder=5)
    return mark


def tinted(cost: Float2D, region: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
    """A cost map in grey, the whiter the dearer, brown where impassable, and cyan inside a region: (H, W, 3)."""
    passable = cost < 1.0
    grey = np.repeat(np.where(passable, cost, 0.0)[..., None].astype(np.float64), 3, axis=2)
    picture = np.where(passable[..., None], grey, [0.38, 0.17, 0.13])
    if region is not None:
        tint = _TINT * (region & passable)[..., None]
        picture = picture * (1.0 - tint) + _CYAN * tint
    return np.clip(picture, 0.0, 1.0)
