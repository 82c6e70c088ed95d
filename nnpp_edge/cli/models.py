"""`nnpp-edge models`: the shipped models, and what is known of one."""

import json
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import click

from nnpp_edge.cli import options

if TYPE_CHECKING:
    from nnpp_edge.runtime.network.model_file import Figures, ModelFile

_SIZE = 256
"""Side of the maps whose figures stand in the list."""

_HEADER = (
    "name", "preci-\nsion", "archi-\ntecture", "MB", "input", "blocks", "enco-\nding", "σ", "ω", "region\nfactor",
    "trained\nmaps", "first\nregion", "gap\nmean", "ms\nmedian", "sha256",
)  # fmt: skip
_FIGURES_HEADER = (
    "workload", "size", "method", "n", "first\nregion", "after\nfallback", "gap\nmean", "gap\np99", "ms\nmedian",
    "ms\np99", "speed-up\nmedian", "speed-up\ntotal", "MM",
)  # fmt: skip


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
        click.echo(json.dumps([found.summary() for found in listed], indent=1) if as_json else table(listed))
        return
    found = read_model_file(model)
    click.echo(json.dumps({**found.summary(), "card": found.card}, indent=1) if as_json else text(found))


def table(listed: "Sequence[ModelFile]") -> str:
    """The models for people, one a row."""
    from nnpp_edge.progress import render_table

    body = []
    for found in listed:
        m = found.metadata
        body.append([
            found.name, m.precision, m.architecture, _megabytes(found), str(m.input_size), str(m.blocks), m.encoding,
            f"{m.sigma:g}", f"{m.omega:g}", f"{m.region_factor:g}", _trained_maps(m.training),
            _span(found, "success_raw", 100.0, ".1f", " %"), _span(found, "gap_mean", 100.0, ".2f", " %"),
            _span(found, "time_ms_median", 1.0, ".2f"), found.sha256[:8],
        ])  # fmt: skip
    lines = [render_table(_HEADER, body).strip("\n"), ""]
    if any(_own_rows(found, _SIZE) for found in listed):
        lines.append(f"First region, gap and ms are the least and the greatest of the workloads at {_SIZE}².")
    lines.append("`nnpp-edge models NAME` tells more.")
    return "\n".join(lines)


def text(found: "ModelFile") -> str:
    """All that is known of one model, for people."""
    head = {
        "model": found.name, "file": str(found.path), "size": f"{_megabytes(found)} MB", "sha256": found.sha256,
        "producer": found.producer or "–", "inputs": _shapes(found.inputs), "outputs": _shapes(found.outputs),
    }  # fmt: skip
    parts = [_aligned(head), "metadata\n" + _aligned(dict(_flat(found.metadata.facts())), "  ")]
    parts.append("figures     –" if found.figures is None else _figures(found.figures))
    if found.card is not None:
        parts.append(found.card.strip())
    return "\n\n".join(parts)


def _figures(figures: "Figures") -> str:
    """The rows as a table, then where they come from."""
    from nnpp_edge.progress import render_table

    def shown(value: Any, digits: int) -> str:
        return "–" if value is None else f"{value:.{digits}f}"

    def percent(value: Any, digits: int) -> str:
        return "–" if value is None else f"{100.0 * value:.{digits}f} %"

    body = [
        [
            row["workload"], f"{row['size']}²", row["method"], str(row["n"]),
            *(percent(row[key], 1) for key in ("success_raw", "success")),
            *(percent(row[key], 2) for key in ("gap_mean", "gap_p99")),
            *(shown(row[key], 2) for key in ("time_ms_median", "time_ms_p99", "speedup_median", "speedup_total")),
            shown(row["mm_mean"], 3),
        ]
        for row in figures.rows
    ]  # fmt: skip
    places = [(row["workload"], row["size"]) for row in figures.rows]
    starts = [at == 0 or place != places[at - 1] for at, place in enumerate(places)]
    told = "\n".join([f"measured on {figures.machine}, by", *(f"  {line}" for line in figures.commands)])
    grid = render_table(_FIGURES_HEADER, body, starts).strip("\n")
    return f"{grid}\n\n{told}"


def _own_rows(found: "ModelFile", size: int) -> list[dict[str, Any]]:
    """The rows of figures that are the model's own, not another planner's."""
    rows = [] if found.figures is None else found.figures.rows
    return [row for row in rows if row["size"] == size and row["method"] in ("nnpp", f"nnpp:{found.name}")]


def _span(found: "ModelFile", key: str, factor: float, form: str, unit: str = "") -> str:
    """Least and greatest of one figure."""
    values = [factor * row[key] for row in _own_rows(found, _SIZE) if row[key] is not None]
    if not values:
        return "–"
    ends = dict.fromkeys(format(value, form) for value in (min(values), max(values)))
    return "–".join(ends) + unit


def _trained_maps(training: dict[str, Any]) -> str:
    dataset = training.get("dataset")
    return str(dataset.get("maps", "–")) if isinstance(dataset, dict) else "–"


def _megabytes(found: "ModelFile") -> str:
    return f"{found.size_bytes / 1e6:.2f}"


def _shapes(tensors: dict[str, tuple[int | str, ...]]) -> str:
    return ", ".join(f"{name} ({', '.join(map(str, shape))})" for name, shape in tensors.items()) or "–"


def _aligned(lines: dict[str, str], indent: str = "") -> str:
    width = max(12, *(len(name) + 2 for name in lines))
    return "\n".join(f"{indent}{name:<{width}}{value}" for name, value in lines.items())


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Nested facts as lines, names joined by dots."""
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | tuple) and value:
        yield name, ", ".join(" ".join(map(str, v)) if isinstance(v, list | tuple) else str(v) for v in value)
    else:
        yield name, "–" if value in (None, "", {}, [], ()) else str(value)
