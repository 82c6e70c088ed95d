"""Training: AdamW as in the paper, resumable, limited by epochs, steps or time, on one device or several."""

import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from nnpp_edge.files import make_folder
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import InvalidQueryError, ModelError
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.training.batches import Batch, Batches
from nnpp_edge.training.checkpoint import Checkpoint, Progress, TrainSettings, in_16_bits, load_checkpoint
from nnpp_edge.training.processes import Processes
from nnpp_edge.training.validation import Judgement, Validator

__all__ = ["Progress", "TrainSettings", "loss_of", "train"]

CHECKPOINT = "checkpoint.pt"
LOSSES = ("bce", "focal", "dice")
"""Binary cross-entropy; the same weighted by (target - p)², for targets between 0 and 1 too; one minus the soft
overlap of target and probability, plus cross-entropy."""
_RECENT = 50
"""Steps whose mean loss is reported."""


def train(
    spec: Spec,
    settings: TrainSettings,
    training: Samples,
    validation: Samples,
    folder: Path,
    *,
    omega: float,
    begin_with: Path | None = None,
    small_checkpoints: bool = False,
    pause_after_s: float = math.inf,
    report: Callable[[Progress, float, float], None] = lambda progress, loss, share: None,
) -> Path:
    """Train a network, going on from the folder's checkpoint if there is one; the path of its checkpoint.

    Parameters
    ----------
    spec, settings
        What to train, and how. A checkpoint of another spec is refused.
    folder : Path
        Gets ``checkpoint.pt`` (weights, running mean, optimiser, progress; loads with weights_only) and
        ``history.json``.
    omega : float
        Weight of the traversability cost per grey level, for validation's searches.
    begin_with : Path, optional
        Checkpoint of another run whose averaged weights a new run begins with; its input may have been of
        another size.
    small_checkpoints : bool
        Save the running mean of the weights alone, convolutions in 16 bits: an eighth of the size. A resumed run goes
        on from the mean with a new optimiser, whose learning rate is warmed up again.
    pause_after_s : float
        Save and return after so many seconds, wherever the training is; called again it goes on.
    report : callable
        Called after each step with the progress, the latest mean loss and the share of the training that is done.

    Raises
    ------
    InvalidQueryError
        The batch cannot be shared out evenly over the processes.
    ModelError
        The folder's checkpoint is of another spec, or none of ours; or `begin_with` is of another network.
    DataSetError
        The training set does not fit the spec, or is smaller than a batch.

    Notes
    -----
    Under ``torchrun`` each process takes its share of every batch and gradients are averaged; only the first
    validates and writes, and the history's loss is the mean over all. The samples, their order and their
    symmetries are those of one process, so the curves differ by rounding and by batch norm alone: each process
    normalises its share by the share's own mean and variance, and the running statistics are the first
    process's.

    What is learned depends on numbers of steps, never on the clock: a time limit becomes a number of steps once the
    warm-up has shown how long one takes (`Progress.steps`). On a CPU the same spec, settings, samples and that number
    as `TrainSettings.steps` give the same weights bit for bit, with the same torch and number of threads.
    """
    processes = Processes.join()
    if settings.batch % processes.world:
        raise InvalidQueryError(f"batch must be a multiple of the {processes.world} processes, got {settings.batch}")
    make_folder(folder)
    run = _Run(spec, settings, processes, folder / CHECKPOINT, begin_with)
    run.small_checkpoints = small_checkpoints
    batches = Batches(training, spec, settings, rank=processes.rank, world=processes.world)
    validator = Validator(validation, spec, omega) if processes.first else None
    run.start(len(batches))
    progress = run.progress
    began = validated = time.monotonic()

    def stops() -> bool:
        return run.done() or processes.of_the_first(time.monotonic() - began) > pause_after_s

    while not stops() and progress.epoch < settings.epochs:
        for batch in batches.epoch(progress.epoch, progress.step_in_epoch):
            if stops():
                break
            run.step(batch)
            if processes.first:
                report(progress, float(np.mean(run.losses[-_RECENT:])), run.share_done())
            if processes.of_the_first(time.monotonic() - validated) > settings.validate_every_s:
                run.validate_and_save(validator)
                validated = time.monotonic()
        else:
            progress.epoch += 1
            progress.step_in_epoch = 0
    run.validate_and_save(validator)
    processes.leave()
    return run.path


