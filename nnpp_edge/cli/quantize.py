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
    c, both = r.compared, (r.compared.fp32, r.compared.int8)
    times = c.fp32_latency, c.int8_latency
    rows = (
        ("", "fp32", "int8"),
        ("size, MB", *(f"{size / 1e6:.2f}" for size in (r.fp32_bytes, r.int8_bytes))),
        ("median, ms", *(f"{time.median_ms:.2f}" for time in times)),
        ("p99, ms", *(f"{time.p99_ms:.2f}" for time in times)),
        ("cost gap, %", *(f"{100 * judged.gap:.3f}" for judged in both)),
        ("found in region, %", *(f"{100 * judged.success:.1f}" for judged in both)),
        ("region, % of the map", *(f"{100 * judged.region_share:.2f}" for judged in both)),
    )
    lines = [
        f"{r.output}: calibrated on {r.samples} queries, compared on {c.queries} held-out ones",
        *(f"  {name:22}{one:>9}{other:>9}" for name, one, other in rows),
        f"  probabilities differ by {c.mean_difference:.4f} on average, {c.max_difference:.3f} at most; "
        f"region at td × {c.fp32.factor:g}",
        f"  {r.quantised} convolutions in int8, left float: {', '.join(('the head', *r.excluded))}",
        r.recommendation,
    ]
    return "\n".join(lines)
