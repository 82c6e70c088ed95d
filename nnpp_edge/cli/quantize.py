"""`nnpp-edge quantize`: an int8 model, and whether it pays."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nnpp_edge.cli import options

if TYPE_CHECKING:
    from nnpp_edge.calibrate.quantize import QuantizeReport


@click.command(name="quantize")
@click.argument("model", type=options.PATH)
@click.option("--dataset", type=options.FOLDER, required=True, help="Data set to calibrate on.")
@click.option("--validation", type=options.FOLDER, help="Data set to judge on; by default held-out maps.")
@click.option("-o", "--output", type=options.NEW_FILE, required=True, help="The int8 ONNX file.")
@click.option("--samples", type=options.COUNT, default=200, help="Queries to calibrate on.")
@click.option("--exclude", type=options.Names(), default=(), help="Nodes to leave float, by name.")
@options.seed
@options.as_json
def command(model: Path, dataset: Path, output: Path, as_json: bool, **settings: Any) -> None:
    """Make an int8 model of MODEL (static, QDQ), and measure both on this machine.

    The head stays float. The report ends in a recommendation, which may be to keep fp32.

    \b
    nnpp-edge quantize edge.onnx --dataset data/train --validation data/val -o edge-int8.onnx
    """
    options.check_outputs(("--output", output))

    from nnpp_edge.calibrate.quantize import quantize

    report = quantize(model, dataset, output, **settings)
    click.echo(report.to_json() if as_json else render(report))


def render(r: "QuantizeReport") -> str:
    """The report as lines of text."""
    c = r.compared
    rows = [
        ("", "fp32", "int8"),
        ("size, MB", f"{r.fp32_bytes / 1e6:.2f}", f"{r.int8_bytes / 1e6:.2f}"),
        ("median, ms", f"{c.fp32_latency.median_ms:.2f}", f"{c.int8_latency.median_ms:.2f}"),
        ("p99, ms", f"{c.fp32_latency.p99_ms:.2f}", f"{c.int8_latency.p99_ms:.2f}"),
        ("cost gap, %", f"{100 * c.fp32.gap:.3f}", f"{100 * c.int8.gap:.3f}"),
        ("found in region, %", f"{100 * c.fp32.success:.1f}", f"{100 * c.int8.success:.1f}"),
        ("region, % of the map", f"{100 * c.fp32.region_share:.2f}", f"{100 * c.int8.region_share:.2f}"),
    ]
    return "\n".join(
        [
            f"{r.output}: calibrated on {r.samples} queries, compared on {c.queries} held-out ones",
            *(f"  {name:22}{one:>9}{other:>9}" for name, one, other in rows),
            f"  probabilities differ by {c.mean_difference:.4f} on average, {c.max_difference:.3f} at most; "
            f"region at td × {c.fp32.factor:g}",
            f"  {r.quantised} convolutions in int8, left float: {', '.join(('the head', *r.excluded))}",
            r.recommendation,
        ]
    )
