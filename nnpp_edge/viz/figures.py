"""Figures of panels: the plots of a profile's page, and those of experiments."""

from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING

from nnpp_edge.profiling.compare import machine_words
from nnpp_edge.profiling.figures import stages_of
from nnpp_edge.profiling.judge import IN_WORDS, measured, place, wanted
from nnpp_edge.profiling.rows import Facts
from nnpp_edge.progress import shown, with_unit
from nnpp_edge.runtime.errors import optional_module
from nnpp_edge.viz.picture import encoded

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TEMPLATE = "profile.html.j2"
_WIDE = 5.2
"""Inches: narrow enough for words to be read where a telephone shrinks the picture."""


def panels(rows: int, columns: int, wide: float = 5.8) -> "tuple[Figure, list[Axes]]":
    """A figure with rows of panels, so many inches wide; MissingExtraError without matplotlib."""
    kinds = optional_module("matplotlib.figure", "a figure", "viz")
    size = (wide * columns, 1.5 + 0.85 * wide * rows)
    figure: Figure = kinds.Figure(figsize=size, layout="constrained")
    figure.subplots(rows, columns)
    for axes in figure.axes:
        axes.grid(alpha=0.25)
        axes.set_axisbelow(True)
    return figure, figure.axes


def with_legend(figure: "Figure") -> "Figure":
    """A legend below, which names each line once."""
    drawn: dict[str, Artist] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        drawn = dict(zip(labels, handles, strict=True)) | drawn
    figure.legend([*drawn.values()], [*drawn], loc="outside lower center", ncols=4, frameon=False)
    return figure


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
    sizes = sorted({row["size"] for row in rows})
    figure, places = panels(len(sizes), 1, _WIDE)
    for axes, size in zip(places, sizes, strict=True):
        _draw_stages(axes, rows, size)
    yield "Time by stage", f"Mean of a plan on {first}, whole job.", _in_page(figure)
    if len(sizes) > 1:
        figure, (axes,) = panels(1, 1, _WIDE)
        _draw_by_size(axes, rows)
        words = f"On {first}: medians as lines, thin up to the slowest hundredth."
        yield "Time against map size", words, _in_page(figure)


def _in_page(figure: "Figure") -> str:
    return b64encode(encoded(with_legend(figure), dpi=200)).decode()


def _draw_stages(axes: "Axes", rows: Sequence[Facts], size: int) -> None:
    """The stages of each planner's mean time, one after another."""
    stages = stages_of(rows)
    for row in reversed([row for row in rows if row["size"] == size]):
        left = 0.0
        for at, stage in enumerate(stages):
            if spread := row["stages_ms"].get(stage):
                mean = spread["mean"]
                name = row["planner"]
                axes.barh(name, mean, left=left, height=0.4, color=f"C{at}", label=stage)
                left += mean
    axes.set(title=f"{size}²", xlabel="ms")


def _draw_by_size(axes: "Axes", rows: Sequence[Facts]) -> None:
    """Each planner's median time against the side of the map, and up to its slowest hundredth."""
    for at, name in enumerate(dict.fromkeys(row["planner"] for row in rows)):
        own = [row for row in rows if row["planner"] == name]
        sizes = [row["size"] for row in own]
        medians = [row["time_ms"]["median"] for row in own]
        axes.plot(sizes, medians, "o-", color=f"C{at}", label=name)
        axes.vlines(sizes, medians, [row["time_ms"]["p99"] for row in own], colors=f"C{at}", lw=0.8)
    axes.set(xlabel="side of the map, cells", ylabel="median time of a query, ms")
    axes.set(xscale="log", yscale="log")
