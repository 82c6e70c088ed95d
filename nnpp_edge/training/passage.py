"""Training of passage networks: AdamW, resumable, limited by steps or time."""

import io
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import msgspec
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from nnpp_edge.files import make_folder, write_whole
from nnpp_edge.model.passage import PassageNet
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.reading import problem_with_file
from nnpp_edge.terrain.passage import CLOSED
from nnpp_edge.training.checkpoint import HISTORY, State, TrainSettings
from nnpp_edge.training.passage_batches import PassageBatch, PassageMaps

CHECKPOINT = "checkpoint.pt"
FIGURES = "chance_error", "cost_error", "link_error", "way_error"
"""Mean distances of what is answered from the label: share of passing poses, their T, whether there is a way to the
next block, and T of that way; the second by share, the last where there is a way."""
BEGUN_WITH = "begun_with"
"""Among a run's settings: the facts of the run whose weights it began with."""
VALIDATED = 64
"""Vehicles that are validated on, at most."""
_AT_ONCE = 8
Options = Mapping[str, int | Sequence[int]]
"""Arguments of `PassageNet`."""


@dataclass
class PassageCheckpoint:
    """What a training run saves; `average` holds the running mean of the weights in `network`."""

    options: dict[str, int | list[int]]
    network: State
    average: State
    optimiser: dict[str, object]
    step: int = 0
    spent: float = 0.0
    """Seconds."""
    history: list[dict[str, float]] = field(default_factory=list)
    steps: int | None = None
    """At which the training ends, once that is known."""
    settings: dict[str, object] = field(default_factory=dict)

    def facts(self) -> dict[str, object]:
        """What decided the weights, for a model's metadata."""
        return {"steps": self.step, "seconds": round(self.spent, 1), **self.settings, **self.options}

    def trained(self) -> PassageNet:
        """The averaged network, in evaluation mode."""
        network = PassageNet(**self.options)  # type: ignore[arg-type]
        network.load_state_dict(self.average)
        return network.eval()


def is_passage_checkpoint(path: Path) -> bool:
    """Whether a file is a checkpoint of a passage network, not another or none."""
    try:
        load_passage_checkpoint(path)
    except ModelError:
        return False
    return True


def load_passage_checkpoint(path: Path) -> PassageCheckpoint:
    """Read a checkpoint; ModelError if the file is none of a passage network."""
    wanted = f"{path}: wanted a checkpoint of a passage network"
    if (problem := problem_with_file(path)) is not None:
        raise ModelError(f"{wanted} ({problem})")
    try:
        saved = torch.load(path, map_location="cpu", weights_only=True)
        found = msgspec.convert(saved, PassageCheckpoint)
        found.trained()
    except Exception as error:  # torch meets bad bytes with nearly every kind there is, and with many words
        raise ModelError(f"{wanted}, got another file, or a damaged one") from error
    return found


