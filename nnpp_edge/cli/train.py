"""`nnpp-edge train`: a network from a data set."""

import dataclasses
import json
import math
import os
from pathlib import Path

import click

from nnpp_edge.cli import options
from nnpp_edge.model.registry import ENCODINGS, PRESETS

_PARTS = 1000
"""Of the training, for the progress bar."""
_ENCODING = click.Choice([name for names in ENCODINGS.values() for name in names])
_SIDE = click.IntRange(64, options.LARGEST_SIDE)
_SIGMA = options.Real(0.0, 1.0, min_open=True)
_STEPS = "Most steps, if its epochs do not end the training before; the number that a time limit came to repeats it."
_TIME_LIMIT = "Minutes, about: the speed of the first 200 steps decides the number of steps."
_SMALL = "Keep the mean weights alone, in 16 bits; a resumed run warms up a new optimiser."
_PRECISION = "Of the convolutions; auto: bfloat16 on a GPU. bfloat16 is twice as fast on a CPU with AMX."


@click.command(name="train")
@click.argument("dataset", type=options.FOLDER)
@click.option("--validation", type=options.FOLDER, required=True, help="Data set of other terrain.")
@click.option("-o", "--output", type=options.FOLDER, required=True, help="Folder of the run; resumed if begun.")
@click.option("--architecture", type=click.Choice(list(PRESETS)), default="edge", help="nnpp is the paper's.")
@click.option("--input-size", type=_SIDE, help="Side of the network's map, if not the preset's.")
@click.option("--encoding", type=_ENCODING, help="How start and goal are shown, if not the preset's way.")
@click.option("--sigma", type=_SIGMA, default=0.25, help="Of the Gaussians, as a share of the map's side.")
@click.option("--begin-with", type=options.PATH, help="Checkpoint of another run whose weights to begin with.")
@click.option("--epochs", type=options.COUNT, default=150)
@click.option("--steps", type=options.COUNT, help=_STEPS)
@click.option("--batch", type=options.COUNT, default=32, help="Over all processes.")
@click.option("--learning-rate", type=options.POSITIVE, default=1e-3)
@click.option("--weight-decay", type=options.NOT_NEGATIVE, default=1e-4)
@click.option(
    "--target", type=click.Choice(["near", "path"]), default="near", help="Nearness to the optimum, or the best path."
)
@click.option("--softness", type=options.POSITIVE, default=0.02, help="Excess at which nearness is 1/e.")
@click.option("--time-limit", type=options.POSITIVE, help=_TIME_LIMIT)
@click.option("--validate-every", type=options.NOT_NEGATIVE, default=5.0, help="Minutes.")
@click.option("--small-checkpoints", is_flag=True, help=_SMALL)
@click.option("--pause-after", type=options.POSITIVE, help="Minutes; the same command goes on.")
@click.option("--precision", type=click.Choice(["auto", "float32", "bfloat16"]), default="auto", help=_PRECISION)
@click.option("--threads", type=options.COUNT, help="Of torch on the CPU; by default one a core.")
@options.seed
@options.as_json
def command(
    dataset: Path,
    validation: Path,
    output: Path,
    architecture: str,
    input_size: int | None,
    encoding: str | None,
    sigma: float,
    begin_with: Path | None,
    time_limit: float | None,
    validate_every: float,
    small_checkpoints: bool,
    pause_after: float | None,
    threads: int | None,
    as_json: bool,
    **settings: object,
) -> None:
    """Train a network on DATASET, with AdamW as in the paper.

    Each validation searches real queries inside the predicted region. The run's folder gets checkpoint.pt,
    history.json and curves.png; the same command goes on where it stopped. Under torchrun the batch is
    shared out evenly over the processes, and the first one writes and prints.

    \b
    nnpp-edge train data/train --validation data/val -o runs/edge --time-limit 60
    """
    from contextlib import nullcontext

    import msgspec

    # threads that spin where other programs run are ten times as slow
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    import torch

    from nnpp_edge.progress import bar
    from nnpp_edge.terrain.dataset import read_recipe, read_samples
    from nnpp_edge.training.train import Progress, TrainSettings, train
    from nnpp_edge.viz.figures import training_curves

    if threads:
        torch.set_num_threads(threads)
    settings |= {"time_limit_s": 60.0 * (time_limit or math.inf), "validate_every_s": 60.0 * validate_every}
    preset = PRESETS[architecture]
    size = input_size or preset.input_size
    spec = dataclasses.replace(preset, sigma=sigma, input_size=size, encoding=encoding or preset.encoding)
    first = int(os.environ.get("RANK", "0")) == 0
    with bar("train", _PARTS) if first else nullcontext(lambda done: None) as advance:

        def report(progress: Progress, mean_loss: float, share: float) -> None:
            advance(int(_PARTS * share))

        checkpoint = train(
            spec,
            msgspec.convert(settings, TrainSettings),
            read_samples(dataset, size=size),
            read_samples(validation),
            output,
            omega=read_recipe(dataset).omega,
            begin_with=begin_with,
            small_checkpoints=small_checkpoints,
            pause_after_s=60.0 * (pause_after or math.inf),
            report=report,
        )
    if not first:
        return
    history = json.loads((output / "history.json").read_text())
    training_curves(history, output / "curves.png")
    if as_json:
        click.echo(json.dumps({"checkpoint": str(checkpoint), "history": history}))
        return
    last = history[-1]
    click.echo(f"{checkpoint}: {last['step']:.0f} steps in {last['spent_s'] / 60:.0f} min, loss {last['loss']:.4f}")
    for factor in sorted(key.partition("@")[2] for key in last if key.startswith("gap@")):
        gap, success, share, mm = (last[f"{name}@{factor}"] for name in ("gap", "success", "region_share", "mm"))
        click.echo(
            f"  region at td × {factor}: gap {100 * gap:.2f} %, found {100 * success:.1f} %, "
            f"{100 * share:.1f} % of the map, MM {mm:.3f}"
        )
