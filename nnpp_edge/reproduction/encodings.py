"""Fig. 13: ways of showing the network start and goal, each trained with the same budget."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from nnpp_edge.reproduction import drawing, paper
from nnpp_edge.reproduction.experiment import Context, Result, experiment
from nnpp_edge.reproduction.findings import Finding, judge
from nnpp_edge.reproduction.rows import Columns, Rows, percent, table
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.shards import Recipe, make_shard
from nnpp_edge.terrain.workloads import SOFT

if TYPE_CHECKING:
    from nnpp_edge.training.train import Progress

_SIDE, _BLOCKS = 128, 16
"""Of the network's input (half the paper's, to keep so many trainings affordable) and of its answer."""
_HELD_OUT = 0.25
"""Share of each terrain file, its right side, that validation maps come from; and of a data set's maps."""
SIGMAS = {f"G: 1/{n}": 1.0 / n for n in (2, 3, 4, 5, 7, 16)}
"""Gaussians, by the names of the figure: σ as a share of the map's side."""
KINDS = {"E": "euclidean", "pixel": "pixel"}
"""The Euclidean distance; a single pixel (`nnpp_edge.model.registry.ENCODINGS`)."""


_QUICK = {"steps": 3, "batch": 8, "maps": 6, "validation_maps": 4, "encodings": ("G: 1/4", "G: 1/16", "pixel")}


@experiment("Fig. 13", "Encodings of start and goal", quick=_QUICK, asks_networks=False)
def fig13(
    context: Context,
    *,
    steps: int = 1000,
    batch: int = 32,
    maps: int = 1536,
    validation_maps: int = 96,
    encodings: Sequence[str] = (*SIGMAS, *KINDS),
) -> Result:
    """Train the paper's small network for so many steps with each encoding, and search in the regions it names."""
    from nnpp_edge.model.registry import PRESETS
    from nnpp_edge.training.train import TrainSettings, train

    training, validation = make_samples(context, maps, validation_maps)
    if len(training) < batch:
        raise DataSetError(f"wanted at least {batch} training queries for one batch, got {len(training)}")
    of_run: dict[str, Any] = {"epochs": steps, "steps": steps, "batch": batch, "seed": context.seed, "target": "path"}
    warmup = max(1, min(100, steps // 10))
    settings = TrainSettings(average_decay=0.99, warmup_steps=warmup, validate_every_s=math.inf, **of_run)
    rows = Rows()
    for at, label in enumerate(encodings):
        kind, sigma = KINDS.get(label, "gaussian"), SIGMAS.get(label, paper.BEST_SIGMA)
        spec = replace(PRESETS["nnpp-w16"], input_size=_SIDE, encoding=kind, sigma=sigma)

        def report(of_training: "Progress", loss: float, share: float, at: int = at) -> None:
            context.progress((at + share) / len(encodings))

        folder = context.work / str(at)
        train(spec, settings, training, validation, folder, omega=PAPER_OMEGA, report=report)
        last = json.loads((folder / "history.json").read_text())[-1]
        figures = {name: last[f"{name}@1"] for name in ("mm", "gap", "success", "region_share")}
        rows.append({"encoding": label, "steps": int(last["step"]), **figures, "loss": last["loss"]})
    columns: Columns = {
        "MM": lambda of: f"{of.mean('mm'):.3f}",
        "gap": lambda of: percent(of.mean("gap"), 2),
        "path in the region": lambda of: percent(of.mean("success")),
        "region": lambda of: percent(of.mean("region_share")),
        "training loss": lambda of: f"{of.mean('loss'):.4f}",
    }
    figure = drawing.new_figure(11.5, 4.2)
    titles = {"mm": "MM (more is better)", "gap": "Gap (less is better)", "region_share": "Region's share of the map"}
    for axes, (name, title) in zip(figure.subplots(1, 3), titles.items(), strict=True):
        heights = {str(label): of.mean(name) for (label,), of in rows.by("encoding").items()}
        colours = [drawing.OURS if SIGMAS.get(label) == paper.BEST_SIGMA else drawing.PAPER for label in heights]
        drawn = axes.bar(list(heights), list(heights.values()), 0.7, color=colours)
        axes.bar_label(drawn, fmt="%.3f", fontsize="x-small", padding=2)
        axes.tick_params(axis="x", rotation=45)
        drawing.tidy(axes, title)
    figure.suptitle("Blue: σ = 1/4 of the map's side, the paper's best", fontsize="small")
    return Result(
        table("encoding", rows.by("encoding"), columns),
        rows,
        encoding_findings(rows),
        figure,
        f"`nnpp-w16` at {_SIDE}², trained here with each encoding: {rows[0]['steps']} steps of {batch} queries",
        "none: the encodings are compared with each other",
    )


def make_samples(context: Context, maps: int, validation_maps: int) -> tuple[Samples, Samples]:
    """Training and validation queries, from different ground."""
    plain: dict[str, Any] = dict.fromkeys(("synthetic_share", "obstacle_share", "margin_share"), 0.0)
    plain |= {"workloads": ((SOFT, 1.0),), "poolings": ((1, 1.0),), "least_distance": 0.25}
    recipe = Recipe((), size=_SIDE, blocks=_BLOCKS, cell_sizes_m=(context.terrain[0].cell_size_m,), **plain)
    parts = []
    for part, count in enumerate((maps, validation_maps)):
        tiles = [side_of(dem, bool(part)) for dem in context.terrain]
        parts.append(Samples.of(make_shard(recipe, tiles, np.random.default_rng([context.seed, part]), count)))
    return parts[0], parts[1]


def side_of(dem: Dem, held_out: bool) -> Dem:
    """The side of a DEM that training, or validation, may see."""
    rows, cols = dem.elevation.shape
    kept = min(int((1.0 - _HELD_OUT) * cols), cols - _SIDE)
    if rows < _SIDE or kept < _SIDE:
        raise InvalidQueryError(
            f"{dem.source.name}: wanted terrain of at least {_SIDE} × {2 * _SIDE} cells, got {rows} × {cols}"
        )
    part = dem.elevation[:, kept:] if held_out else dem.elevation[:, :kept]
    return replace(dem, elevation=np.ascontiguousarray(part), georeference=None)


def encoding_findings(rows: Rows) -> list[Finding]:
    """Of the rows of all trainings."""
    mm = {str(label): of.mean("mm") for (label,), of in rows.by("encoding").items()}
    gaussians = [label for label in mm if label in SIGMAS]
    best, smallest = max(gaussians, key=mm.__getitem__), min(gaussians, key=SIGMAS.__getitem__)
    around, tenth = 0.2 <= SIGMAS[best] <= 1.0 / 3.0, "MM at least a tenth below the best"
    ours = f"{best.removeprefix('G: ')} (MM {mm[best]:.3f})"
    found = [judge("best σ of the Gaussians", "around 1/4", ours, around, "from 1/5 to 1/3")]
    ours = f"MM {mm[smallest]:.3f} with {smallest.removeprefix('G: ')} against {mm[best]:.3f}"
    much = mm[smallest] <= 0.9 * mm[best]
    found.append(judge("a very small σ is much worse", "significant decrease", ours, much, tenth))
    for label, claim, share, rule in (
        ("pixel", "a single pixel is unsatisfactory", 0.9, f"{tenth} Gaussian's"),
        ("E", "Gaussians beat distances", 1.0, "a smaller MM"),
    ):
        if label in mm:
            ours = f"MM {mm[label]:.3f} against {mm[best]:.3f}"
            found.append(judge(claim, "yes", ours, mm[label] <= share * mm[best], rule))
    return found
