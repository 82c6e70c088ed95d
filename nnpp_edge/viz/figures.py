"""Figures of panels: the plots of a profile's page, and those of experiments."""

from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, NamedTuple

from nnpp_edge.profiling.compare import machine_words
from nnpp_edge.profiling.figures import stages_of
from nnpp_edge.profiling.inference import int8_in_words
from nnpp_edge.profiling.judge import IN_WORDS, measured, place, wanted
from nnpp_edge.profiling.rows import Facts
from nnpp_edge.progress import shown, with_unit
from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.errors import optional_module
from nnpp_edge.viz.picture import encoded

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TEMPLATE = "profile.html.j2"
_WIDE = 5.2
"""Inches: narrow enough for words to be read where a telephone shrinks the picture."""


class Curve(NamedTuple):
    """Numbers, or names, along both axes of a panel."""

    x: Sequence[object] | Floats
    y: Sequence[object] | Floats
    style: str = "o-"
    label: str = ""
    colour: str | None = None
    width: float = 1.5


class Panel(NamedTuple):
    """A panel of a chart."""

    title: str
    curves: Sequence[Curve]
    x: str = ""
    y: str = ""
    log: str = ""
    """The axes that are logarithmic."""
    draw: "Callable[[Axes], object] | None" = None
    """Draws a map, in place of curves."""


def chart(lines: Sequence[Sequence[Panel]], wide: float = 5.8) -> "Figure":
    """Lines of panels, so many inches wide, with a legend below; MissingExtraError without
    matplotlib.
    """
    kinds = optional_module("matplotlib.figure", "a figure", "viz")
    columns = max(map(len, lines))
    size = (wide * columns, 1.5 + 0.85 * wide * len(lines))
    figure: Figure = kinds.Figure(figsize=size, layout="constrained")
    legend: dict[str, Artist] = {}
    for line, places in zip(
        lines, figure.subplots(len(lines), columns, squeeze=False), strict=True
    ):
        for axes in places[len(line) :]:
            axes.set_visible(False)
        for axes, panel in zip(places, line, strict=False):
            axes.set_title(panel.title, fontsize="medium")
            axes.set(xlabel=panel.x, ylabel=panel.y, axisbelow=True)
            if panel.draw is None:
                axes.grid(alpha=0.25)
            else:
                panel.draw(axes)
            for axis in panel.log:
                axes.set(**{f"{axis}scale": "log"})
            for x, y, style, label, colour, width in panel.curves:
                (drawn,) = axes.plot(x, y, style, color=colour, linewidth=width, markersize=4)
                drawn.set_solid_capstyle("butt")
            handles, labels = axes.get_legend_handles_labels()
            legend = dict(zip(labels, handles, strict=True)) | legend
    if legend:
        figure.legend(
            [*legend.values()], [*legend], loc="outside lower center", ncols=4, frameon=False
        )
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
    sizes = sorted({row["size"] for row in rows})
    stages = [[_stages(rows, size)] for size in sizes]
    drawn = [("Time by stage", f"Mean of a plan on {first}, whole job.", stages)]
    if len(sizes) > 1:
        drawn.append(("Time against map size", by_size, [[_by_size(rows)]]))
    for title, words, panels in drawn:
        yield title, words, b64encode(encoded(chart(panels, _WIDE), dpi=200)).decode()


def _stages(rows: Sequence[Facts], size: int) -> Panel:
    """The stages of each planner's mean time, one after another."""
    curves = []
    for row in reversed(rows):
        left = 0.0
        for at, stage in enumerate(stages_of(rows)):
            spread = row["stages_ms"].get(stage)
            if row["size"] == size and spread:
                ends = [left, left + spread["mean"]]
                curves.append(Curve(ends, [row["planner"]] * 2, "-", stage, f"C{at}", 10.0))
                left = ends[1]
    return Panel(f"{size}²", curves, "ms")


def _by_size(rows: Sequence[Facts]) -> Panel:
    """Each planner's median time against the side of the map, and up to its slowest hundredth."""
    curves = []
    for at, name in enumerate(dict.fromkeys(row["planner"] for row in rows)):
        own = [row for row in rows if row["planner"] == name]
        medians = [row["time_ms"]["median"] for row in own]
        curves.append(Curve([row["size"] for row in own], medians, "o-", name, f"C{at}", 2.0))
        for row in own:
            times = [row["time_ms"]["median"], row["time_ms"]["p99"]]
            curves.append(Curve([row["size"]] * 2, times, "-", "", f"C{at}", 0.8))
    return Panel("", curves, "side of the map, cells", "median time of a query, ms", "xy")
