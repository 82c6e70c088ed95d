"""`nnpp-edge quantize`: an int8 model, and whether it pays."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nnpp_edge.cli import options

if TYPE_CHECKING:
    from nnpp_edge.calibrate.quantize import QuantizeReport

_METHOD = click.Choice(["minmax", "percentile", "entropy"])
_EXCLUDE = "Nodes to leave float; auto leaves the worst ones, if the probabilities differ too much."
_FULL_RANGE = "Weights of 8 bits in place of 7: for CPUs with VNNI, or ARM; others saturate."


@click.command(name="quantize")
@click.argument("model", type=options.PATH)
@click.option("--dataset", type=options.FOLDER, required=True, help="Data set to calibrate on.")
@click.option("--validation", type=options.FOLDER, help="Data set to judge on; by default held-out maps.")
@click.option("-o", "--output", type=options.NEW_FILE, required=True, help="The int8 ONNX file.")
@click.option("--samples", type=options.COUNT, default=200, help="Queries to calibrate on.")
@click.option("--method", type=_METHOD, default="minmax", help="How the range of each tensor is chosen.")
@click.option("--exclude", type=options.Names(), default="auto", help=_EXCLUDE)
@click.option("--full-range", is_flag=True, help=_FULL_RANGE)
@click.option("--rank", is_flag=True, help="Print how sensitive each node is.")
@options.seed
@options.as_json
def command(
    model: Path,
    dataset: Path,
    output: Path,
    exclude: tuple[str, ...],
    full_range: bool,
    as_json: bool,
    **settings: Any,
) -> None:
    """Make an int8 model of MODEL (static, QDQ), and measure both on this machine.

    The head stays float. The report ends in a recommendation, which may be to keep fp32.

    \b
    nnpp-edge quantize edge.onnx --dataset data/train --validation data/val -o edge-int8.onnx
    """
    options.check_outputs(("--output", output))

    from nnpp_edge.calibrate.quantize import AUTO, quantize

    left_float = AUTO if exclude == (AUTO,) else exclude
    report = quantize(model, dataset, output, exclude=left_float, reduce_range=not full_range, **settings)
    click.echo(report.to_json() if as_json else render(report))


def render(r: "QuantizeReport") -> str:
    """The report as lines of text."""
    rows = [("", "fp32", "int8")]
    rows.append(("size, MB", f"{r.fp32_bytes / 1e6:.2f}", f"{r.int8_bytes / 1e6:.2f}"))
    rows.append(("median, ms", f"{r.fp32_latency.median_ms:.2f}", f"{r.int8_latency.median_ms:.2f}"))
    rows.append(("p99, ms", f"{r.fp32_latency.p99_ms:.2f}", f"{r.int8_latency.p99_ms:.2f}"))
    a, b = r.searches.fp32, r.searches.int8
    rows.append(("cost gap, %", f"{100 * a.gap:.3f}", f"{100 * b.gap:.3f}"))
    rows.append(("found in region, %", f"{100 * a.success:.1f}", f"{100 * b.success:.1f}"))
    rows.append(("region, % of the map", f"{100 * a.region_share:.2f}", f"{100 * b.region_share:.2f}"))
    lines = [
        f"{r.output}: calibrated on {r.samples} queries ({r.method}, {'7' if r.reduce_range else '8'}-bit weights)"
    ]
    lines += [f"  {name:22}{one:>9}{other:>9}" for name, one, other in rows]
    lines.append(f"  searches: {r.searches.queries} held-out queries, region at td × {r.region_factor:g}")
    lines.append(
        f"  agreement over {r.agreement.queries} held-out queries: mean |Δp| {r.agreement.mean_difference:.4f}, "
        f"max {r.agreement.max_difference:.3f}, {100 * r.agreement.same_side:.2f} % of the blocks on the same side"
    )
    lines.append(
        f"  {r.quantised} convolutions in int8, left float: {', '.join(('the head', *r.excluded))}; "
        f"{r.qdq_left} Q/DQ nodes left after optimisation"
    )
    if r.node_snr_db:
        lines.append("  signal to noise when one node alone is int8, dB (worst first):")
        lines += [f"    {value:6.1f}  {name}" for name, value in r.node_snr_db.items()]
    lines.append(r.recommendation)
    return "\n".join(lines)
