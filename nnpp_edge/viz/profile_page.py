"""A profile's report as one page of HTML that needs nothing else: style and plots stand in it.

Plots are SVG without a background, with text in the page's own colour, so that one drawing serves a light and a dark
page; colours of planners and stages are of middling lightness.
"""

import io
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Any

import matplotlib
import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from nnpp_edge.profiling.contest import Facts
from nnpp_edge.profiling.figures import STAGES
from nnpp_edge.progress import shown
from nnpp_edge.viz.figures import draw_times

_TEMPLATE = "profile.html.j2"
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


def page(report: Facts) -> str:
    """The page of a report."""
    template = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template.filters |= {"number": _number, "percent": lambda share, digits=1: shown(share, f"z.{digits}%")}
    text = (files("nnpp_edge.viz") / _TEMPLATE).read_text(encoding="utf-8")
    return template.from_string(text).render(report=report, plots=list(_plots(report)))


def _number(value: float | None, unit: str = "") -> str:
    return shown(value) if value is None or unit in ("", "1") else f"{shown(value)} {unit}"


def _plots(report: Facts) -> Iterator[tuple[str, str, Markup]]:
    """Title, a sentence on how to read it, and the SVG, of each plot, of the first workload."""
    first = report["results"][0]["workload"]
    rows = [row for row in report["results"] if row["workload"] == first]
    drawn = (
        ("Time by stage", f"Mean of a plan on {first}, whole job.", _stages),
        ("Time against map size", f"On {first}: medians as lines, thin up to the slowest hundredth.", _by_size),
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
    axes, medians = figure.add_subplot(), defaultdict[str, dict[int, float]](dict)
    for row in rows:
        medians[row["planner"]][row["size"]] = row["time_ms"]["median"]
        color = f"C{[*medians].index(row['planner'])}"
        axes.vlines(row["size"], row["time_ms"]["median"], row["time_ms"]["p99"], color=color, linewidth=0.8)
    draw_times(axes, medians)
