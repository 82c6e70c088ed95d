"""`nnpp-edge export`: a trained network as an ONNX model."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.text import tell

_PARITY = (
    "largest difference {max_difference:.1e} of {limit:.0e} allowed, over {queries} random queries"
)


@options.command("export")
def command(
    checkpoint: Path,
    /,
    output: Annotated[Path, "-o", options.NEW_FILE, "The ONNX file."],
    name: Annotated[
        str | None, "Of the model, in its metadata; by default the output's name."
    ] = None,
    region_factor: Annotated[
        float | None,
        options.Real(0.0, 1.0, min_open=True),
        (
            "Factor on the adaptive threshold that planners are to use with this model; by default"
            " that at which the best weights were chosen, 0.2 for edge and 0.5 for the others."
        ),
    ] = None,
    dataset: Annotated[
        Path | None,
        options.FOLDER,
        "The training's data set, for the metadata.",
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Write CHECKPOINT as an ONNX model, and compare its probabilities with torch's.

    The exit code is 1 if they differ by more than 0.0001.

    \b
    nnpp-edge export runs/edge/best.pt -o edge.onnx --dataset data/train
    """
    options.check_outputs(("--output", output))

    from nnpp_edge.export.to_onnx import dataset_facts, export_network, parity
    from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA
    from nnpp_edge.terrain.dataset import read_recipe
    from nnpp_edge.training.checkpoint import load_checkpoint

    recipe = read_recipe(dataset) if dataset else None
    saved = load_checkpoint(checkpoint)
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
    compared = parity(network, output)
    parity_found = asdict(compared)
    ended = "passed" if compared.passed else "FAILED"
    size = f"{made.size_bytes / 1e6:.2f} MB, {made.nodes} nodes"
    words = (
        f"{made.path}: {size}, {made.macs / 1e6:.0f} million multiply-accumulates\n"
        f"  parity {ended}: {_PARITY.format(**parity_found)}"
    )
    tell(as_json, asdict(made) | {"parity": parity_found}, lambda: words)
    if not compared.passed:
        click.get_current_context().exit(1)
