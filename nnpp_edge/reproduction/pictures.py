"""What the experiments' pictures share. matplotlib, without its global state."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

PAPER, OURS = "#7f7f7f", "#0072b2"
COLOURS = {
    "plain A*": "#d55e00", "plain A*NN": "#0072b2", "astar": "#e69f00", "corridor": "#009e73", "nnpp": "#56b4e9",
    "inference": "#cc79a7",
}  # fmt: skip
"""Of the planners, told apart by the colour-blind too (Okabe and Ito)."""
MARKERS = {"plain A*": "o", "plain A*NN": "s", "astar": "^", "corridor": "D", "nnpp": "v", "inference": "x"}

OPTIMUM, PATH = "#e0218a", "#ffe100"
"""The optimal path, and a path in a region."""
_CYAN = np.array([0.0, 0.9, 1.0])
_TINT = 0.45
REGION = tuple((1.0 - _TINT) * np.full(3, 0.35) + _TINT * _CYAN)
"""A region on ground of middling cost, for legends."""


def new_figure(width: float, height: float) -> Any:
    """An empty figure, so many inches wide and high."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def png(figure: Any) -> bytes:
    """The figure as PNG."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=130)
    return content.getvalue()


def tidy(axes: Any, title: str, x: str, y: str) -> None:
    """Title, labels and a light grid."""
    axes.set_title(title, fontsize="medium")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.25)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def sides_axis(axes: Any, sizes: Any) -> None:
    """A logarithmic axis of map sides, each marked."""
    axes.set_xscale("log", base=2)
    axes.set_xticks(list(sizes), [f"{size}²" for size in sizes])
    axes.minorticks_off()


def tinted(cost: NDArray[np.float32], region: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
    """A cost map in grey, the whiter the dearer, brown where impassable, and cyan inside a region: (H, W, 3)."""
    passable = cost < 1.0
    grey = np.repeat(np.where(passable, cost, 0.0)[..., None].astype(np.float64), 3, axis=2)
    picture = np.where(passable[..., None], grey, [0.38, 0.17, 0.13])
    if region is not None:
        tint = _TINT * (region & passable)[..., None]
        picture = picture * (1.0 - tint) + _CYAN * tint
    return np.clip(picture, 0.0, 1.0)
