"""What each choice is worth: short trainings that differ from a base in one thing each.

``python -m nnpp_edge.training.ablations data/train --validation data/val -o runs/ablations --steps 1000``

All see the same queries in the same order for the same number of steps, and are judged by searches in their
regions (`Validator`). A short training shows which choice is learned sooner, not where each would end.
"""

import dataclasses
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import msgspec
import torch

from nnpp_edge.files import make_folder, write_whole
from nnpp_edge.model.registry import PRESETS, Spec
from nnpp_edge.progress import bar, render_table
from nnpp_edge.terrain.dataset import read_recipe, read_samples
from nnpp_edge.training.checkpoint import HISTORY
from nnpp_edge.training.train import Progress, TrainSettings, train

BASE = "edge"
FACTORS = ("1", "0.5", "0.25")
"""Factors on the adaptive threshold that are compared."""
_FOLDER = click.Path(path_type=Path, file_okay=False)
_PARTS = 1000
"""Of a variant's training, for the progress bar."""


@dataclass(frozen=True)
class Variant:
    """A training that differs from the base in one thing."""

    name: str
    spec: Spec
    settings: TrainSettings


def variants(steps: int) -> Iterator[Variant]:
    """The base first, then each choice by itself."""
    spec = PRESETS[BASE]
    settings = TrainSettings(
        batch=128,
        learning_rate=2e-3,
        steps=steps,
        warmup_steps=max(1, min(100, steps // 10)),
        validate_every_s=math.inf,
        average_decay=0.99,
    )
    yield Variant("base", spec, settings)
    widths = {"half": (16, 32, 32, 32), "double": (64, 128, 128, 128)}
    for name, of_stages in widths.items():
        changed = {**spec.options, "widths": of_stages, "stem": of_stages[0]}
        yield Variant(f"width: {name}", dataclasses.replace(spec, options=changed), settings)
    for size in (128, 256):
        yield Variant(f"input: {size}", dataclasses.replace(spec, input_size=size), settings)
    for sigma in (1 / 16, 1 / 8, 1 / 2):
        yield Variant(f"sigma: 1/{1 / sigma:.0f}", dataclasses.replace(spec, sigma=sigma), settings)
    yield Variant("target: one path", spec, dataclasses.replace(settings, target="path"))
    for softness in (0.005, 0.05):
        yield Variant(f"softness: {softness}", spec, dataclasses.replace(settings, softness=softness))
    for loss in ("focal", "dice"):
        yield Variant(f"loss: {loss}", spec, dataclasses.replace(settings, loss=loss))


def table(found: dict[str, dict[str, float]]) -> str:
    """Success and mean gap, and the region's share of the map, at the factors on td."""
    head = ["variant", "loss", *(f"td × {f}\n{what}" for f in FACTORS for what in ("success", "gap", "region"))]
    digits = {"success": 1, "gap": 2, "region_share": 1}
    body = [
        [name, f"{row['loss']:.4f}"]
        + [f"{100 * row[f'{key}@{f}']:.{digits[key]}f} %" for f in FACTORS for key in digits]
        for name, row in found.items()
    ]
    return render_table(head, body)


def train_variant(
    variant: Variant, dataset: Path, validation: Path, output: Path, report: Callable[[float], None]
) -> dict[str, float]:
    """Train one, going on from what its folder holds; the last row of its history.

    `report` is called with the share of the training that is done.
    """
    folder = output / variant.name.replace(": ", "-").replace(" ", "-").replace("/", "-")
    samples, held_out = read_samples(dataset, size=variant.spec.input_size), read_samples(validation)

    def report_share(progress: Progress, loss: float, share: float) -> None:
        report(share)

    omega = read_recipe(dataset).omega
    train(variant.spec, variant.settings, samples, held_out, folder, omega=omega, report=report_share)
    return msgspec.json.decode((folder / HISTORY).read_bytes(), type=list[dict[str, float]])[-1]


def _names(_: click.Context, __: click.Parameter, value: str | None) -> list[str] | None:
    return None if value is None else [part.strip() for part in value.split(",")]


@click.command()
@click.argument("dataset", type=_FOLDER)
@click.option("--validation", type=_FOLDER, required=True, help="Data set of other terrain.")
@click.option("-o", "--output", type=_FOLDER, required=True, help="Trainings that are done there are not repeated.")
@click.option("--steps", type=click.IntRange(1), default=1000, show_default=True)
@click.option("--only", metavar="NAME,…", callback=_names, help="Names of variants.")
@click.option("--threads", type=click.IntRange(1), help="Of torch on the CPU.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")
def main(
    dataset: Path,
    validation: Path,
    output: Path,
    steps: int,
    only: list[str] | None,
    threads: int | None,
    as_json: bool,
) -> None:
    """Train every variant for so many steps, and compare."""
    if threads:
        torch.set_num_threads(threads)
    chosen = [variant for variant in variants(steps) if only is None or variant.name in only]
    if not chosen:
        raise click.UsageError(f"--only must be of: {', '.join(v.name for v in variants(steps))}")
    make_folder(output)
    found: dict[str, dict[str, float]] = {}
    with bar("ablations", _PARTS * len(chosen)) as advance:
        for at, variant in enumerate(chosen):

            def report(share: float, at: int = at) -> None:
                advance(int(_PARTS * (at + share)))

            found[variant.name] = train_variant(variant, dataset, validation, output, report)
            write_whole(output / "ablations.json", json.dumps(found, indent=1).encode())
    click.echo(json.dumps(found, indent=1) if as_json else table(found))


if __name__ == "__main__":
    main()
