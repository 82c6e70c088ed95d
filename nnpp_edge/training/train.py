"""Training: AdamW as in the paper, resumable, limited by epochs or by time, on one device or several."""

import contextlib
import io
import json
import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch import distributed as dist

from nnpp_edge.files import make_folder, write_whole
from nnpp_edge.model.registry import Network, Spec
from nnpp_edge.runtime.errors import InvalidQueryError, ModelError
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.training.batches import Batches
from nnpp_edge.training.validation import Judgement, Validator

CHECKPOINT = "checkpoint.pt"
LOSSES = ("bce", "focal", "dice")
"""Binary cross-entropy; the same weighted by (target - p)², for targets between 0 and 1 too; one minus the soft
overlap of target and answer, plus cross-entropy."""


@dataclass(frozen=True)
class TrainSettings:
    """How to train; the optimiser's defaults are the paper's."""

    epochs: int = 150
    batch: int = 32
    """Queries in a step, over all processes."""
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    steps: int | None = None
    """Training ends after so many, if its epochs have not ended it before."""
    warmup_steps: int = 200
    target: str = "near"
    softness: float = 0.02
    loss: str = "bce"
    """One of `LOSSES`."""
    seed: int = 1
    time_limit_s: float = math.inf
    """Training ends when this has passed, over all resumed runs; the learning rate falls towards that end."""
    validate_every_s: float = 300.0
    average_decay: float = 0.998
    """Of the running mean of the weights, which is what is validated and exported."""


@dataclass
class Progress:
    """Where a training run stands; saved with the checkpoint."""

    epoch: int = 0
    step: int = 0
    step_in_epoch: int = 0
    spent_s: float = 0.0
    history: list[dict[str, float]] = field(default_factory=list)


def train(
    spec: Spec,
    settings: TrainSettings,
    training: Samples,
    validation: Samples,
    folder: Path,
    *,
    omega: float,
    begin_with: Path | None = None,
    report: Callable[[Progress, float, float], None] = lambda progress, loss, share: None,
) -> Path:
    """Train a network, going on from the folder's checkpoint if there is one.

    Parameters
    ----------
    spec, settings
        What to train, and how. A checkpoint of another spec is refused.
    training, validation : Samples
        Labelled queries.
    folder : Path
        Gets ``checkpoint.pt`` (weights, running mean, optimiser, progress; loads with weights_only) and
        ``history.json``.
    omega : float
        Weight of the traversability cost per grey level, for validation's searches.
    begin_with : Path, optional
        Checkpoint of another run whose averaged weights a new run begins with; its input may have been of
        another size.
    report : callable
        Told the progress, the latest mean loss and the share of the training that is done.

    Returns
    -------
    Path
        Of the checkpoint.

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
    process's. On CUDA the network runs in bfloat16.
    """
    rank, world, device = _join_processes()
    if settings.batch % world:
        raise InvalidQueryError(f"batch must be a multiple of the {world} processes, got {settings.batch}")
    torch.manual_seed(settings.seed)
    network = Network(spec).to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = Network(spec).to(device)
    average.load_state_dict(network.state_dict())
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
    progress = Progress()
    make_folder(folder)
    path = folder / CHECKPOINT
    if path.exists():
        progress = _resume(path, spec, network, average, optimiser, device)
    elif begin_with is not None:
        _begin_with(begin_with, network, average)
    batches = Batches(
        training, spec, settings.batch // world, target=settings.target, softness=settings.softness,
        seed=settings.seed, rank=rank, world=world,
    )  # fmt: skip
    validator = Validator(validation, spec, omega) if rank == 0 else None
    wrapped: nn.Module = network
    if world > 1:
        wrapped = nn.parallel.DistributedDataParallel(
            network, device_ids=[device.index] if device.type == "cuda" else None
        )
    began, before = time.monotonic(), progress.spent_s
    total = min(settings.epochs * len(batches), settings.steps or sys.maxsize)
    losses: list[float] = []
    validated = time.monotonic()

    def share() -> float:
        return max(progress.step / total, progress.spent_s / settings.time_limit_s)

    def stand() -> None:
        """Validate what was learned since the last time, and save (all processes; the first does the work)."""
        loss = _mean(float(np.mean(losses)), world, device) if losses else None
        if validator is not None:
            if loss is not None:
                _copy_buffers(network, average)
                progress.history.append(_row(progress, loss, validator.judge(average)))
            _save(path, spec, settings, network, average, optimiser, progress)
        losses.clear()

    while share() < 1.0 and progress.epoch < settings.epochs:
        for planes, query, target in batches.epoch(progress.epoch, progress.step_in_epoch):
            for group in optimiser.param_groups:
                group["lr"] = _rate(settings, progress.step, share())
            losses.append(_step(wrapped, optimiser, planes, query, target, device, settings.loss))
            _follow(average, network, min(settings.average_decay, (1 + progress.step) / (10 + progress.step)))
            progress.step += 1
            progress.step_in_epoch += 1
            progress.spent_s = _agree(before + time.monotonic() - began, world, device)
            if rank == 0:
                report(progress, float(np.mean(losses[-50:])), min(share(), 1.0))
            if _agree(time.monotonic() - validated, world, device) > settings.validate_every_s:
                stand()
                validated = time.monotonic()
            if progress.spent_s >= settings.time_limit_s or progress.step == settings.steps:
                break
        else:
            progress.epoch += 1
            progress.step_in_epoch = 0
    stand()
    if world > 1:
        dist.barrier()
        dist.destroy_process_group()
    return path


