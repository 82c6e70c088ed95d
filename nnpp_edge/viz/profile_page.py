"""A profile's report as one page of HTML that needs nothing else: style, plots and pictures stand in it.

Plots are SVG without a background, with text in the page's own colour, so that one drawing serves a light and a dark
page; colours of planners and stages are of middling lightness.
"""

import base64
import io
import re
from collections.abc import Iterator
from importlib.resources import files
from itertools import chain, islice
from typing import Any

import cv2
import matplotlib
import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from nnpp_edge.profiling.break_even import bins_by_size
from nnpp_edge.profiling.contest import Facts, gap
from nnpp_edge.profiling.figures import STAGES, find
from nnpp_edge.profiling.profile_file import Profile
from nnpp_edge.profiling.profile_maps import ProfileMaps
from nnpp_edge.progress import shown
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Method
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.viz.figures import log_axis
from nnpp_edge.viz.picture import plan_picture, png_bytes
from nnpp_edge.viz.sheet import Picture

_TEMPLATE = "profile.html.j2"
_EXAMPLES = 3
_TRIES = 20
_WIDTH = 640
"""Pixels of an example's picture."""
_INK = "#010203"
"""Drawn with, and replaced by the page's own colour."""
_COLOURS = {"astar": "#8b8f98", "corridor": "#e08a1e", "nnpp": "#2f8fe0", "nnpp-fp32": "#2fa89a", "auto": "#c65bcf"}
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


def page(report: Facts, profile: Profile) -> str:
    """The page of a report, with example plans from the terrain of the profile that it was made by."""
    template = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template.filters |= {"number": _number, "percent": lambda share, digits=1: shown(share, f"z.{digits}%")}
    text = (files("nnpp_edge.viz") / _TEMPLATE).read_text(encoding="utf-8")
    examples = list(_examples(profile))
    return template.from_string(text).render(report=report, plots=list(_plots(report)), examples=examples)


