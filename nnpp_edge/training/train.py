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
from torch.nn.functional import binary_cross_entropy_with_logits

from nnpp_edge.files import make_folder
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import InvalidQueryError, ModelError
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.training.batches import Batch, Batches
from nnpp_edge.training.checkpoint import Checkpoint, Progress, TrainSettings, in_16_bits, load_checkpoint
from nnpp_edge.training.processes import Processes
from nnpp_edge.training.validation import Validator

__all__ = ["Progress", "TrainSettings", "train"]

CHECKPOINT = "checkpoint.pt"
Loss = Callable[[Tensor, Tensor], Tensor]
"""Mean loss of (N, B, B) logits against targets in [0, 1]."""
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
    loss: Loss = binary_cross_entropy_with_logits,
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
    validates, writes and reports.
    """
    processes = Processes.join()
    if settings.batch % processes.world:
        raise InvalidQueryError(f"batch must be a multiple of the {processes.world} processes, got {settings.batch}")
    make_folder(folder)
    run = _Run(spec, settings, loss, processes, folder / CHECKPOINT, begin_with, small_checkpoints)
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
        self,
        spec: Spec,
        settings: TrainSettings,
        loss: Loss,
        processes: Processes,
        path: Path,
        begin_with: Path | None,
        small_checkpoints: bool,
    ) -> None:
        self.spec, self.settings, self.loss, self.processes, self.path = spec, settings, loss, processes, path
        self.small_checkpoints = small_checkpoints
        self.device = processes.device
        torch.manual_seed(settings.seed)
        self.network = Network(spec).to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = Network(spec).to(self.device)
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        self.progress = Progress()
        precisions = ("bfloat16", "auto") if self.device.type == "cuda" else ("bfloat16",)
        self.in_bfloat16 = settings.precision in precisions
        self.optimiser_since = 0
        """Step from which on the optimiser has learned."""
        self.origin: dict[str, object] = {
            "torch": str(torch.__version__),
            "threads": torch.get_num_threads(),
            "loss": getattr(loss, "__name__", type(loss).__name__),
        }
        self.losses: list[float] = []
        """Of the steps since the last validation."""
        if path.exists():
            self._resume(load_checkpoint(path))
        else:
            if begin_with is not None:
                self._take_weights(begin_with)
            self.average.load_state_dict(self.network.state_dict())

    def _resume(self, saved: Checkpoint) -> None:
        if saved.spec != self.spec:
            raise ModelError(f"{self.path}: wanted a checkpoint of {self.spec}, got one of {saved.spec}")
        self.network.load_state_dict(saved.network)
        self.average.load_state_dict(saved.average)
        self.progress, self.origin = saved.progress, saved.origin | self.origin
        if saved.optimiser:
            self.optimiser.load_state_dict(saved.optimiser)
        else:
            self.optimiser_since, self.origin["resumed_without_optimiser"] = saved.progress.step, True
        if saved.settings != self.settings:
            self.origin["resumed_with_other_settings"] = True
            self.progress.steps = None

    def _take_weights(self, path: Path) -> None:
        theirs = load_checkpoint(path)
        try:
            self.network.load_state_dict(theirs.average)
        except RuntimeError as error:
            raise ModelError(f"{path}: wanted weights for {self.spec}, got those of {theirs.spec}") from error
        self.origin["begun_with"] = theirs.facts()

    def start(self, batches: int) -> None:
        """Start the clock of a run with so many batches to an epoch."""
        self.wrapped = self.processes.averaging_gradients(self.network)
        self.most = min(self.settings.epochs * batches, self.settings.steps or sys.maxsize)
        if self.settings.time_limit_s == math.inf:
            self.progress.steps = self.most
        self.started = time.monotonic() - self.progress.spent_s

    def done(self) -> bool:
        """Whether the last step has been made."""
        return self.progress.steps is not None and self.progress.step >= self.progress.steps

    def share_done(self) -> float:
        """Share of the training that is done, in steps, or in time while their number is not known."""
        done, of = (self.progress.spent_s, self.settings.time_limit_s)
        if self.progress.steps is not None:
            done, of = self.progress.step, self.progress.steps
        return min(done / of, 1.0)

    def step(self, batch: Batch) -> None:
        """Learn from one batch."""
        progress, limit_s = self.progress, self.settings.time_limit_s
        for group in self.optimiser.param_groups:
            group["lr"] = self._learning_rate()
        planes, query, target = (torch.from_numpy(array).to(self.device, non_blocking=True) for array in batch)
        self.network.train()
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.in_bfloat16):
            logits = self.wrapped((planes.float() / 255.0).contiguous(memory_format=torch.channels_last), query)
        loss = self.loss(logits.float(), target)
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
        progress.spent_s = self.processes.of_the_first(time.monotonic() - self.started)
        if progress.steps is None and (progress.step >= self.settings.warmup_steps or progress.spent_s >= limit_s):
            progress.steps = min(self.most, max(progress.step, int(progress.step * limit_s / progress.spent_s)))

    def _learning_rate(self) -> float:
        """Linear warm-up, then half a cosine down to a hundredth; the warm-up is the same however long the run."""
        step, warm, steps = self.progress.step, self.settings.warmup_steps, self.progress.steps
        warmed = self.settings.learning_rate * min(1.0, (step - self.optimiser_since + 1) / max(warm, 1))
        if step < warm or steps is None:
            return warmed
        return warmed * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * (step - warm) / (steps - warm))))

    def validate_and_save(self, validator: Validator | None) -> None:
        """Validate what was learned since the last time, and save. The first process alone has a validator."""
        loss = self.processes.mean(float(np.mean(self.losses))) if self.losses else None
        self.losses.clear()
        if validator is None:
            return
        progress = self.progress
        if loss is not None:
            for theirs, ours in zip(self.network.buffers(), self.average.buffers(), strict=True):
                ours.copy_(theirs)  # the batch norms' statistics
            row = {
                "step": progress.step,
                "epoch": progress.epoch,
                "spent_s": round(progress.spent_s, 1),
                "loss": loss,
            }
            for judged in validator.judge(self.average):
                row |= {
                    f"{name}@{judged.factor:g}": value for name, value in asdict(judged).items() if name != "factor"
                }
            progress.history.append(row)
        states = self.network.state_dict(), self.average.state_dict(), self.optimiser.state_dict()
        if self.small_checkpoints:
            mean = in_16_bits(self.average.state_dict())
            states = mean, mean, {}
        Checkpoint(self.spec, self.settings, progress, *states, self.origin).save(self.path)
