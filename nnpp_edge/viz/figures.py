"""Pictures with matplotlib: sheets of samples, training curves, figures of planners, and a path's profile."""

import io
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.files import write_whole
from nnpp_edge.profiling.contest import Facts
from nnpp_edge.runtime.map.along import Along

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nnpp_edge.terrain.dataset import Samples

OURS = ("astar", "corridor", "nnpp")
_CYAN = np.array([0.0, 0.9, 1.0])
_KILOMETRE = 1000.0
_GROUND, _LINE, _UP, _DOWN, _COST, _STOP = "#e6ded0", "#6b5233", "#c8501e", "#2f7fc0", "#555b66", "#1e1e1e"
_PANELS = (
    ("loss", "training loss", 1.0),
    ("gap", "mean cost gap, %", 100.0),
    ("success", "path inside the region, %", 100.0),
    ("region_share", "region, % of the map", 100.0),
)


def sample_sheet(samples: "Samples", path: Path, *, seed: int = 1, columns: int = 6, rows: int = 3) -> None:
    """A picture of random samples: cost in grey, walls in brown, nearness to the optimum in cyan, start, goal.

    Cells within 5 % of the optimum are tinted, the nearer the stronger; the optimal path's blocks are dark.
    """
    rng = np.random.default_rng(seed)
    figure = new_figure(2.2 * columns, 2.35 * rows)
    for at, query in enumerate(rng.choice(len(samples), min(columns * rows, len(samples)), replace=False)):
        axes = figure.add_subplot(rows, columns, at + 1)
        axes.imshow(_tinted(samples, query), interpolation="nearest")
        (r, c), (i, j) = samples.start[query], samples.goal[query]
        axes.plot(c, r, "s", color="gold", markeredgecolor="black", markersize=7)
        axes.plot(j, i, "*", color="red", markeredgecolor="black", markersize=11)
        axes.set_axis_off()
    write_whole(path, encoded(figure))


def _tinted(samples: "Samples", query: int) -> NDArray[np.float64]:
    from nnpp_edge.terrain.labels import EXCESS_STEP

    mean, blocked = samples.planes[samples.map_index[query]].astype(np.float64) / 255.0
    picture = np.where(blocked[..., None] > 0.5, [0.35, 0.16, 0.12], np.repeat(mean[..., None], 3, axis=2))
    block = np.ones((mean.shape[0] // samples.excess.shape[-1],) * 2)
    excess = np.kron(samples.excess[query] * EXCESS_STEP, block)
    tint = 0.75 * np.clip(1.0 - excess / 0.05, 0.0, 1.0)[..., None]
    picture = picture * (1.0 - tint) + _CYAN * tint
    on_path = np.kron(np.unpackbits(samples.on_path[query], axis=-1), block)
    return np.where(on_path[..., None] > 0, 0.55 * picture, picture)


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


def profile_picture(along: Along, cost: NDArray[np.float32], title: str = "", stops: Sequence[int] = ()) -> bytes:
    """The ground below a path, its slope and its cost, over the way from the start, as PNG.

    It says so where there is no way or height to draw.
    `cost` is (N,) float32 at each point of the way; `stops` are numbers of the points at which it stops.
    """
    figure = new_figure(9.0, 5.2)
    if len(along.points) < 2 or not np.isfinite(along.heights_m).any():
        figure.text(0.5, 0.5, "no way with known heights", ha="center")
        return encoded(figure, dpi=150)
    ground, slope, price = figure.subplots(3, 1, sharex=True, height_ratios=(3.0, 1.4, 1.4))
    far, heights = along.distance_m[-1] >= 2.0 * _KILOMETRE, along.heights_m
    at = along.distance_m / (_KILOMETRE if far else 1.0)
    low, high = np.nanmin(heights), np.nanmax(heights)
    room = max(0.08 * (high - low), 0.5)
    ground.fill_between(at, heights, low - room, color=_GROUND, linewidth=0)
    ground.plot(at, heights, color=_LINE, linewidth=1.4)
    ground.set(ylabel="height, m", ylim=(low - room, high + room))
    slopes = np.degrees(np.arctan2(along.rises_m[1:], along.steps_m[1:]))  # between two points each
    for part, colour in ((np.maximum(slopes, 0.0), _UP), (np.minimum(slopes, 0.0), _DOWN)):
        slope.stairs(part, at, fill=True, color=colour, linewidth=0)
    slope.set(ylabel="slope, °")
    price.fill_between(at, cost, step="mid", color=_COST, alpha=0.35, linewidth=0)
    price.plot(at, cost, color=_COST, linewidth=0.8, drawstyle="steps-mid")
    price.set(ylabel="cost T", ylim=(0.0, 1.0), xlabel=f"way from the start, {'km' if far else 'm'}")
    for axes in (ground, slope, price):
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
        for stop in stops:
            axes.axvline(at[stop], color=_STOP, linewidth=0.8, linestyle=":")
    ground.set_title(title, fontsize=10, loc="left")
    return encoded(figure, dpi=150)


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
