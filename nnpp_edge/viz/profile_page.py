"""A profile's report as one page of HTML that needs nothing else: style, plots and pictures stand in it.

Plots are SVG without a background, with text in the page's own colour, so that one drawing serves a light and a dark
page; colours of planners and stages are of middling lightness.
"""

import base64
import io
import re
from collections.abc import Iterator, Sequence
from importlib.resources import files
from itertools import chain, islice
from typing import Any

import cv2
import matplotlib
import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from nnpp_edge.profiling.contest import Facts, gap
from nnpp_edge.profiling.figures import STAGES
from nnpp_edge.profiling.profile_file import Profile
from nnpp_edge.profiling.profile_maps import ProfileMaps
from nnpp_edge.progress import shown
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Method
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.viz.figures import draw_times, log_axis
from nnpp_edge.viz.picture import plan_picture, png_bytes
from nnpp_edge.viz.sheet import Picture

_TEMPLATE = "profile.html.j2"
_EXAMPLES = 3
_TRIES = 20
_WIDTH = 640
"""Pixels of an example's picture."""
_INK = "#010203"
"""Drawn with, and replaced by the page's own colour."""
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
            start, goal = on_map.queries[0]
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
    """Title, a sentence on how to read it, and the SVG, of each plot, of the first workload."""
    first = report["results"][0]["workload"]
    rows = [row for row in report["results"] if row["workload"] == first]
    drawn = (
        ("Time by stage", f"Mean of a plan on {first}, whole job.", _stages),
        ("Time against map size", f"On {first}: medians as lines, thin up to the slowest hundredth.", _by_size),
        ("Cost gap against time", f"On {first}; left and down is better. The larger the map, the larger.", _pareto),
    )
    for number, (title, words, draw) in enumerate(drawn):
        with matplotlib.rc_context(_STYLE):
            figure = Figure((_WIDE, 3.7), layout="constrained")
            draw(figure, rows)
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


def _by_planner(rows: Sequence[Facts]) -> dict[str, list[Facts]]:
    names = dict.fromkeys(row["planner"] for row in rows)
    return {name: [row for row in rows if row["planner"] == name] for name in names}


def _stages(figure: Figure, rows: Sequence[Facts]) -> None:
    found, sizes = {stage for row in rows for stage in row["stages_ms"]}, sorted({row["size"] for row in rows})
    figure.set_size_inches(_WIDE, 1.9 * len(sizes) + 0.6)
    for size, axes in zip(sizes, figure.subplots(len(sizes), squeeze=False).flat, strict=True):
        of_size = [row for row in rows if row["size"] == size]
        left = np.zeros(len(of_size))
        for stage in (*(stage for stage in STAGES if stage in found), *sorted(found - set(STAGES))):
            widths = np.array([row["stages_ms"].get(stage, {"mean": 0.0})["mean"] for row in of_size])
            axes.barh([row["planner"] for row in of_size], widths, left=left, label=stage)
            left += widths
        axes.set_title(f"{size}²", fontsize=10)
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
    axes.set_xlabel("ms")


def _by_size(figure: Figure, rows: Sequence[Facts]) -> None:
    axes = figure.add_subplot()
    medians = {name: {row["size"]: row["time_ms"]["median"] for row in of} for name, of in _by_planner(rows).items()}
    draw_times(axes, medians)
    for at, of in enumerate(_by_planner(rows).values()):
        for row in of:
            axes.vlines(row["size"], row["time_ms"]["median"], row["time_ms"]["p99"], color=f"C{at}", linewidth=0.8)


def _pareto(figure: Figure, rows: Sequence[Facts]) -> None:
    axes = figure.add_subplot()
    for at, (name, of) in enumerate(_by_planner(rows).items()):
        known = [row for row in of if row["gap_mean"] is not None]
        ms, gaps = [row["time_ms"]["median"] for row in known], [100.0 * row["gap_mean"] for row in known]
        filled = "none" if name == "auto" else f"C{at}"  # it lies on the method that it picks
        sizes = [25.0 * (number + 1) for number in range(len(known))]
        axes.scatter(ms, gaps, sizes, label=name, facecolors=filled, edgecolors=f"C{at}")
    log_axis(axes, "x")
    axes.set(xlabel="median time of a plan, ms", ylabel="mean gap to the optimum, %")
