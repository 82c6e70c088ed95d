"""Pictures with matplotlib: training curves, the plots of a profile's page, and what all figures
share.
"""

import io
import math
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.files import write_whole
from nnpp_edge.profiling.compare import machine_words
from nnpp_edge.profiling.figures import stages_of
from nnpp_edge.profiling.inference import int8_in_words
from nnpp_edge.profiling.judge import IN_WORDS, measured, place, wanted
from nnpp_edge.profiling.rows import Facts
from nnpp_edge.progress import shown, with_unit
from nnpp_edge.runtime.errors import optional_module

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

_TEMPLATE = "profile.html.j2"
_WIDE = 5.2
"""Inches: narrow enough for words to be read where a telephone shrinks the picture."""


def training_curves(history: Sequence[dict[str, float]], path: Path) -> None:
    """Loss, and what the validations found, against training steps; a dotted line at the best."""
    panels = _FITS if "rmse_mean" in history[0] else _PANELS
    steps = [row["step"] for row in history]
    factors = {key.partition("@")[2] for key in history[0] if "@" in key}
    best = min(history, key=lambda row: row["score"])
    figure = new_figure(11.0, 6.5)
    for axes, (name, title, scale) in zip(figure.subplots(2, 2).flat, panels, strict=True):
        curves: dict[str, str | None] = {name: None}
        if name not in history[-1]:  # one for each factor
            largest_first = sorted(factors, key=float, reverse=True)
            curves = {f"{name}@{factor}": f"td × {factor}" for factor in largest_first}
        for key, label in curves.items():
            values = [scale * row.get(key, math.nan) for row in history]
            axes.plot(steps, values, marker="o", markersize=3, label=label)
        if axes.get_legend_handles_labels()[1]:
            axes.legend(fontsize="small")
        drawn = np.array([line.get_ydata() for line in axes.lines])
        logarithmic = name in ("loss", "gap") and (np.nan_to_num(drawn) > 0.0).any()
        axes.axvline(best["step"], color="0.6", linestyle=":")
        axes.set(title=title, xlabel="step", yscale="log" if logarithmic else "linear")
        axes.grid(alpha=0.3)
    write_whole(path, encoded(figure))


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure, so many inches wide and high; MissingExtraError without matplotlib."""
    kinds = optional_module("matplotlib.figure", "a figure", "viz")
    figure: Figure = kinds.Figure(figsize=(width, height), layout="constrained")
    return figure


def encoded(figure: "Figure", dpi: int = 110) -> bytes:
    """The figure as PNG."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    return content.getvalue()


def page(report: Facts) -> str:
    """A profile's report as one page of HTML that needs nothing else: style and plots
    stand in it. MissingExtraError without the extra `viz`.
    """
    jinja2 = optional_module("jinja2", "the page of a report", "viz")
    template = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters: dict[str, Callable[..., str]] = {
        "number": with_unit,
        "percent": lambda share, digits=1: shown(share, f"z.{digits}%"),
        "measured": measured,
        "wanted": wanted,
        "place": place,
        "int8_in_words": int8_in_words,
    }
    template.filters |= filters
    template.globals |= {"words": IN_WORDS, "machine": machine_words(report)}
    text = (files("nnpp_edge.viz") / _TEMPLATE).read_text(encoding="utf-8")
    page: str = template.from_string(text).render(report=report, plots=list(_plots(report)))
    return page


def _plots(report: Facts) -> Iterator[tuple[str, str, str]]:
    """Title, a sentence on how to read it, and the PNG in base64, of each plot, of the first
    workload; against the map's size only where there are several.
    """
    first = report["results"][0]["workload"]
    rows = [row for row in report["results"] if row["workload"] == first]
    by_size = f"On {first}: medians as lines, thin up to the slowest hundredth."
    drawn = [("Time by stage", f"Mean of a plan on {first}, whole job.", _stages)]
    if len({row["size"] for row in rows}) > 1:
        drawn.append(("Time against map size", by_size, _by_size))
    for title, words, draw in drawn:
        figure = new_figure(_WIDE, 3.7)
        draw(figure, rows)
        handles, names = figure.axes[-1].get_legend_handles_labels()
        figure.legend(
            handles,
            names,
            loc="outside upper center",
            ncols=min(len(names), 5),
            columnspacing=1.0,
            handlelength=1.4,
            fontsize=8.5,
            frameon=False,
        )
        yield title, words, b64encode(encoded(figure, dpi=200)).decode()


def _stages(figure: "Figure", rows: Sequence[Facts]) -> None:
    """Bars of the stages of each planner's mean time, a panel a size."""
    sizes = sorted({row["size"] for row in rows})
    figure.set_size_inches(_WIDE, 1.9 * len(sizes) + 0.6)
    for size, axes in zip(sizes, figure.subplots(len(sizes), squeeze=False).flat, strict=True):
        of_size = [row for row in rows if row["size"] == size]
        planners = [row["planner"] for row in of_size]
        left = np.zeros(len(of_size))
        for stage in stages_of(rows):
            spreads = [row["stages_ms"].get(stage) for row in of_size]
            widths = np.array([spread["mean"] if spread else 0.0 for spread in spreads])
            axes.barh(planners, widths, left=left, label=stage)
            left += widths
        axes.set_title(f"{size}²", fontsize=10)
        axes.invert_yaxis()
        axes.grid(axis="x", alpha=0.3)
    axes.set_xlabel("ms")


def _by_size(figure: "Figure", rows: Sequence[Facts]) -> None:
    """Each planner's median time against the side of the map, and up to its slowest hundredth."""
    axes = figure.add_subplot()
    medians: dict[str, dict[int, float]] = {}
    for row in rows:
        times = row["time_ms"]
        of_planner = medians.setdefault(row["planner"], {})
        of_planner[row["size"]] = times["median"]
        colour = f"C{[*medians].index(row['planner'])}"
        axes.vlines(row["size"], times["median"], times["p99"], color=colour, linewidth=0.8)
    for name, by_size in medians.items():
        axes.plot([*by_size], [*by_size.values()], "o-", linewidth=2.0, markersize=4, label=name)
    axes.set(xscale="log", yscale="log")
    axes.set(xlabel="side of the map, cells", ylabel="median time of a query, ms")
    sides = sorted({row["size"] for row in rows})
    axes.set_xticks(sides, [str(side) for side in sides])
    axes.set_xticks([], minor=True)
    axes.grid(alpha=0.3)
