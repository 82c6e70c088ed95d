"""`nnpp-edge models`: the shipped models, and what is known of one."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from nnpp_edge.cli import options

if TYPE_CHECKING:
    from nnpp_edge.runtime.network.model_file import Figures, ModelFile

_PURPOSES = {
    "edge": "planning on board; the default of --method nnpp",
    "edge-fp32": "edge before quantisation, from which quantize shows its work",
    "paper": "the paper's network, to reproduce its experiments",
}
_SIZE = 256
"""Side of the maps whose figures stand in the list."""
_MISSING = "–"
_FIGURES = {
    "first\nregion": ("success_raw", ".1%"),
    "after\nfallback": ("success", ".1%"),
    "gap\nmean": ("gap_mean", ".2%"),
    "gap\np99": ("gap_p99", ".2%"),
    "ms\nmedian": ("time_ms_median", ".2f"),
    "ms\np99": ("time_ms_p99", ".2f"),
    "speed-up\nmedian": ("speedup_median", ".2f"),
    "speed-up\ntotal": ("speedup_total", ".2f"),
    "MM": ("mm_mean", ".3f"),
}
"""Title of each figure, its key in a row, and how it is shown."""


@click.command(name="models")
@click.argument("model", required=False, metavar="[NAME|FILE]")
@options.as_json
def command(model: str | None, as_json: bool) -> None:
    """List the shipped models, or show one in full.

    NAME is that of a shipped model, FILE any ONNX model that the toolkit wrote. What is shown stands in the
    file and in two files beside it: NAME.json, what was measured, and NAME.md, the model's card. The network
    is not loaded.

    \b
    nnpp-edge models
    nnpp-edge models edge
    """
    from nnpp_edge.runtime.network.model_file import list_models, read_model_file

    if model is None:
        listed = list_models()
        told = [found.summary() | {"purpose": _PURPOSES.get(found.name)} for found in listed]
        click.echo(json.dumps(told, indent=1) if as_json else table(listed))
        return
    found = read_model_file(model)
    click.echo(json.dumps({**found.summary(), "card": found.card}, indent=1) if as_json else text(found))


def table(listed: "Sequence[ModelFile]") -> str:
    """The models for people, one a row."""
    from nnpp_edge.progress import render_table

    titles = ("first\nregion", "gap\nmean", "ms\nmedian")
    rows = [
        [
            found.name,
            _PURPOSES.get(found.name, _MISSING),
            found.metadata.precision,
            f"{found.size_bytes / 1e6:.2f}",
            *(_span(found, *_FIGURES[title]) for title in titles),
            found.sha256[:8],
        ]
        for found in listed
    ]
    head = ("name", "for", "precision", "MB", *titles, "sha256")
    return (
        f"{render_table(head, rows)}\n"
        f"First region, gap and ms are the least and the greatest of the workloads at {_SIZE}².\n"
        "`nnpp-edge models NAME` shows one in full."
    ).strip("\n")


def text(found: "ModelFile") -> str:
    """All that is known of one model, for people."""
    from nnpp_edge.model.registry import architecture_name

    head = {
        "model": found.name,
        "file": str(found.path),
        "size": f"{found.size_bytes / 1e6:.2f} MB",
        "sha256": found.sha256,
    }
    metadata = asdict(found.metadata) | {"architecture": architecture_name(found.metadata.architecture)}
    parts = [_aligned(head.items()), "metadata\n" + _aligned(_flat(metadata), "  ")]
    parts.append(f"figures     {_MISSING}" if found.figures is None else _figures(found.figures))
    return "\n\n".join([*parts, *([found.card.strip()] if found.card else [])])


def _figures(figures: "Figures") -> str:
    """The rows as a table, then where they come from."""
    from nnpp_edge.progress import render_table

    body = [
        [str(row["workload"]), f"{row['size']}²", str(row["method"]), str(row["n"])]
        + [_shown(row[key], form) for key, form in _FIGURES.values()]
        for row in figures.rows
    ]
    places = [(row["workload"], row["size"]) for row in figures.rows]
    starts = [at == 0 or place != places[at - 1] for at, place in enumerate(places)]
    source = "\n".join([f"measured on {figures.machine}, by", *(f"  {line}" for line in figures.commands)])
    grid = render_table(["workload", "size", "method", "n", *_FIGURES], body, starts).strip("\n")
    return f"{grid}\n\n{source}"


def _shown(value: str | float | None, form: str) -> str:
    """One figure; a space before the sign of percent."""
    return _MISSING if value is None else format(value, form).replace("%", " %")


def _span(found: "ModelFile", key: str, form: str) -> str:
    """Least and greatest of one figure, of the model's own rows at the listed size."""
    rows = found.figures.rows if found.figures else []
    own = [row[key] for row in rows if row["size"] == _SIZE and row["method"] in ("nnpp", f"nnpp:{found.name}")]
    values = [value for value in own if isinstance(value, int | float)]
    if not values:
        return _MISSING
    least, greatest = (_shown(value, form) for value in (min(values), max(values)))
    return least if least == greatest else f"{least.removesuffix(' %')}–{greatest}"


def _aligned(lines: Iterable[tuple[str, str]], indent: str = "") -> str:
    """Names and values in two columns."""
    pairs = list(lines)
    width = max(12, *(len(name) + 2 for name, _ in pairs))
    return "\n".join(f"{indent}{name:<{width}}{value}" for name, value in pairs)


def _flat(value: object, name: str = "") -> Iterator[tuple[str, str]]:
    """Nested facts as lines, names joined by dots."""
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | tuple) and value:
        yield name, ", ".join(" ".join(map(str, v)) if isinstance(v, list | tuple) else str(v) for v in value)
    else:
        yield name, _MISSING if value in (None, "", {}, [], ()) else str(value)
