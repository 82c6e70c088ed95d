"""Plots of a profile's report as SVG for a page: no background, and text in the page's own colour.

So one drawing serves a light and a dark page. Colours of planners and stages are of middling lightness.
"""

import io
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from nnpp_edge.profiling.break_even import bins_by_size
from nnpp_edge.profiling.contest import Facts
from nnpp_edge.profiling.figures import STAGES, find

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK = "#010203"
"""Drawn with, and replaced by the page's own colour."""
_COLOURS = {"astar": "#8b8f98", "corridor": "#e08a1e", "nnpp": "#2f8fe0", "nnpp-fp32": "#2fa89a", "auto": "#c65bcf"}
_STYLES = {"auto": "--"}
_STAGE_COLOURS = {
    "encode": "#a78bda",
    "inference": "#2f8fe0",
    "threshold": "#3db5c4",
    "coarse": "#e0a51e",
    "search": "#d9653b",
    "path": "#57a657",
    "other": "#9a9ea6",
}
_UNKNOWN_STAGE = "#b5738f"
_MARKERS = "osD^vP"
_WIDE = 5.2
"""Inches: narrow enough for words to be read where a telephone shrinks the picture."""
_INKED = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
_STYLE: dict[Any, Any] = {
    **dict.fromkeys(_INKED, _INK),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False),
    "svg.fonttype": "none",
    "svg.hashsalt": "nnpp-edge",
    "font.family": "sans-serif",
    "font.size": 10.0,
    "axes.grid": True,
    "grid.color": "#8b8f98",
    "grid.alpha": 0.3,
}


def plots(report: Facts) -> Iterator[tuple[str, str, str]]:
    """Title, a sentence on how to read it, and the SVG, of each plot."""
    import matplotlib
    from matplotlib.figure import Figure

    first = report["results"][0]["workload"]
    drawn = (
        ("Time by stage", f"Mean of a plan on {first}, whole job.", _stages),
        ("Time against map size", f"On {first}: medians as lines, thin up to the slowest hundredth.", _by_size),
        ("Cost gap against time", "Left and down is better. The larger the map, the larger the mark.", _pareto),
        ("Distribution of plan times", f"Share of the queries on {first} that are answered by then.", _distributions),
        ("Time against distance", "Medians of all workloads, queries of short distance included.", _by_distance),
    )
    for number, (title, words, draw) in enumerate(drawn):
        with matplotlib.rc_context(_STYLE):
            figure = Figure(layout="constrained")
            draw(figure, report, first)
            yield title, words, _svg(figure, title, f"plot{number}")


def _svg(figure: "Figure", title: str, prefix: str) -> str:
    """The figure as an element of a page: names of its own, the page's colour for ink."""
    content = io.StringIO()
    figure.savefig(content, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = content.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r'(\sid="|url\(#|href="#)', rf"\g<1>{prefix}-", text).replace(_INK, "currentColor")
    # the page sets the width
    text = re.sub(r'<svg([^>]*?) width="[^"]*"', r"<svg\1", text, count=1)
    text = re.sub(r'<svg([^>]*?) height="[^"]*"', r"<svg\1", text, count=1)
    return text.replace("<svg", f'<svg role="img" aria-label="{title}"', 1)


def _sizes(report: Facts) -> list[int]:
    return sorted({row["size"] for row in report["results"]})


def _planners(report: Facts) -> list[str]:
    return list(dict.fromkeys(row["planner"] for row in report["results"]))


