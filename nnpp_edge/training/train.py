"""Training: AdamW as in the paper, resumable, limited by epochs, steps or time."""

import ctypes
import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from nnpp_edge.files import make_folder
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.progress import ignore
from nnpp_edge.runtime.errors import DataSetError, ModelError
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.terrain.dataset import Queries
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.training.batches import Batch, Batches
from nnpp_edge.training.checkpoint import (
    BEST,
    LAST,
    Checkpoint,
    Progress,
    State,
    load_checkpoint,
)
from nnpp_edge.training.settings import TrainSettings
from nnpp_edge.training.unseen import KnownValidator
from nnpp_edge.training.validation import Validator

_TRIM_THRESHOLD = -1
_MMAP_MAX = -4
"""Options of glibc's mallopt."""
SAVED_EVERY_S = 300.0
REPORTED_EVERY_S = 0.5
Report = Callable[[float, str], None]
"""Called with the share done, and loss and score of the last validation in words."""


def train(
    spec: Spec,
    settings: TrainSettings,
    training: Queries,
    validation: Queries,
    folder: Path,
    *,
    omega: float,
    begin_with: Path | None = None,
    report: Report = ignore,
) -> Path:
    """Train a network, going on from the folder's last checkpoint if there is one; the path of the
    best.

    The `folder` gets ``last.pt`` (weights, running mean, optimiser, progress; loads with
    weights_only), ``best.pt`` (the running mean at the validation with the least ``score``) and
    ``history.json``. `omega` is the weight of the traversability cost per grey level, for
    validation's searches. A new run begins with the averaged weights of the checkpoint
    `begin_with`, whose input may have another size. The two data sets are of one kind.

    The run is saved every five minutes; one that was stopped goes on from there. `report` is called
    twice a second.

    ModelError where the folder's checkpoint is of another spec or `begin_with` of another network,
    DataSetError where the training set does not fit or is smaller than a batch.
    """
    keep_freed_memory()
    make_folder(folder)
    last = folder / LAST
    validator: Validator | KnownValidator
    if isinstance(validation, KnownMaps):
        validator = KnownValidator(validation)
    else:
        validator = Validator(validation, spec, omega)
    device = torch.device("cuda:0" if torch.cuda.is_available() else "cpu")
    batches = Batches(training, spec, settings, device=device)
    if not len(batches):
        raise DataSetError(
            f"wanted at least {settings.batch} samples for one batch, got {len(training)}: make "
            "more maps, or give a smaller --batch"
        )
    run = TrainingRun(spec, settings, device, len(batches))
    run.begin(last, begin_with)
    progress = run.progress
    saved = time.monotonic()

    def validate() -> None:
        validating = time.monotonic()
        progress.history.append(run.validated(validator))
        if not progress.waited:
            run.checkpoint(best=True).save(folder / BEST)
        run.validation_s = time.monotonic() - validating
        run.since_validated()

    def save() -> None:
        run.checkpoint().save(last)

    if not progress.history:
        validate()
        save()
    while not run.done:
        for batch in batches.epoch(progress.epoch, progress.step_in_epoch):
            run.step(batch)
            run.tell(report)
            if run.validation_due:
                validate()
                save()
            if time.monotonic() - saved > SAVED_EVERY_S:
                save()
                saved = time.monotonic()
            if run.done:
                break
        if progress.step_in_epoch >= len(batches):
            progress.epoch += 1
            progress.step_in_epoch = 0
    save()
    return folder / BEST


def keep_freed_memory() -> None:
    """Have the C library keep what it frees, where it is glibc: it hands large arrays back to the
    system, which takes longer to give them anew than a step takes to fill them.
    """
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        for option, value in ((_MMAP_MAX, 0), (_TRIM_THRESHOLD, -1)):
            library.mallopt(option, value)


