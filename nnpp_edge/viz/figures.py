"""Pictures with matplotlib: training curves, and what all figures share."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from nnpp_edge.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PANELS = (
    ("loss", "training loss", 1.0),
    ("gap", "mean cost gap, %", 100.0),
    ("success", "path inside the region, %", 100.0),
    ("region_share", "region, % of the map", 100.0),
)
_FITS = (
    ("loss", "training loss", 1.0),
    ("rmse_mean", "error of the mean T", 1.0),
    ("rmse_blocked", "error of the share of impassable cells", 1.0),
    ("rmse_closed", "error of the chance that a block is closed", 1.0),
)


def training_curves(history: Sequence[dict[str, float]], path: Path) -> None:
    """Loss, and what the validations found, against training steps."""
    panels = _FITS if "rmse_mean" in history[0] else _PANELS
    figure = new_figure(11.0, 6.5)
    steps = [row["step"] for row in history]
    factors = sorted({key.partition("@")[2] for key in history[0] if "@" in key}, key=float, reverse=True)
    for axes, (name, title, scale) in zip(figure.subplots(2, 2).flat, panels, strict=True):
        for key in [name] if name in history[0] else [f"{name}@{factor}" for factor in factors]:
            label = f"td × {key.partition('@')[2]}" if "@" in key else None
            axes.plot(steps, [scale * row[key] for row in history], marker="o", markersize=3, label=label)
        if axes.get_legend_handles_labels()[1]:
            axes.legend(fontsize="small")
        axes.set(title=title, xlabel="step", yscale="log" if name in ("loss", "gap") else "linear")
        axes.grid(alpha=0.3)
    write_whole(path, encoded(figure))


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure, so many inches wide and high."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def encoded(figure: "Figure", dpi: int = 110) -> bytes:
    """The figure as PNG."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    return content.getvalue()
