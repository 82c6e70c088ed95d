"""Charts of panels with matplotlib, and the page of a profile's report."""

import io
from collections.abc import Callable, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, NamedTuple

from nnpp_edge.profiling.compare import machine_words
from nnpp_edge.profiling.inference import int8_in_words
from nnpp_edge.profiling.judge import IN_WORDS, measured, place, wanted
from nnpp_edge.profiling.rows import Facts
from nnpp_edge.progress import shown, with_unit
from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.errors import optional_module

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

_TEMPLATE = "profile.html.j2"


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
    image: Floats | None = None
    """(H, W, 3) of a map, in whose cells the curves are."""


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
            axes.set_title(panel.title, fontsize="medium" if panel.image is None else "small")
            axes.set(xlabel=panel.x, ylabel=panel.y, axisbelow=True)
            if panel.image is None:
                axes.grid(alpha=0.25)
            else:
                axes.imshow(panel.image, interpolation="nearest")
                axes.set(xticks=[], yticks=[])
            for axis in panel.log:
                axes.set(**{f"{axis}scale": "log"})
            for x, y, style, label, colour, width in panel.curves:
                (drawn,) = axes.plot(x, y, style, color=colour, linewidth=width, markersize=4)
                drawn.set_solid_capstyle("butt")
                if label:
                    legend.setdefault(label, drawn)
    if legend:
        figure.legend(
            [*legend.values()], [*legend], loc="outside lower center", ncols=4, frameon=False
        )
    return figure


def encoded(figure: "Figure", dpi: int) -> bytes:
    """The figure as PNG."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    return content.getvalue()


def page(report: Facts) -> str:
    """A profile's report as one page of HTML that needs nothing else. MissingExtraError without
    the extra `viz`.
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
    page: str = template.from_string(text).render(report=report)
    return page
