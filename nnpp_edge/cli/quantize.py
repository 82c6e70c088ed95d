"""`nnpp-edge quantize`: an int8 model, and whether it pays."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.text import columns, table

if TYPE_CHECKING:
    from nnpp_edge.calibrate.quantize import Layer

_SIZE_AND_TIME = (
    "precision | MB: size_mb .2f | warm/ms: warm .3f | after a/plan, ms: after_plan .3f"
)
_REGION = "cost gap: gap z.3% | found in/region: success .1% | region, of/the map: region_share .2%"
_FIT = (
    "error of/mean T: rmse_mean .4f | blocked/share: rmse_blocked .4f | "
    "closed/chance: rmse_closed .4f"
)

_LAYERS = columns("layer | in | error/behind it: error .1%")
_WORST = 3
"""Layers in int8 that are listed, those with the largest errors."""


@options.command("quantize")
def command(
    model: Annotated[Path, options.PATH],
    /,
    dataset: Annotated[Path, options.FOLDER, "Data set to calibrate on."],
    output: Annotated[Path, "-o", options.NEW_FILE, "The int8 ONNX file."],
    validation: Annotated[
        Path | None, options.FOLDER, "Data set to judge on; by default held-out maps."
    ] = None,
    samples: Annotated[int, "Queries to calibrate on."] = 200,
    exclude: Annotated[tuple[str, ...], options.NAMES, "Nodes to leave float, by name."] = (),
    seed: options.Seed = 1,
    as_json: options.AsJson = False,
) -> None:
    """Make an int8 model of MODEL (static, QDQ), and measure both on this machine.

    The head stays float. The report ends in a recommendation, which may be to keep fp32.

    \b
    nnpp-edge quantize edge.onnx --dataset data/train --validation data/val -o edge-int8.onnx
    """
    options.check_outputs(("--output", output))

    from nnpp_edge.calibrate.quantize import quantize
    from nnpp_edge.training.unseen import Fit

    r = quantize(
        model, dataset, output, validation=validation, samples=samples, exclude=exclude, seed=seed
    )
    if as_json:
        click.echo(r.to_json())
        return
    c = r.compared
    judged_by = _FIT if isinstance(c.fp32, Fit) else _REGION
    shown_as = columns(f"{_SIZE_AND_TIME} | {judged_by}")
    rows = [
        {"precision": name, "size_mb": size / 1e6, **asdict(latency), **asdict(judged)}
        for name, size, latency, judged in (
            ("fp32", r.fp32_bytes, c.fp32_ms, c.fp32),
            ("int8", r.int8_bytes, c.int8_ms, c.int8),
        )
    ]
    held_out = f"{len(r.held_out_maps)} other maps of it, which --json lists"
    compared = f"compared on {c.queries} of {validation or held_out}"
    click.echo(f"{r.output}: calibrated on {r.samples} queries of {dataset}, {compared}")
    click.echo(table(rows, shown_as))
    region = "" if isinstance(c.fp32, Fit) else f"; region at td × {c.fp32.factor:g}"
    differ = f"{c.mean_difference:.4f} on average, {c.max_difference:.3f} at most"
    click.echo(f"answers differ by {differ}{region}")
    left = ", ".join(("the head", *r.excluded))
    click.echo(f"{r.quantised} convolutions in int8, left float: {left}")
    click.echo(_layers(r.layers))
    click.echo(r.recommendation)


def _layers(layers: Sequence["Layer"]) -> str:
    """The layers that are left float, and those in int8 with the largest errors behind them."""
    in_int8 = sorted((each for each in layers if each.quantised), key=lambda each: -each.error)
    left = [each for each in layers if not each.quantised]
    rows = [
        {"layer": each.name, "in": "int8" if each.quantised else "float", "error": each.error}
        for each in (*in_int8[:_WORST], *left)
    ]
    return table(rows, _LAYERS)
