"""`nnpp-edge export`: a trained network as an ONNX model."""

import dataclasses
import json
from pathlib import Path

import click

from nnpp_edge.cli import options

_FACTOR = "Factor on the adaptive threshold that planners are to use with this model."
_DATASET = "What it was trained on, for the metadata and to compare torch and ONNX on."


@click.command(name="export")
@click.argument("checkpoint", type=options.PATH)
@click.option("-o", "--output", type=options.NEW_FILE, required=True, help="The ONNX file.")
@click.option("--name", help="Of the model, in its metadata; by default the output's name.")
@click.option("--region-factor", type=options.Real(0.0, 1.0, min_open=True), default=0.5, help=_FACTOR)
@click.option("--dataset", type=options.FOLDER, help=_DATASET)
@options.as_json
def command(
    checkpoint: Path,
    output: Path,
    name: str | None,
    region_factor: float,
    dataset: Path | None,
    as_json: bool,
) -> None:
    """Write CHECKPOINT as an ONNX model, and compare its probabilities with torch's.

    The exit code is 1 if they differ by more than 0.0001.

    \b
    nnpp-edge export runs/edge/checkpoint.pt -o edge.onnx --dataset data/train
    """
    options.check_outputs(("--output", output))

    from nnpp_edge.export.parity import parity
    from nnpp_edge.export.to_onnx import dataset_facts, export_network
    from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
    from nnpp_edge.terrain.dataset import read_recipe, read_samples
    from nnpp_edge.training.checkpoint import load_checkpoint

    recipe = read_recipe(dataset) if dataset else None
    saved = load_checkpoint(checkpoint)
    samples = read_samples(dataset, most_maps=64, size=saved.spec.input_size) if dataset else None
    network = saved.trained()
    made = export_network(
        network,
        output,
        name=name or output.stem,
        region_factor=region_factor,
        omega=recipe.omega if recipe else PAPER_OMEGA,
        limits=recipe.common_limits if recipe else None,
        training=saved.facts() | ({"dataset": dataset_facts(recipe)} if recipe else {}),
    )
    compared = parity(network, output, samples)
    if as_json:
        click.echo(json.dumps(dataclasses.asdict(made) | {"parity": dataclasses.asdict(compared)}))
    else:
        queries = "queries of the data set" if compared.inputs == "dataset" else "random queries"
        click.echo(
            f"{made.path}: {made.size_bytes / 1e6:.2f} MB, {made.nodes} nodes, "
            f"{made.macs / 1e6:.0f} million multiply-accumulates\n"
            f"  parity {'passed' if compared.passed else 'FAILED'}: largest difference {compared.max_difference:.1e} "
            f"of {compared.limit:.0e} allowed, over {compared.queries} {queries}"
        )
    if not compared.passed:
        click.get_current_context().exit(1)
