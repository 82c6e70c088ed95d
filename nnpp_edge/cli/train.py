"""`nnpp-edge train`: a network from a data set."""

import math
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.text import tell
from nnpp_edge.model.registry import PRESETS
from nnpp_edge.progress import THOUSANDTHS, bar, shown
from nnpp_edge.training.settings import TrainOptions, TrainSettings

_SIDE = click.IntRange(64, options.LARGEST_SIDE)


_ERRORS = (
    "  root mean square errors: mean {rmse_mean:.4f}, blocked {rmse_blocked:.4f}, closed "
    "{rmse_closed:.4f}, price {rmse_price:.4f}"
)
_REGION = (
    "  region at td × {factor:g}: gap {gap:.2%}, found {success:.1%}, "
    "{region_share:.1%} of the map, MM {mm:.3f}"
)


@options.command("train")
def command(
    dataset: Annotated[Path, options.FOLDER],
    /,
    validation: Annotated[Path, options.FOLDER, "Data set of other terrain."],
    output: Annotated[Path, "-o", options.FOLDER, "Folder of the run; resumed if begun."],
    settings: TrainOptions,
    architecture: Annotated[str, click.Choice(list(PRESETS)), "nnpp is the paper's."] = "edge",
    input_size: Annotated[
        int | None, _SIDE, "Side of the network's map, if not the preset's."
    ] = None,
    begin_with: Annotated[
        Path | None, options.PATH, "Checkpoint of another run whose weights to begin with."
    ] = None,
    time_limit: Annotated[
        float | None,
        "Minutes, about: the speed of the first 200 steps decides the number of steps.",
    ] = None,
    seed: options.Seed = 1,
    threads: Annotated[int | None, "Of torch on the CPU; by default one a core."] = None,
    as_json: options.AsJson = False,
) -> None:
    """Train a network on DATASET, with AdamW as in the paper.

    Each validation searches real queries inside the predicted region. The run's folder gets
    best.pt, last.pt and history.json; the same command continues where it stopped.

    \b
    nnpp-edge train data/train --validation data/val -o runs/edge --time-limit 60
    """
    # threads that spin where other programs run are ten times as slow
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    import torch

    from nnpp_edge.terrain.dataset import read_known, read_recipe, read_samples
    from nnpp_edge.training.checkpoint import LAST, load_checkpoint
    from nnpp_edge.training.train import train

    if threads:
        torch.set_num_threads(threads)
    preset = PRESETS[architecture]
    size = input_size or preset.input_size
    unseen = preset.encoding == "unseen"
    judged_on = read_known(validation) if unseen else read_samples(validation)
    training = read_known(dataset) if unseen else read_samples(dataset, size=size)
    with bar("train", THOUSANDTHS, quiet=True) as advance:
        best = train(
            replace(preset, input_size=size),
            TrainSettings(
                **asdict(settings),
                seed=seed,
                time_limit_s=60.0 * (time_limit or math.inf),
            ),
            training,
            judged_on,
            output,
            omega=read_recipe(dataset).omega,
            begin_with=begin_with,
            report=lambda share, words: advance(int(THOUSANDTHS * share), words),
        )
    progress = load_checkpoint(best.with_name(LAST)).progress
    history = progress.history

    def text() -> str:
        last = history[progress.best]
        minutes = progress.spent_s / 60
        words = f"step {last['step']:.0f} of {progress.step} in {minutes:.1f} min"
        lines = [f"{best}: {words}, loss {shown(last.get('loss'), '.4f')}"]
        if not last["step"]:
            lines.append("  these are the weights that it began with: none after them were better")
        if progress.step < (progress.steps or progress.step):
            lines.append(f"  stopped before step {progress.steps}; the same command goes on")
        if unseen:
            lines.append(_ERRORS.format_map(last))
        elif "gap" in last:
            lines.append(_REGION.format_map(last).replace("%", " %"))
        return "\n".join(lines)

    tell(as_json, {"best": str(best), "history": history}, text)
