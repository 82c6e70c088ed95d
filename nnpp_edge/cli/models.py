"""`nnpp-edge models`: the shipped models, and what is known of one."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

from nnpp_edge.cli import options
from nnpp_edge.cli.text import aligned, columns, tell
from nnpp_edge.cli.text import table as table_of
from nnpp_edge.progress import MISSING, shown

if TYPE_CHECKING:
    from nnpp_edge.runtime.network.model_file import ModelFile

_PURPOSES = {
    "edge": "planning on board; the default of --method nnpp",
    "edge-fp32": "edge before quantisation, from which quantize shows its work",
    "paper": "the paper's network, to reproduce its experiments",
}
_SIZE = 256
"""Side of the maps whose figures stand in the list."""
_COLUMNS = {
    **columns("workload | size: size ² | method | n"),
    **columns("first/region: success_raw .1% | after/fallback: success .1% | gap/mean: gap_mean .2%"),
    **columns("gap/p99: gap_p99 .2% | ms/median: time_ms_median .2f | ms/p99: time_ms_p99 .2f"),
    **columns("speed-up/median: speedup_median .2f | speed-up/total: speedup_total .2f | MM: mm_mean .3f"),
}
_LISTED = ("first\nregion", "gap\nmean", "ms\nmedian")


@options.command("models")
def command(
    model: Annotated[str | None, {"metavar": "[NAME|FILE]"}] = None, /, as_json: options.AsJson = False
) -> None:
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
        tell(as_json, told, lambda: table(listed), indent=1)
        return
    found = read_model_file(model)
    tell(as_json, {**found.summary(), "card": found.card}, lambda: text(found), indent=1)


def table(listed: "Sequence[ModelFile]") -> str:
    """The models for people, one a row."""
    rows = [
        {
            "name": found.name,
            "for": _PURPOSES.get(found.name),
            "precision": found.metadata.precision,
            "MB": f"{found.size_bytes / 1e6:.2f}",
            **{title: _span(found, *_COLUMNS[title].split()) for title in _LISTED},
            "sha256": found.sha256[:8],
        }
        for found in listed
    ]
    return (
        f"{table_of(rows, {title: title for title in rows[0]})}\n\n"
        f"First region, gap and ms are the least and the greatest of the workloads at {_SIZE}².\n"
        "`nnpp-edge models NAME` shows one in full."
    )


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
    parts = [aligned(head), "metadata\n" + aligned(dict(_flat(metadata)), "  ")]
    if figures := found.figures:
        parts.append(table_of(figures.rows, _COLUMNS))
        parts.append("\n".join([f"measured on {figures.machine}, by", *(f"  {line}" for line in figures.commands)]))
    else:
        parts.append(aligned({"figures": MISSING}))
    return "\n\n".join([*parts, *([found.card.strip()] if found.card else [])])


def _span(found: "ModelFile", key: str, form: str) -> str:
    """Least and greatest of one figure, of the model's own rows at the listed size."""
    rows = found.figures.rows if found.figures else []
    own = [row[key] for row in rows if row["size"] == _SIZE and row["method"] in ("nnpp", f"nnpp:{found.name}")]
    values = [value for value in own if isinstance(value, int | float)]
    if not values:
        return MISSING
    least, greatest = (shown(value, form) for value in (min(values), max(values)))
    return least if least == greatest else f"{least.removesuffix(' %')}–{greatest}"


def _flat(value: object, name: str = "") -> Iterator[tuple[str, str]]:
    """Nested facts as lines, names joined by dots."""
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | tuple) and value:
        yield name, ", ".join(" ".join(map(str, v)) if isinstance(v, list | tuple) else str(v) for v in value)
    else:
        yield name, MISSING if value in (None, "", {}, [], ()) else str(value)
