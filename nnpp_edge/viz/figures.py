"""Pictures for the workstation, with matplotlib: sheets of samples and training curves."""

import io
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.files import write_whole
from nnpp_edge.profiling.contest import Facts
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.terrain.labels import EXCESS_STEP

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OURS = ("astar", "corridor", "nnpp")
_CYAN = np.array([0.0, 0.9, 1.0])


def sample_sheet(samples: Samples, path: Path, *, seed: int = 1, columns: int = 6, rows: int = 3) -> None:
    """A picture of random samples: cost in grey, walls in brown, nearness to the optimum in cyan, start, goal.

    Cells within 5 % of the optimum are tinted, the nearer the stronger; the optimal path's blocks are dark.
    """
    from matplotlib.figure import Figure

    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(samples), min(columns * rows, len(samples)), replace=False)
    figure = Figure(figsize=(2.2 * columns, 2.35 * rows), layout="constrained")
    for at, query in enumerate(chosen):
        axes = figure.add_subplot(rows, columns, at + 1)
        axes.imshow(_tinted(samples, query), interpolation="nearest")
        (r, c), (i, j) = samples.start[query], samples.goal[query]
        axes.plot(c, r, "s", color="gold", markeredgecolor="black", markersize=7)
        axes.plot(j, i, "*", color="red", markeredgecolor="black", markersize=11)
        axes.set_axis_off()
    _save(figure, path)


def _tinted(samples: Samples, query: int) -> NDArray[np.float64]:
    mean, blocked = samples.planes[samples.map_index[query]].astype(np.float64) / 255.0
    picture = np.repeat(mean[..., None], 3, axis=2)
    picture = np.where(blocked[..., None] > 0.5, [0.35, 0.16, 0.12], picture)
    side = mean.shape[0] // samples.excess.shape[-1]
    excess = np.kron(samples.excess[query] * EXCESS_STEP, np.ones((side, side)))
    tint = 0.75 * np.clip(1.0 - excess / 0.05, 0.0, 1.0)[..., None]
    picture = picture * (1.0 - tint) + _CYAN * tint
    mask = np.unpackbits(samples.on_path[query], axis=-1)
    return np.where(np.kron(mask, np.ones((side, side)))[..., None] > 0, 0.55 * picture, picture)


def training_curves(history: Sequence[dict[str, float]], path: Path) -> None:
    """Loss, cost gap, success and region share of the validations, against training steps."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.5), layout="constrained")
    steps = [row["step"] for row in history]
    factors = sorted({key.partition("@")[2] for key in history[0] if "@" in key}, key=float, reverse=True)
    panels = (
        ("loss", "training loss", 1.0),
        ("gap", "mean cost gap, %", 100.0),
        ("success", "path inside the region, %", 100.0),
        ("region_share", "region, % of the map", 100.0),
    )
    for at, (name, title, scale) in enumerate(panels):
        axes = figure.add_subplot(2, 2, at + 1)
        for key in [name] if name in history[0] else [f"{name}@{factor}" for factor in factors]:
            label = f"td × {key.partition('@')[2]}" if "@" in key else None
            axes.plot(steps, [scale * row[key] for row in history], marker="o", markersize=3, label=label)
        if axes.get_legend_handles_labels()[1]:
            axes.legend(fontsize="small")
        if name in ("loss", "gap"):
            axes.set_yscale("log")
        axes.set_title(title)
        axes.set_xlabel("step")
        axes.grid(alpha=0.3)
    _save(figure, path)


def times_by_size(rows: Sequence[Facts]) -> bytes:
    """A PNG: median time of a query of each planner against the side of the map, of `profile --peers`'s rows."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5.5), layout="constrained")
    axes = figure.add_subplot()
    for name in dict.fromkeys(row["planner"] for row in rows):
        measured = [row for row in rows if row["planner"] == name and row["time_ms_median"] is not None]
        if measured:
            times = [row["time_ms_median"] or 0.0 for row in measured]
            line, width = ("o-", 2.2) if name in OURS else ("s--", 1.2)
            axes.plot([row["size"] for row in measured], times, line, linewidth=width, label=name)
    axes.set_xscale("log", base=2)
    axes.set(yscale="log", xlabel="side of the map, cells", ylabel="median time of a query, ms")
    sides = sorted({row["size"] for row in rows})
    axes.set_xticks(sides, [str(side) for side in sides])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    return _png(figure)


def pareto(rows: Sequence[Facts], path: Path) -> None:
    """Mean cost gap against median time, a panel for each workload and size of `nnpp-edge evaluate`'s rows.

    Planners that none is both faster and better than are joined by a line; bars reach to the gap's 95th percentile.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    workloads, sizes = (list(dict.fromkeys(row[key] for row in rows)) for key in ("workload", "size"))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    figure = Figure(figsize=(3.6 * len(sizes) + 0.4, 3.1 * len(workloads) + 0.6), layout="constrained")
    panels = figure.subplots(len(workloads), len(sizes), squeeze=False)
    for (i, name), (j, size) in product(enumerate(workloads), enumerate(sizes)):
        axes = panels[i, j]
        chosen = [row for row in rows if (row["workload"], row["size"]) == (name, size)]
        for row in chosen:
            color = f"C{methods.index(row['method'])}"
            gap, high = 100.0 * row["gap_mean"], 100.0 * row["gap_p95"]
            axes.plot(row["time_ms_median"], gap, "o", color=color, label=row["method"], markersize=8)
            axes.vlines(row["time_ms_median"], gap, max(high, gap), color=color, alpha=0.5)
        points = sorted((row["time_ms_median"], 100.0 * row["gap_mean"]) for row in chosen)
        front = [(ms, gap) for ms, gap in points if not any(t < ms and g <= gap for t, g in points)]
        axes.plot(*zip(*front, strict=True), color="grey", linewidth=1, zorder=0)
        axes.set(xscale="log", title=f"{name}, {size}", xlabel="ms, median", ylabel="cost gap, %: mean, to p95")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(alpha=0.3, which="both")
    handles: Facts = {}
    for axes in panels.flat:
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=min(len(handles), 2 * len(sizes))
    )
    _save(figure, path)


def _save(figure: "Figure", path: Path) -> None:
    write_whole(path, _png(figure))


def _png(figure: "Figure") -> bytes:
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=110)
    return content.getvalue()