def _examples(profile: Profile) -> Iterator[tuple[str, str]]:
    """Up to three plans of the learned region beside the optimum, of each workload, and what they show."""
    size, names = min(profile.load.sizes), profile.load.workloads[:_EXAMPLES]
    model = NetworkModel(profile.networks.int8, threads=profile.device.threads)
    maps, each = ProfileMaps(profile.load), -(-_EXAMPLES // len(names))

    def of_workload(name: str) -> Iterator[tuple[str, str]]:
        for on_map in islice(maps.maps(name, size), _TRIES):
            start, goal = on_map.queries[0].ends
            exact = Planner(on_map.cost).plan(start, goal, method=Method.ASTAR)
            if exact.ok:
                plan = Planner(on_map.cost, model=model).plan(start, goal, method=Method.NNPP, keep_regions=True)
                picture = plan_picture(on_map.cost, plan, start=start, goal=goal, reference_path=exact.path)
                above = f"nnpp, {100.0 * gap(plan.cost, exact.cost):.2f} % above the optimum"
                words = f"{name}, {size}²: {above}, {plan.expansions} of {exact.expansions} expansions"
                yield words, _data_uri(picture)

    return islice(chain.from_iterable(islice(of_workload(name), each) for name in names), _EXAMPLES)


def _data_uri(picture: Picture) -> str:
    factor = min(1.0, _WIDTH / picture.shape[1])
    small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    # few colours, evenly spaced: half the size, and no difference to the eye
    few = png_bytes((small.astype(np.int32) // 8 * 8 + 4).astype(np.uint8))
    return "data:image/png;base64," + base64.b64encode(few).decode()


def _number(value: float | None, unit: str = "") -> str:
    return shown(value) if value is None or unit in ("", "1") else f"{shown(value)} {unit}"


def _plots(report: Facts) -> Iterator[tuple[str, str, Markup]]:
    """Title, a sentence on how to read it, and the SVG, of each plot."""
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


def _svg(figure: Figure, title: str, prefix: str) -> Markup:
    """The figure as an element of a page: names of its own, the page's colour for ink; the page sets its width."""
    handles, names = figure.axes[-1].get_legend_handles_labels()
    narrow = {"columnspacing": 1.0, "handlelength": 1.4, "fontsize": 8.5}
    figure.legend(handles, names, loc="outside upper center", ncols=min(len(names), 5), **narrow)
    content = io.StringIO()
    figure.savefig(content, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = content.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r'(\sid="|url\(#|href="#)', rf"\g<1>{prefix}-", text).replace(_INK, "currentColor")
    text = re.sub(r'<svg([^>]*?) width="[^"]*" height="[^"]*"', r"<svg\1", text, count=1)
    return Markup(text.replace("<svg", f'<svg role="img" aria-label="{title}"', 1))


def _sizes(report: Facts) -> list[int]:
    return sorted({row["size"] for row in report["results"]})


def _planners(report: Facts) -> list[str]:
    return list(dict.fromkeys(row["planner"] for row in report["results"]))


def _panels(figure: Figure, report: Facts, height: float, columns: int = 2) -> Iterator[tuple[int, Axes]]:
    """A panel for each size, two side by side where there are several."""
    sizes = _sizes(report)
    columns = min(len(sizes), columns)
    rows = -(-len(sizes) // columns)
    figure.set_size_inches(_WIDE, height * rows + 0.6)
    for at, size in enumerate(sizes):
        axes = figure.add_subplot(rows, columns, at + 1)
        axes.set_title(f"{size}²", fontsize=10)
        yield size, axes


def _line(axes: Axes, name: str, x: ArrayLike, y: ArrayLike, **style: str | float) -> None:
    (line,) = axes.plot(x, y, "--" if name == "auto" else "-", color=_COLOURS[name], linewidth=1.8, label=name)
    line.set(**style)


def _stages(figure: Figure, report: Facts, first: str) -> None:
    planners, found = _planners(report), {stage for row in report["results"] for stage in row["stages_ms"]}
    for size, axes in _panels(figure, report, 0.24 * len(planners) + 0.75, columns=1):
        left = np.zeros(len(planners))
        rows = [find(report["results"], first, size, name) for name in planners]
        for stage in (*(s for s in STAGES if s in found), *sorted(found - set(STAGES))):
            spreads = [row["stages_ms"].get(stage) if row else None for row in rows]
            widths = np.array([spread["mean"] if spread else 0.0 for spread in spreads])
            axes.barh(planners, widths, left=left, color=_STAGE_COLOURS.get(stage, _UNKNOWN_STAGE), label=stage)
            left += widths
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.tick_params(axis="y", length=0)
    axes.set_xlabel("ms")


def _by_size(figure: Figure, report: Facts, first: str) -> None:
    figure.set_size_inches(_WIDE, 3.6)
    axes, sizes = figure.add_subplot(), _sizes(report)
    for name in _planners(report):
        rows = [row for size in sizes if (row := find(report["results"], first, size, name))]
        medians, p99 = ([row["time_ms"][key] for row in rows] for key in ("median", "p99"))
        _line(axes, name, sizes, medians, marker="o", markersize=4)
        axes.vlines(sizes, medians, p99, color=_COLOURS[name], linewidth=0.8)
    log_axis(axes, "x", base=2)
    log_axis(axes, "y")
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.set(xlabel="side of the map, cells", ylabel="ms")


def _pareto(figure: Figure, report: Facts, first: str) -> None:
    figure.set_size_inches(_WIDE, 3.8)
    axes, sizes, labelled = figure.add_subplot(), _sizes(report), set[str]()
    workloads = list(dict.fromkeys(row["workload"] for row in report["results"]))
    for row in report["results"]:
        if row["gap_mean"] is not None:
            name, marker = row["planner"], _MARKERS[workloads.index(row["workload"]) % len(_MARKERS)]
            (mark,) = axes.plot(row["time_ms"]["median"], 100.0 * row["gap_mean"], marker, color=_COLOURS[name])
            hollow = name == "auto"  # it lies on the method that it picks
            mark.set(markersize=(9 if hollow else 5) + 1.8 * sizes.index(row["size"]))
            mark.set(markerfacecolor="none" if hollow else _COLOURS[name])
            if name not in labelled:
                mark.set_label(name)
            labelled.add(name)
    for workload, marker in zip(workloads, _MARKERS * len(workloads), strict=False) if len(workloads) > 1 else ():
        axes.plot([], [], marker, color=_INK, markersize=5, label=workload)
    log_axis(axes, "x")
    axes.set(xlabel="median time of a plan, ms", ylabel="mean gap to the optimum, %")


def _distributions(figure: Figure, report: Facts, first: str) -> None:
    for size, axes in _panels(figure, report, 2.3):
        for name in _planners(report):
            if (row := find(report["results"], first, size, name)) is not None:
                times = np.sort(np.array(row["queries"]["time_ms"])[np.array(row["queries"]["judged"])])
                _line(axes, name, times, np.arange(1, len(times) + 1) / len(times), drawstyle="steps-post")
        log_axis(axes, "x")
        axes.set_xlabel("ms")


def _by_distance(figure: Figure, report: Facts, first: str) -> None:
    bins = bins_by_size(report["results"])
    for size, axes in _panels(figure, report, 2.3):
        for name in _planners(report):
            held = [each for each in bins[size] if each.times_ms[name]]
            medians = [float(np.median(each.times_ms[name])) for each in held]
            _line(axes, name, [max(each.first, 4) for each in held], medians, marker="o", markersize=3)
        log_axis(axes, "x", base=4)
        log_axis(axes, "y")
        axes.set(xlabel="cells apart, from", ylabel="ms")
