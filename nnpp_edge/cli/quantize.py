"""`nnpp-edge quantize`: an int8 model, and whether it pays."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.text import aligned, columns, table

if TYPE_CHECKING:
    from nnpp_edge.profiling.int8 import QuantizeReport

_SIZE_AND_TIME = "precision | MB: size_mb .2f | after a plan,/one thread, ms: after_plan_ms .3f"
_REGION = (
    "region,/td ×: factor g | cost gap: gap z.3% | found in/region: success .1% | "
    "region, of/the map: region_share .2%"
)
_FIT = (
    "error of/mean T: rmse_mean .4f | blocked/share: rmse_blocked .4f | "
    "closed/chance: rmse_closed .4f"
)
_LAYERS = columns("layer: name | in: precision | error/behind it: error .1%")
_WORST = 5
"""Layers that are printed, those with the largest errors; the card has all."""


@options.command("quantize")
def command(
    model: Path,
    /,
    dataset: Annotated[Path, options.FOLDER, "Data set to calibrate on."],
    validation: Annotated[Path, options.FOLDER, "Data set of other maps, to judge on."],
    output: Annotated[Path, "-o", options.NEW_FILE, "The int8 ONNX file; its card is beside it."],
    samples: Annotated[int, "Queries to calibrate on."] = 200,
    exclude: Annotated[tuple[str, ...], options.NAMES, "Nodes to leave float, by name."] = (),
    most_gap: Annotated[
        float | None,
        options.NOT_NEGATIVE,
        "Percentage points that int8 may add to the mean gap; exit code 1 if it adds more.",
    ] = None,
    seed: options.Seed = 1,
    as_json: options.AsJson = False,
) -> None:
    """Make an int8 model of MODEL (static, QDQ), and measure both on this machine.

    The head stays float. A card, OUTPUT with .md, holds what is printed and the errors of all
    layers, the largest first: leave those float with --exclude.

    \b
    nnpp-edge quantize edge.onnx --dataset data/train --validation data/val -o edge-int8.onnx
    """
    options.check_outputs(("--output", output), ("the card", output.with_suffix(".md")))

    from nnpp_edge.profiling.int8 import quantize
    from nnpp_edge.runtime.network.model_file import read_model_file

    if most_gap is not None and read_model_file(model).metadata.encoding == "unseen":
        raise click.UsageError("--most-gap is for networks that answer queries")
    told = partial(_told, calibrated_on=dataset, judged_on=validation)
    r = quantize(
        model,
        dataset,
        output,
        validation=validation,
        samples=samples,
        exclude=exclude,
        seed=seed,
        card=partial(told, markdown=True),
    )
    click.echo(r.to_json() if as_json else told(r))
    added = r.compared.added_gap
    if most_gap is not None and not added <= most_gap:  # NaN where neither found a path
        click.echo(f"int8 adds {added:.3f} points to the mean gap, wanted {most_gap:g}", err=True)
        click.get_current_context().exit(1)


def _told(
    r: "QuantizeReport", calibrated_on: Path, judged_on: Path, *, markdown: bool = False
) -> str:
    """What was made, from what and on what, and its figures."""
    from nnpp_edge.profiling.machine import environment
    from nnpp_edge.runtime.network.model_file import read_model_file
    from nnpp_edge.training.unseen import Fit

    c = r.compared
    facts = {
        "left float": ", ".join(each.name for each in r.layers if not each.quantised),
        "made from": f"{r.source}, sha256 {read_model_file(r.source).sha256[:8]}",
        "calibrated": f"on {r.samples} queries of {calibrated_on}",
        "judged": f"on {c.queries} of {judged_on}",
        "timed": f"on {environment((0,))['cpu']}",
        "answers": f"differ by {c.mean_difference:.4f} on average, {c.max_difference:.3f} at most",
    }
    rows = [
        {"precision": name, "size_mb": size / 1e6, "after_plan_ms": ms, **asdict(judged)}
        for name, size, ms, judged in (
            ("fp32", r.fp32_bytes, c.fp32_ms, c.fp32),
            ("int8", r.int8_bytes, c.int8_ms, c.int8),
        )
    ]
    figures = columns(f"{_SIZE_AND_TIME} | {_FIT if isinstance(c.fp32, Fit) else _REGION}")
    layers = [
        asdict(each) | {"precision": "int8" if each.quantised else "float"} for each in r.layers
    ]
    head = f"{r.output}\n{aligned(facts)}"
    if markdown:
        lines = [
            f"# {Path(r.output).name}, int8",
            *(f"- {name}: {it}" for name, it in facts.items()),
        ]
        head = "\n".join(lines)
    else:
        layers = layers[:_WORST]
    tables = [table(*each, markdown=markdown) for each in ((rows, figures), (layers, _LAYERS))]
    return "\n\n".join([head, *tables])