def _panels(figure: "Figure", report: Facts, height: float) -> "Iterator[tuple[int, Axes]]":
    """A panel for each size, two side by side where there are several."""
    sizes = _sizes(report)
    columns = min(len(sizes), 2)
    rows = -(-len(sizes) // columns)
    figure.set_size_inches(_WIDE, height * rows + 0.6)
    for at, size in enumerate(sizes):
        axes = figure.add_subplot(rows, columns, at + 1)
        axes.set_title(f"{size}²", fontsize=10)
        yield size, axes


def _line(axes: "Axes", name: str, x: ArrayLike, y: ArrayLike, **style: str | float) -> None:
    (line,) = axes.plot(x, y, _STYLES.get(name, "-"), color=_COLOURS[name], linewidth=1.8, label=name)
    line.set(**style)


def _legend(figure: "Figure", axes: "Axes") -> None:
    handles, names = axes.get_legend_handles_labels()
    narrow = {"columnspacing": 1.0, "handlelength": 1.4, "fontsize": 8.5}
    figure.legend(handles, names, loc="outside upper center", ncols=min(len(names), 5), **narrow)


def _stages(figure: "Figure", report: Facts, first: str) -> None:
    sizes, planners = _sizes(report), _planners(report)
    figure.set_size_inches(_WIDE, (0.24 * len(planners) + 0.75) * len(sizes) + 0.5)
    found = {stage for row in report["results"] for stage in row["stages_ms"]}
    stages = [*(s for s in STAGES if s in found), *sorted(found - set(STAGES))]
    for at, size in enumerate(sizes):
        axes = figure.add_subplot(len(sizes), 1, at + 1)
        left = np.zeros(len(planners))
        rows = [find(report["results"], first, size, name) for name in planners]
        for stage in stages:
            found_in = [row["stages_ms"].get(stage) if row else None for row in rows]
            widths = np.array([spread["mean"] if spread else 0.0 for spread in found_in])
            axes.barh(planners, widths, left=left, color=_STAGE_COLOURS.get(stage, _UNKNOWN_STAGE), label=stage)
            left += widths
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.set_title(f"{size}²", fontsize=10)
        axes.tick_params(axis="y", length=0)
    axes.set_xlabel("ms")
    _legend(figure, axes)


def _by_size(figure: "Figure", report: Facts, first: str) -> None:
    figure.set_size_inches(_WIDE, 3.6)
    axes = figure.add_subplot()
    sizes = _sizes(report)
    for name in _planners(report):
        rows = [row for size in sizes if (row := find(report["results"], first, size, name))]
        medians, p99 = [row["time_ms"]["median"] for row in rows], [row["time_ms"]["p99"] for row in rows]
        _line(axes, name, sizes, medians, marker="o", markersize=4)
        axes.vlines(sizes, medians, p99, color=_COLOURS[name], linewidth=0.8)
    _log(axes, "x", base=2)
    _log(axes, "y")
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.set_xlabel("side of the map, cells")
    axes.set_ylabel("ms")
    _legend(figure, axes)


def _pareto(figure: "Figure", report: Facts, first: str) -> None:
    figure.set_size_inches(_WIDE, 3.8)
    axes = figure.add_subplot()
    workloads = list(dict.fromkeys(row["workload"] for row in report["results"]))
    sizes, labelled = _sizes(report), set[str]()
    for row in report["results"]:
        if row["gap_mean"] is None:
            continue
        name, marker = row["planner"], _MARKERS[workloads.index(row["workload"]) % len(_MARKERS)]
        (mark,) = axes.plot(row["time_ms"]["median"], 100.0 * row["gap_mean"], marker, color=_COLOURS[name])
        hollow = name == "auto"  # it lies on the method that it picks
        mark.set_markersize((9 if hollow else 5) + 1.8 * sizes.index(row["size"]))
        if hollow:
            mark.set_markerfacecolor("none")
        if name not in labelled:
            mark.set_label(name)
        labelled.add(name)
    if len(workloads) > 1:
        for workload, marker in zip(workloads, _MARKERS * len(workloads), strict=False):
            axes.plot([], [], marker, color=_INK, markersize=5, label=workload)
    _log(axes, "x")
    axes.set_xlabel("median time of a plan, ms")
    axes.set_ylabel("mean gap to the optimum, %")
    _legend(figure, axes)


def _distributions(figure: "Figure", report: Facts, first: str) -> None:
    for size, axes in _panels(figure, report, 2.3):
        for name in _planners(report):
            row = find(report["results"], first, size, name)
            if row is not None:
                queries = row["queries"]
                times = np.sort(np.array(queries["time_ms"])[np.array(queries["judged"])])
                _line(axes, name, times, np.arange(1, len(times) + 1) / len(times), drawstyle="steps-post")
        _log(axes, "x")
        axes.set_xlabel("ms")
    _legend(figure, axes)


def _by_distance(figure: "Figure", report: Facts, first: str) -> None:
    bins = bins_by_size(report["results"])
    for size, axes in _panels(figure, report, 2.3):
        for name in _planners(report):
            held = [each for each in bins[size] if each.times_ms[name]]
            medians = [float(np.median(each.times_ms[name])) for each in held]
            _line(axes, name, [max(each.first, 4) for each in held], medians, marker="o", markersize=3)
        _log(axes, "x", base=4)
        _log(axes, "y")
        axes.set_xlabel("cells apart, from")
        axes.set_ylabel("ms")
    _legend(figure, axes)


def _log(axes: "Axes", which: str, base: int = 10) -> None:
    """A logarithmic axis with plain numbers, a few of them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis = axes.xaxis if which == "x" else axes.yaxis
    (axes.set_xscale if which == "x" else axes.set_yscale)("log", base=base)
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    decades = float(np.log10(high / low))
    subs: Sequence[float] = (1.0, 2.0, 5.0)
    if base != 10 or decades > 1.2:
        subs = (1.0,) if base != 10 or decades > 2.5 else (1.0, 3.0)
    axis.set_major_locator(LogLocator(base=base, subs=subs, numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