def train_passage(
    options: Options,
    settings: TrainSettings,
    training: PassageMaps,
    validation: PassageMaps,
    folder: Path,
    *,
    begin_with: Path | None = None,
    report: Callable[[int, float, float], None] = lambda step, loss, share: None,
) -> Path:
    """Train a passage network, going on from the folder's checkpoint if there is one; the path of its checkpoint.

    `TrainSettings.batch` counts maps. A time limit becomes a number of steps once the warm-up has shown how long one
    takes. A new training begins with the averaged weights of the checkpoint `begin_with`, if given. `report` is
    called after each step with its number, its loss and the share of the training that is done.
    Raises ModelError where the folder's checkpoint, or `begin_with`, is of another network.
    """
    make_folder(folder)
    vehicles = min(max(settings.batch // training.recipe.maps_per_vehicle, 1), len(training))
    if settings.steps is None and settings.time_limit_s == math.inf:
        settings = replace(settings, steps=settings.epochs * max(len(training) // vehicles, 1))
    run = _Run(options, settings, folder / CHECKPOINT, begin_with)
    saved = time.monotonic()
    while not run.done():
        rng = np.random.default_rng([settings.seed, run.state.step])
        run.learn(training.batch(rng.choice(len(training), vehicles, replace=False), rng))
        report(run.state.step, run.losses[-1], run.share_done())
        if run.done() or time.monotonic() - saved > settings.validate_every_s:
            run.validate_and_save(validation)
            saved = time.monotonic()
    return run.path


def passage_loss(answers: Tensor, labels: Mapping[str, Tensor]) -> tuple[Tensor, list[float]]:
    """Loss of (V, N, 16, R + 2, C + 2) logits, and the `FIGURES`.

    Cross-entropy throughout: of the chances, and of both T as if they were such, which keeps them in range.
    """
    share, cost = labels["passing"].float() / 16.0, labels["cost"].float() / 255.0
    open_, way = (labels["link"] != CLOSED).float(), labels["link"].float().clamp_max(CLOSED - 1) / (CLOSED - 1)
    targets = (share, None), (cost, share), (open_, None), (way, open_)
    total, figures = answers.new_zeros((), dtype=torch.float32), []
    for logits, (target, weight) in zip(torch.split(answers.float()[..., 1:-1, 1:-1], 4, 2), targets, strict=True):
        each = functional.binary_cross_entropy_with_logits(logits, target, reduction="none")
        total = total + _mean(each, weight)
        figures.append(float(_mean((torch.sigmoid(logits.detach()) - target).abs(), weight)))
    return total, figures


def _mean(values: Tensor, weight: Tensor | None) -> Tensor:
    return values.mean() if weight is None else (values * weight).sum() / weight.sum().clamp_min(1.0)


class _Run:
    """The network, its running mean, the optimiser and the progress."""

    def __init__(self, options: Options, settings: TrainSettings, path: Path, begin_with: Path | None) -> None:
        self._settings, self.path = settings, path
        torch.manual_seed(settings.seed)
        self._network, self._average = PassageNet(**options), PassageNet(**options)  # type: ignore[arg-type]
        self._average.load_state_dict(self._network.state_dict())
        rate, decay = settings.learning_rate, settings.weight_decay
        self._optimiser = torch.optim.AdamW(self._network.parameters(), lr=rate, weight_decay=decay)
        asked = {name: value for name, value in asdict(settings).items() if value != math.inf}
        plain = {k: v if isinstance(v, int) else list(v) for k, v in options.items()}
        self.state = PassageCheckpoint(plain, {}, {}, {}, settings=asked, steps=settings.steps)
        if path.exists():
            self._resume()
        elif begin_with is not None:
            self._begin_with(begin_with)
        self.losses: list[float] = []
        self._figures: list[list[float]] = []
        self._began = time.monotonic() - self.state.spent

    def done(self) -> bool:
        return self.state.steps is not None and self.state.step >= self.state.steps

    def share_done(self) -> float:
        state = self.state
        done = state.spent / self._settings.time_limit_s if state.steps is None else state.step / max(state.steps, 1)
        return min(done, 1.0)

    def learn(self, batch: PassageBatch) -> None:
        """Learn from one batch, in bfloat16 where that is fast."""
        state = self.state
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate()
        with torch.autocast("cpu", torch.bfloat16):
            answers = self._network(batch.blocks, batch.numbers)
        loss, figures = passage_loss(answers, batch.labels)
        self._optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self._network.parameters(), 1.0)
        self._optimiser.step()
        decay = min(self._settings.average_decay, (1 + state.step) / (10 + state.step))
        with torch.no_grad():
            torch._foreach_lerp_(list(self._average.parameters()), list(self._network.parameters()), 1.0 - decay)
        self.losses.append(float(loss.detach()))
        self._figures.append(figures)
        state.step += 1
        state.spent = time.monotonic() - self._began
        limit = self._settings.time_limit_s
        if state.steps is None and (state.step >= self._settings.warmup_steps or state.spent >= limit):
            state.steps = max(state.step, int(state.step * limit / state.spent))

    def validate_and_save(self, validation: PassageMaps) -> None:
        state = self.state
        figures = dict(zip(FIGURES, judged(self._average, validation), strict=True))
        state.history.append(
            {"step": state.step, "spent_s": state.spent, "loss": float(np.mean(self.losses)), **figures}
        )
        state.network, state.average = self._network.state_dict(), self._average.state_dict()
        state.optimiser = self._optimiser.state_dict()
        content = io.BytesIO()
        torch.save(vars(state), content)
        write_whole(self.path, content.getbuffer())
        write_whole(self.path.with_name(HISTORY), json.dumps(state.history, indent=1).encode())
        self.losses = self.losses[-1:]

    def _learning_rate(self) -> float:
        """Linear warm-up, then half a cosine down to a hundredth."""
        step, warm, steps = self.state.step, self._settings.warmup_steps, self.state.steps
        if step < warm or steps is None:
            return self._settings.learning_rate * min(1.0, (step + 1) / max(warm, 1))
        half_cosine = 0.5 * (1.0 + math.cos(math.pi * (step - warm) / max(steps - warm, 1)))
        return self._settings.learning_rate * (0.01 + 0.99 * half_cosine)

    def _begin_with(self, path: Path) -> None:
        saved = self._saved(path)
        for network in (self._network, self._average):
            network.load_state_dict(saved.average)
        self.state.settings[BEGUN_WITH] = saved.facts()

    def _saved(self, path: Path) -> PassageCheckpoint:
        saved = load_passage_checkpoint(path)
        if saved.options != self.state.options:
            raise ModelError(f"{path}: wanted a checkpoint of {self.state.options}, got one of {saved.options}")
        return saved

    def _resume(self) -> None:
        saved = self._saved(self.path)
        self._network.load_state_dict(saved.network)
        self._average.load_state_dict(saved.average)
        self._optimiser.load_state_dict(saved.optimiser)
        begun = {name: saved.settings.pop(name) for name in (BEGUN_WITH,) if name in saved.settings}
        saved.steps = saved.steps if saved.settings == self.state.settings else self.state.steps
        saved.settings = self.state.settings | begun
        self.state = saved


def judged(network: PassageNet, maps: PassageMaps) -> list[float]:
    """The `FIGURES` on a data set, or on its first `VALIDATED` vehicles."""
    rows, most = [], min(len(maps), VALIDATED)
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        for first in range(0, most, _AT_ONCE):
            batch = maps.batch(range(first, min(first + _AT_ONCE, most)))
            rows.append(passage_loss(network(batch.blocks, batch.numbers), batch.labels)[1])
    return np.mean(rows, 0).tolist()  # type: ignore[no-any-return]
