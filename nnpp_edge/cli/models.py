"""`nnpp-edge models`: the shipped models, and what is known of one."""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

from nnpp_edge.cli import options
from nnpp_edge.cli.text import Columns, aligned, columns, table, tell

if TYPE_CHECKING:
    from nnpp_edge.runtime.network.model_file import ModelFile

_PURPOSES = {
    "edge": "planning on board; the default of --method nnpp",
    "edge-fp32": "edge before quantisation",
    "edge-untrained": "control of edge: the same after three steps of training",
    "unseen": "costs of ground that is known from a coarse map only",
    "paper": "the paper's network, to reproduce its experiments",
}
_LISTED: Columns = {
    **columns("name | for: purpose | precision: metadata.precision"),
    "MB": lambda row: f"{row['size_bytes'] / 1e6:.2f}",
    "sha256": lambda row: str(row["sha256"][:8]),
}


@options.command("models")
def command(
    model: Annotated[str | None, {"metavar": "[NAME|FILE]"}] = None,
    /,
    as_json: options.AsJson = False,
) -> None:
    """List the shipped models, or show one in full.

    NAME is that of a shipped model, FILE any ONNX model that the toolkit wrote. It shows the file's
    metadata and NAME.md beside it, the model's card with the measurements. The network is not
    loaded.

    \b
    nnpp-edge models
    nnpp-edge models edge
    """
    from nnpp_edge.runtime.network.model_file import list_models, read_model_file

    if model is None:
        told = [found.summary() | {"purpose": _PURPOSES.get(found.name)} for found in list_models()]
        words = "\n\n`nnpp-edge models NAME` shows one in full."
        tell(as_json, told, lambda: table(told, _LISTED) + words, indent=1)
        return
    found = read_model_file(model)
    tell(as_json, {**found.summary(), "card": found.card}, lambda: _text(found), indent=1)


def _text(found: "ModelFile") -> str:
    """All that is known of one model, for people."""
    from nnpp_edge.model.registry import architecture_name

    head = {
        "model": found.name,
        "file": str(found.path),
        "size": f"{found.size_bytes / 1e6:.2f} MB",
        "sha256": found.sha256,
    }
    metadata = asdict(found.metadata) | {
        "architecture": architecture_name(found.metadata.architecture)
    }
    parts = [
        aligned(head),
        f"metadata\n{json.dumps(metadata, indent=1, ensure_ascii=False)}",
        (found.card or "").strip(),
    ]
    return "\n\n".join(filter(None, parts))