class _Run:
    """One process's part of a training run: the network, its running mean, the optimiser and the progress."""

    def __init__(
        self, spec: Spec, settings: TrainSettings, processes: Processes, path: Path, begin_with: Path | None
    ) -> None:
        self.spec, self.settings, self.processes, self.path = spec, settings, processes, path
        torch.manual_seed(settings.seed)
        device = processes.device
        self.network = Network(spec).to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = Network(spec).to(device)
        self.average.load_state_dict(self.network.state_dict())
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        self.progress = Progress()
        precision = settings.precision
        self._in_bfloat16 = precision == "bfloat16" or (precision == "auto" and device.type == "cuda")
        self.small_checkpoints = False
        self._optimiser_since = 0
        """Step from which on the optimiser has learned."""
        self.origin: dict[str, object] = {"torch": str(torch.__version__), "threads": torch.get_num_threads()}
        if path.exists():
            self._resume()
        elif begin_with is not None:
            self._take_weights(begin_with)
        self.losses: list[float] = []
        """Of the steps since the last validation."""

    def start(self, batches: int) -> None:
        """Start the clock of a run with so many batches to an epoch."""
        self._wrapped = self.processes.averaging_gradients(self.network)
        self._most = min(self.settings.epochs * batches, self.settings.steps or sys.maxsize)
        if self.settings.time_limit_s == math.inf:
            self.progress.steps = self._most
        self._started = time.monotonic() - self.progress.spent_s

    def done(self) -> bool:
        """Whether the last step has been made."""
        return self.progress.steps is not None and self.progress.step >= self.progress.steps

    def share_done(self) -> float:
        """Share of the training that is done, in steps, or in time while their number is not known."""
        progress = self.progress
        done = (
            progress.spent_s / self.settings.time_limit_s
            if progress.steps is None
            else progress.step / progress.steps
        )
        return min(done, 1.0)

    def step(self, batch: Batch) -> None:
        """Learn from one batch."""
        progress = self.progress
        for group in self.optimiser.param_groups:
            group["lr"] = self._learning_rate()
        planes, query, target = (
            torch.from_numpy(array).to(self.processes.device, non_blocking=True) for array in batch
        )
        self.network.train()
        with torch.autocast(self.processes.device.type, torch.bfloat16, enabled=self._in_bfloat16):
            logits = self._wrapped((planes.float() / 255.0).contiguous(memory_format=torch.channels_last), query)
        loss = loss_of(self.settings.loss, logits.float(), target)
        self.optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimiser.step()
        self.losses.append(float(loss.detach()))
        decay = min(self.settings.average_decay, (1 + progress.step) / (10 + progress.step))
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.parameters()), list(self.network.parameters()), 1.0 - decay)
        progress.step += 1
        progress.step_in_epoch += 1
        progress.spent_s = self.processes.of_the_first(time.monotonic() - self._started)
        speed_known = progress.step >= self.settings.warmup_steps or progress.spent_s >= self.settings.time_limit_s
        if progress.steps is None and speed_known:
            in_time = int(progress.step * self.settings.time_limit_s / progress.spent_s)
            progress.steps = min(self._most, max(progress.step, in_time))

    def validate_and_save(self, validator: Validator | None) -> None:
        """Validate what was learned since the last time, and save. The first process alone has a validator."""
        loss = self.processes.mean(float(np.mean(self.losses))) if self.losses else None
        if validator is not None:
            if loss is not None:
                for theirs, ours in zip(self.network.buffers(), self.average.buffers(), strict=True):
                    ours.copy_(theirs)  # the batch norms' statistics
                self.progress.history.append(_history_row(self.progress, loss, validator.judge(self.average)))
            states = self.network.state_dict(), self.average.state_dict(), self.optimiser.state_dict()
            if self.small_checkpoints:
                mean = in_16_bits(self.average.state_dict())
                states = mean, mean, {}
            Checkpoint(self.spec, self.settings, self.progress, *states, self.origin).save(self.path)
        self.losses.clear()

    def _learning_rate(self) -> float:
        """Linear warm-up, then half a cosine down to a hundredth; the warm-up is the same however long the run."""
        step, warm = self.progress.step, self.settings.warmup_steps
        warmed = self.settings.learning_rate * min(1.0, (step - self._optimiser_since + 1) / max(warm, 1))
        if step < warm or self.progress.steps is None:
            return warmed
        half_cosine = 0.5 * (1.0 + math.cos(math.pi * (step - warm) / (self.progress.steps - warm)))
        return warmed * (0.01 + 0.99 * half_cosine)

    def _resume(self) -> None:
        saved = load_checkpoint(self.path)
        if saved.spec != self.spec:
            raise ModelError(f"{self.path}: wanted a checkpoint of {self.spec}, got one of {saved.spec}")
        self.network.load_state_dict(saved.network)
        self.average.load_state_dict(saved.average)
        self.progress, self.origin = saved.progress, saved.origin | self.origin
        if saved.optimiser:
            self.optimiser.load_state_dict(saved.optimiser)
        else:
            self._optimiser_since, self.origin["resumed_without_optimiser"] = saved.progress.step, True
        if saved.settings != self.settings:
            self.origin["resumed_with_other_settings"] = True
            self.progress.steps = None

    def _take_weights(self, path: Path) -> None:
        theirs = load_checkpoint(path)
        try:
            self.network.load_state_dict(theirs.average)
        except RuntimeError as error:
            raise ModelError(f"{path}: wanted weights for {self.spec}, got those of {theirs.spec}") from error
        self.average.load_state_dict(self.network.state_dict())
        self.origin["begun_with"] = theirs.facts()


def loss_of(name: str, logits: Tensor, target: Tensor) -> Tensor:
    """Mean loss of (N, B, B) logits against targets in [0, 1], by its name in `LOSSES`."""
    each = nn.functional.binary_cross_entropy_with_logits(logits, target, reduction="none")
    if name == "bce":
        return each.mean()
    if name not in LOSSES:
        raise InvalidQueryError(f"loss must be one of {', '.join(LOSSES)}, got {name!r}")
    p = torch.sigmoid(logits)
    if name == "focal":
        return ((target - p).square() * each).mean()
    overlap = 2.0 * (p * target).sum((1, 2)) / (p.square() + target.square()).sum((1, 2)).clamp_min(1e-6)
    return (1.0 - overlap).mean() + each.mean()


def _history_row(progress: Progress, loss: float, judgements: list[Judgement]) -> dict[str, float]:
    spent_s = round(progress.spent_s, 1)
    row: dict[str, float] = {"step": progress.step, "epoch": progress.epoch, "spent_s": spent_s, "loss": loss}
    for j in judgements:
        row |= {f"{name}@{j.factor:g}": value for name, value in asdict(j).items() if name != "factor"}
    return row
