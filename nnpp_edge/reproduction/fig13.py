"""Fig. 13: ways of showing the network start and goal, each trained with the same budget."""

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import OURS, PAPER, new_figure, png, tidy
from nnpp_edge.reproduction.report import About, Finding, Result, Table, columns, judge, percent
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.terrain.dataset import Samples, read_samples
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.shards import Recipe, make_shard
from nnpp_edge.terrain.workloads import SOFT

if TYPE_CHECKING:
    from nnpp_edge.training.train import Progress, TrainSettings

_SIDE = 128
"""Of the network's input: half the paper's, to keep seven trainings affordable."""
_BLOCKS = 16
_HELD_OUT = 0.25
"""Share of each terrain file, its right side, that validation maps come from; and of a data set's maps."""


@dataclass(frozen=True)
class Encoding:
    """A way of showing start and goal, as the figure names it."""

    label: str
    kind: str
    """Of `nnpp_edge.model.registry.ENCODINGS`."""
    sigma: float = 0.25


ENCODINGS = (
    *(Encoding(f"G: 1/{n}", "gaussian", 1.0 / n) for n in (2, 3, 4, 5, 7, 16)),
    Encoding("E", "euclidean"),
    Encoding("pixel", "pixel"),
)
"""Gaussians whose σ is a share of the map's side; the Euclidean distance; a single pixel."""


@dataclass(frozen=True)
class Settings:
    """How long is trained, and on what."""

    steps: int = 1000
    """For each encoding."""
    batch: int = 32
    maps: int = 1536
    validation_maps: int = 96
    repeats: int = 1
    """Trainings of each encoding, from different seeds."""
    encodings: tuple[Encoding, ...] = ENCODINGS
    threads: int | None = None
    """Of torch on the CPU; by default torch's own choice. Tiny batches are done sooner by one."""


@dataclass(frozen=True)
class _Scores:
    """What an encoding came to: one figure for each training."""

    steps: int
    mm: tuple[float, ...]
    gap: tuple[float, ...]
    success: tuple[float, ...]
    region_share: tuple[float, ...]
    loss: tuple[float, ...]


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """Train the paper's small network once for each encoding, and search in the regions that it names."""
    from nnpp_edge.model.registry import PRESETS
    from nnpp_edge.training.train import train

    if len(settings.encodings) < 2 or settings.steps < 1:
        raise InvalidQueryError(f"wanted at least 1 step for 2 encodings, got {settings.steps}")
    training, validation = make_samples(context, settings)
    scores: dict[str, _Scores] = {}
    turns = len(settings.encodings) * settings.repeats
    for at, encoding in enumerate(settings.encodings):
        spec = replace(PRESETS["nnpp-w16"], input_size=_SIDE, encoding=encoding.kind, sigma=encoding.sigma)
        rows = []
        for turn in range(settings.repeats):
            folder = context.work / f"{at}-{turn}"
            before = at * settings.repeats + turn

            def share_done(of_training: "Progress", loss: float, share: float, before: int = before) -> None:
                progress((before + share) / turns)

            of_train = _train_settings(settings, len(training), context.seed + turn)
            with _threads(settings.threads):
                train(spec, of_train, training, validation, folder, omega=PAPER_OMEGA, report=share_done)
            rows.append(json.loads((folder / "history.json").read_text())[-1])
        keys = ("mm@1", "gap@1", "success@1", "region_share@1", "loss")
        figures = (tuple(row[key] for row in rows) for key in keys)
        scores[encoding.label] = _Scores(int(rows[0]["step"]), *figures)
    notes = _notes(context)
    steps = next(iter(scores.values())).steps
    about = About(
        f"`nnpp-w16` at {_SIDE}², trained here with each encoding: {steps} steps of {settings.batch} queries",
        f"{len(training)} training and {len(validation)} validation queries, {settings.repeats} training(s) each",
        "none: the encodings are compared with each other",
    )
    return Result(
        about, _summary(scores), _data(scores), _findings(scores, settings), _picture(scores, settings), notes
    )


@contextmanager
def _threads(count: int | None) -> Iterator[None]:
    """Let torch use so many threads meanwhile."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _train_settings(settings: Settings, queries: int, seed: int) -> "TrainSettings":
    from nnpp_edge.training.train import TrainSettings

    if queries < settings.batch:
        raise DataSetError(f"wanted at least {settings.batch} training queries for one batch, got {queries}")
    return TrainSettings(
        epochs=settings.steps,
        steps=settings.steps,
        batch=settings.batch,
        target="path",
        seed=seed,
        warmup_steps=max(1, min(100, settings.steps // 10)),
        validate_every_s=math.inf,
        average_decay=0.99,
    )


def make_samples(context: Context, settings: Settings) -> tuple[Samples, Samples]:
    """Training and validation queries, from different ground."""
    if context.dataset is not None:
        return _split(read_samples(context.dataset, settings.maps + settings.validation_maps, size=_SIDE))
    recipe = Recipe(
        (),
        size=_SIDE,
        blocks=_BLOCKS,
        synthetic_share=0.0,
        obstacle_share=0.0,
        margin_share=0.0,
        workloads=((SOFT, 1.0),),
        poolings=((1, 1.0),),
        cell_sizes_m=(context.terrain[0].cell_size_m,),
        least_distance=0.25,
    )
    parts = []
    for number, (held_out, maps) in enumerate(((False, settings.maps), (True, settings.validation_maps))):
        tiles = [side_of(dem, held_out) for dem in context.terrain]
        arrays = make_shard(recipe, tiles, np.random.default_rng([context.seed, number]), maps)
        parts.append(Samples.of(arrays))
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


def _split(samples: Samples) -> tuple[Samples, Samples]:
    """A data set's maps, the last of them for validation."""
    first = math.ceil((1.0 - _HELD_OUT) * len(samples.planes))
    if not 0 < first < len(samples.planes):
        raise DataSetError(f"wanted at least 2 maps to train and to validate with, got {len(samples.planes)}")
    out = []
    for kept in (samples.map_index < first, samples.map_index >= first):
        names = ("map_index", "start", "goal", "excess", "on_path")
        out.append(replace(samples, **{name: getattr(samples, name)[kept] for name in names}))
    return out[0], out[1]


