"""Pictures with matplotlib: training curves, and figures of planners."""

import io
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.files import write_whole
from nnpp_edge.profiling.contest import Facts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


OURS = ("astar", "corridor", "nnpp")
_PANELS = (
    ("loss", "training loss", 1.0),
    ("gap", "mean cost gap, %", 100.0),
    ("success", "path inside the region, %", 100.0),
    ("region_share", "region, % of the map", 100.0),
)


def training_curves(history: Sequence[dict[str, float]], path: Path) -> None:
    """Loss, cost gap, success and region share of the validations, against training steps."""
    figure = new_figure(11.0, 6.5)
    steps = [row["step"] for row in history]
    factors = sorted({key.partition("@")[2] for key in history[0] if "@" in key}, key=float, reverse=True)
    for axes, (name, title, scale) in zip(figure.subplots(2, 2).flat, _PANELS, strict=True):
        for key in [name] if name in history[0] else [f"{name}@{factor}" for factor in factors]:
            label = f"td × {key.partition('@')[2]}" if "@" in key else None
            axes.plot(steps, [scale * row[key] for row in history], marker="o", markersize=3, label=label)
        if axes.get_legend_handles_labels()[1]:
            axes.legend(fontsize="small")
        axes.set(title=title, xlabel="step", yscale="log" if name in ("loss", "gap") else "linear")
        axes.grid(alpha=0.3)
    write_whole(path, encoded(figure))


def draw_times(axes: "Axes", times_ms: Mapping[str, Mapping[int, float]]) -> None:
    """A line for each planner: its time by the side of the map."""
    for name, by_size in times_ms.items():
        line, width = ("o-", 2.0) if name in OURS else ("s--", 1.2)
        axes.plot([*by_size], [*by_size.values()], line, linewidth=width, markersize=4, label=name)
    sides = sorted({side for by_size in times_ms.values() for side in by_size})
    _log_x(axes, base=2)
    axes.set(yscale="log", xlabel="side of the map, cells", ylabel="median time of a query, ms")
    axes.set_xticks(sides, [str(side) for side in sides])


def pareto(rows: Sequence[Facts], path: Path) -> None:
    """Mean cost gap against median time, a panel for each workload and size of `nnpp-edge evaluate`'s rows.

    Planners that none is both faster and better than are joined by a line; bars reach to the gap's 95th percentile.
    """
    workloads, sizes, methods = (
        list(dict.fromkeys(row[key] for row in rows)) for key in ("workload", "size", "method")
    )
    figure = new_figure(3.6 * len(sizes) + 0.4, 3.1 * len(workloads) + 0.6)
    panels = figure.subplots(len(workloads), len(sizes), squeeze=False)
    for axes, (name, size) in zip(panels.flat, product(workloads, sizes), strict=True):
        points = []
        for row in (row for row in rows if (row["workload"], row["size"]) == (name, size)):
            color = f"C{methods.index(row['method'])}"
            ms, gap, high = row["time_ms_median"], 100.0 * row["gap_mean"], 100.0 * row["gap_p95"]
            axes.plot(ms, gap, "o", color=color, label=row["method"], markersize=8)
            axes.vlines(ms, gap, max(high, gap), color=color, alpha=0.5)
            points.append((ms, gap))
        front = [(ms, gap) for ms, gap in sorted(points) if not any(t < ms and g <= gap for t, g in points)]
        axes.plot(*zip(*front, strict=True), color="grey", linewidth=1, zorder=0)
        _log_x(axes)
        axes.set(title=f"{name}, {size}", xlabel="ms, median", ylabel="cost gap, %: mean, to p95")
        axes.grid(alpha=0.3, which="both")
    handles: Facts = {}
    for axes in panels.flat:
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    columns = min(len(handles), 2 * len(sizes))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns)
    write_whole(path, encoded(figure))


def _log_x(axes: "Axes", base: int = 10) -> None:
    """Make the x axis logarithmic, with plain numbers, a few of them."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis = axes.xaxis
    axes.set_xscale("log", base=base)
    low, high = axis.get_view_interval()
    decades = float(np.log10(high / low))
    subs = (1.0,) if base != 10 or decades > 2.5 else (1.0, 3.0) if decades > 1.2 else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(base=base, subs=subs, numticks=8))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure, so many inches wide and high."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def encoded(figure: "Figure", dpi: int = 110) -> bytes:
    """The figure as PNG."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    return content.getvalue()