def load_checkpoint(path: Path) -> tuple[Network, dict[str, Any]]:
    """The averaged network of a checkpoint, in evaluation mode, and the rest of what was saved.

    Raises
    ------
    ModelError
        The file is no checkpoint of ours.
    """
    try:
        saved = torch.load(path, map_location="cpu", weights_only=True)
        network = Network(Spec(**saved["spec"]))
        network.load_state_dict(saved["average"])
    except (OSError, RuntimeError, KeyError, TypeError, EOFError, ValueError) as error:
        line = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ModelError(f"{path}: wanted a checkpoint of nnpp-edge train, got {line}") from error
    except Exception as error:  # torch raises pickle errors of several kinds
        raise ModelError(f"{path}: wanted a checkpoint of nnpp-edge train, got another file") from error
    return network.eval(), saved


def _join_processes() -> tuple[int, int, torch.device]:
    world = int(os.environ.get("WORLD_SIZE", "1"))
    cuda = torch.cuda.is_available()
    if world == 1:
        return 0, 1, torch.device("cuda", 0) if cuda else torch.device("cpu")
    dist.init_process_group("nccl" if cuda else "gloo")
    device = torch.device("cuda", int(os.environ["LOCAL_RANK"])) if cuda else torch.device("cpu")
    return dist.get_rank(), world, device


def _agree(seconds: float, world: int, device: torch.device) -> float:
    """The first process's clock, so that all of them take the same turn."""
    if world == 1:
        return seconds
    shared = torch.tensor([seconds], dtype=torch.float64, device=device)
    dist.broadcast(shared, 0)
    return float(shared.item())


def _mean(value: float, world: int, device: torch.device) -> float:
    """Mean over the processes."""
    if world == 1:
        return value
    shared = torch.tensor([value], dtype=torch.float64, device=device)
    dist.all_reduce(shared)
    return float(shared.item()) / world


def _rate(settings: TrainSettings, step: int, share: float) -> float:
    """Linear warm-up, then half a cosine down to a hundredth."""
    warm = min(1.0, (step + 1) / settings.warmup_steps)
    return settings.learning_rate * warm * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0))))


def _step(
    network: nn.Module,
    optimiser: torch.optim.Optimizer,
    planes: Any,
    query: Any,
    target: Any,
    device: torch.device,
    loss_name: str,
) -> float:
    half = torch.autocast("cuda", torch.bfloat16) if device.type == "cuda" else contextlib.nullcontext()
    network.train()
    x = torch.from_numpy(planes).to(device, non_blocking=True).float() / 255.0
    with half:
        logits = network(
            x.contiguous(memory_format=torch.channels_last),
            torch.from_numpy(query).to(device, non_blocking=True),
        )
    loss = loss_of(loss_name, logits.float(), torch.from_numpy(target).to(device, non_blocking=True))
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), 1.0)
    optimiser.step()
    return float(loss.detach())


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


@torch.no_grad()
def _follow(average: Network, network: Network, decay: float) -> None:
    torch._foreach_lerp_(list(average.parameters()), list(network.parameters()), 1.0 - decay)


def _copy_buffers(network: Network, average: Network) -> None:
    """Take over the batch norms' statistics."""
    for theirs, ours in zip(network.buffers(), average.buffers(), strict=True):
        ours.copy_(theirs)


def _row(progress: Progress, loss: float, judgements: list[Judgement]) -> dict[str, float]:
    row: dict[str, float] = {
        "step": progress.step, "epoch": progress.epoch, "spent_s": round(progress.spent_s, 1),
        "loss": loss,
    }  # fmt: skip
    for j in judgements:
        row |= {f"{name}@{j.factor:g}": value for name, value in asdict(j).items() if name != "factor"}
    return row


def _save(
    path: Path, spec: Spec, settings: TrainSettings, network: Network, average: Network,
    optimiser: torch.optim.Optimizer, progress: Progress,
) -> None:  # fmt: skip
    content: dict[str, Tensor | Any] = {
        "spec": spec.as_dict(),
        "settings": asdict(settings),
        "network": network.state_dict(),
        "average": average.state_dict(),
        "optimiser": optimiser.state_dict(),
        "progress": asdict(progress),
    }
    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_whole(path, buffer.getbuffer())
    write_whole(path.with_name("history.json"), json.dumps(progress.history, indent=1).encode())


def _resume(
    path: Path, spec: Spec, network: Network, average: Network, optimiser: torch.optim.Optimizer,
    device: torch.device,
) -> Progress:  # fmt: skip
    _, saved = load_checkpoint(path)
    if Spec(**saved["spec"]) != spec:
        raise ModelError(f"{path}: wanted a checkpoint of {spec}, got one of {Spec(**saved['spec'])}")
    network.load_state_dict(saved["network"])
    average.load_state_dict(saved["average"])
    optimiser.load_state_dict(saved["optimiser"])
    return Progress(**saved["progress"])


def _begin_with(path: Path, network: Network, average: Network) -> None:
    theirs, _ = load_checkpoint(path)
    try:
        network.load_state_dict(theirs.state_dict())
    except RuntimeError as error:
        raise ModelError(f"{path}: wanted weights for {network.spec}, got those of {theirs.spec}") from error
    average.load_state_dict(network.state_dict())