def _notes(context: Context) -> list[str]:
    ground = "a data set's maps" if context.dataset else "crops of the terrain, validation's from its held-out side"
    return [
        f"`nnpp-w16` is the paper's network at a quarter of its width. Maps and searches have {_SIDE}² cells, "
        f"regions {_BLOCKS} × {_BLOCKS} blocks: half the paper's resolution. Queries are on {ground}. The target is"
        " the paper's single path. Figures are for the region at td.",
        "The paper trains for 150 epochs of 100 000 maps at full width, and gives this figure as a picture alone; of "
        "it the text says only what the findings quote. A short training tells which encoding is learned soonest.",
    ]


def _summary(scores: dict[str, _Scores]) -> Table:
    rows = []
    for label, s in scores.items():
        gap, success, region = (float(np.mean(values)) for values in (s.gap, s.success, s.region_share))
        quality = (f"{np.mean(s.mm):.3f}", percent(gap, 2), percent(success), percent(region))
        rows.append((label, *quality, f"{np.mean(s.loss):.4f}"))
    return Table(columns("encoding | MM | gap | path in the region | region | training loss"), rows)


def _data(scores: dict[str, _Scores]) -> Table:
    rows = [
        (label, turn, s.steps, s.mm[turn], s.gap[turn], s.success[turn], s.region_share[turn], s.loss[turn])
        for label, s in scores.items()
        for turn in range(len(s.mm))
    ]
    return Table(columns("encoding | training | steps | mm | gap | success | region_share | loss"), rows)


def _findings(scores: dict[str, _Scores], settings: Settings) -> Sequence[Finding]:
    mm = {label: float(np.mean(s.mm)) for label, s in scores.items()}
    gaussians = {e.label: e.sigma for e in settings.encodings if e.kind == "gaussian"}
    if not gaussians:
        return []
    best, smallest = max(gaussians, key=mm.__getitem__), min(gaussians, key=gaussians.__getitem__)
    around, ours = 0.2 <= gaussians[best] <= 1.0 / 3.0, f"{best.removeprefix('G: ')} (MM {mm[best]:.3f})"
    worse = f"MM {mm[smallest]:.3f} with {smallest.removeprefix('G: ')} against {mm[best]:.3f}"
    much, tenth = mm[smallest] <= 0.9 * mm[best], "MM at least a tenth below the best"
    found = [
        judge("best σ of the Gaussians", "around 1/4", ours, agrees=around, rule="from 1/5 to 1/3"),
        judge("a very small σ is much worse", "significant decrease", worse, agrees=much, rule=tenth),
    ]
    for kind, claim, share, rule in (
        ("pixel", "a single pixel is unsatisfactory", 0.9, f"{tenth} Gaussian's"),
        ("euclidean", "Gaussians beat distances", 1.0, "a smaller MM"),
    ):
        for other in (e.label for e in settings.encodings if e.kind == kind):
            own = f"MM {mm[other]:.3f} against {mm[best]:.3f}"
            found.append(judge(claim, "yes", own, agrees=mm[other] <= share * mm[best], rule=rule))
    return found


def _picture(scores: dict[str, _Scores], settings: Settings) -> bytes:
    figure = new_figure(11.5, 4.2)
    axes = figure.subplots(1, 3)
    labels, places = list(scores), np.arange(len(scores))
    gaussians = [e for e in settings.encodings if e.kind == "gaussian"]
    best = min((abs(e.sigma - paper.BEST_SIGMA), e.label) for e in gaussians)[1]
    colours = [OURS if label == best else "#9ecae1" if label.startswith("G") else PAPER for label in labels]
    panels = (
        ("mm", 1.0, "MM (more is better)"),
        ("gap", 100.0, "Gap, % (less is better)"),
        ("region_share", 100.0, "Region, % of the map (less is better)"),
    )
    for panel, (name, scale, title) in zip(axes, panels, strict=True):
        means = [scale * float(np.mean(getattr(s, name))) for s in scores.values()]
        spread = [scale * float(np.std(getattr(s, name))) for s in scores.values()]
        bars = panel.bar(places, means, 0.7, color=colours, yerr=spread if settings.repeats > 1 else None, capsize=3)
        panel.bar_label(bars, fmt="%.3f" if name == "mm" else "%.1f", fontsize="x-small", padding=2)
        panel.margins(y=0.12)
        panel.set_xticks(places, labels, rotation=45, ha="right", fontsize="small")
        tidy(panel, title, "", "")
    figure.suptitle("Dark blue: σ = 1/4 of the map's side, the paper's best", fontsize="small")
    return png(figure)


_THREE = (ENCODINGS[2], ENCODINGS[5], ENCODINGS[-1])
_QUICK = Settings(steps=3, batch=8, maps=6, validation_maps=4, threads=1, encodings=_THREE)
EXPERIMENT = Experiment("Fig. 13", "Encodings of start and goal", run, Settings(), _QUICK, asks_networks=False)