class TrainingRun:
    """A network in training, its running mean, the optimiser and the progress."""

    def __init__(
        self, spec: Spec, settings: TrainSettings, device: torch.device, batches: int
    ) -> None:
        self.spec = spec
        self.settings = settings
        self.device = device
        torch.manual_seed(settings.seed)
        network = Network(spec).to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.network: Network = network
        self.average = Network(spec).to(device)
        self.optimiser = torch.optim.AdamW(
            network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        self.validation_s = 0.0
        """Of the last validation."""
        on_gpu = device.type == "cuda"
        self.in_bfloat16 = settings.precision == "bfloat16" or (
            settings.precision == "auto" and on_gpu
        )
        self.most = min(settings.epochs * batches, settings.steps or sys.maxsize)
        """Steps at most."""
        self.progress = Progress()
        self.origin: dict[str, object] = {
            "torch": str(torch.__version__),
            "threads": torch.get_num_threads(),
        }

    def begin(self, path: Path, other: Path | None) -> None:
        """Go on from a checkpoint, if there is one, else begin with another run's weights; start
        the clock.
        """
        average = self.network.state_dict()
        if path.exists():
            average = self._resume(path)
        elif other is not None:
            theirs = load_checkpoint(other)
            average = theirs.average
            try:
                self.network.load_state_dict(average)
            except RuntimeError as error:
                raise ModelError(
                    f"{other}: wanted weights for {self.spec}, got those of {theirs.spec}"
                ) from error
            self.origin["begun_with"] = theirs.facts()
        self.average.load_state_dict(average)
        if self.settings.time_limit_s == math.inf and self.progress.steps is None:
            self.progress.steps = self.most
        self.started = time.monotonic() - self.progress.spent_s
        self.since_validated()

    def _resume(self, path: Path) -> State:
        """Go on from a checkpoint; its average."""
        saved = load_checkpoint(path)
        if saved.spec != self.spec:
            raise ModelError(f"{path}: wanted a checkpoint of {self.spec}, got one of {saved.spec}")
        self.network.load_state_dict(saved.network)
        self.progress = saved.progress
        self.origin = saved.origin | self.origin
        with refused_as(ModelError, f"{path}: wanted the state of an optimiser"):
            self.optimiser.load_state_dict(saved.optimiser)
        if saved.settings != self.settings:
            self.origin["resumed_with_other_settings"] = True
            self.progress.steps = None
        return saved.average

    def since_validated(self) -> None:
        """Begin to count anew: loss, steps and time since the last validation."""
        self.summed = torch.zeros((), dtype=torch.float64, device=self.device)
        self.counted = 0
        self.told = time.monotonic()

    @property
    def loss(self) -> float:
        """Mean since the last validation; 0 before the first step after it."""
        return float(self.summed) / max(self.counted, 1)

    @property
    def done(self) -> bool:
        """Whether the last step has been made, or so many validations were no better than the best
        as were to be waited for.
        """
        out_of_patience = self.progress.waited >= (self.settings.patience or sys.maxsize)
        return out_of_patience or self.progress.step >= (self.progress.steps or self.most)

    @property
    def validation_due(self) -> bool:
        """Whether the step made is the last one of a part of the training, as many parts as there
        are validations.
        """
        steps = self.progress.steps or self.most
        parts = self.settings.validations
        step = self.progress.step
        return step * parts // steps > (step - 1) * parts // steps

    @property
    def share_done(self) -> float:
        """Share of the training that is done, in steps, or in time while their number is
        not known.
        """
        if self.progress.steps is None:
            return min(self.progress.spent_s / self.settings.time_limit_s, 1.0)
        return self.progress.step / self.progress.steps

    def step(self, batch: Batch) -> None:
        """Learn from one batch."""
        for group in self.optimiser.param_groups:
            group["lr"] = self._learning_rate()
        loss = self._loss(batch)
        self.optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimiser.step()
        self.summed += loss.detach()
        self.counted += 1
        progress = self.progress
        decay = min(self.settings.average_decay, (1 + progress.step) / (10 + progress.step))
        with torch.no_grad():
            torch._foreach_lerp_(
                list(self.average.parameters()), list(self.network.parameters()), 1.0 - decay
            )
        progress.step += 1
        progress.step_in_epoch += 1
        progress.spent_s = time.monotonic() - self.started
        # under a time limit the speed of the warm-up decides the number of steps
        limit_s = self.settings.time_limit_s
        warmed = progress.step >= self.settings.warmup_steps or progress.spent_s >= limit_s
        if progress.steps is None and warmed:
            # the validations to come take time, too: at most half of it
            to_validate_s = self.settings.validations * self.validation_s
            for_steps_s = max(limit_s - to_validate_s, 0.5 * limit_s)
            in_time = int(progress.step * for_steps_s / progress.spent_s)
            progress.steps = min(self.most, max(progress.step, in_time))

    def _loss(self, batch: Batch) -> Tensor:
        maps, facts, target = batch
        maps = maps.contiguous(memory_format=torch.channels_last)
        shown = self.network.shown(maps, facts)
        self.network.train()
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.in_bfloat16):
            logits = self.network(*shown)
        return binary_cross_entropy_with_logits(logits.float(), target)

    def _learning_rate(self) -> float:
        """Linear warm-up, then half a cosine down to a hundredth; the warm-up is the same however
        long the run.
        """
        step = self.progress.step
        steps = self.progress.steps
        warmup = self.settings.warmup_steps
        rate = self.settings.learning_rate * min(1.0, (step + 1) / max(warmup, 1))
        if step < warmup or steps is None:
            return rate
        cosine = math.cos(math.pi * (step - warmup) / (steps - warmup))
        return rate * (0.01 + 0.99 * 0.5 * (1.0 + cosine))

    def tell(self, report: Report) -> None:
        """Report the share done with the loss and the last score beside the best, now and then."""
        now = time.monotonic()
        if now - self.told < REPORTED_EVERY_S:
            return
        self.told = now
        history = self.progress.history
        best = history[self.progress.best]
        score = f"score {history[-1]['score']:.4f} (best {best['score']:.4f})"
        report(self.share_done, f"loss {self.loss:.4f}, {score}")

    def validated(self, validator: Validator | KnownValidator) -> dict[str, float]:
        """The history's row for the running mean, with the mean loss since the last one."""
        # the batch norms' statistics are not averaged
        for theirs, ours in zip(self.network.buffers(), self.average.buffers(), strict=True):
            ours.copy_(theirs)
        row: dict[str, float] = {
            "step": self.progress.step,
            "epoch": self.progress.epoch,
            "spent_s": round(self.progress.spent_s, 1),
        }
        if self.counted:
            row["loss"] = self.loss
        judged = validator.judge(self.average)
        return row | asdict(judged) | {"score": judged.score}

    def checkpoint(self, *, best: bool = False) -> Checkpoint:
        """All of the run; of the `best` only the running mean."""
        network = self.network.state_dict()
        average = self.average.state_dict()
        optimiser = self.optimiser.state_dict()
        if best:
            network = average
            optimiser = {}
        return Checkpoint(
            self.spec, self.settings, self.progress, network, average, optimiser, self.origin
        )
