"""Checkpoints of a training run: settings, progress, weights; enough to resume and to export."""

import io
import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import msgspec
import torch
from torch import Tensor

from nnpp_edge.files import write_all
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.reading import problem_with_file
from nnpp_edge.training.settings import TrainSettings

BEST = "best.pt"
LAST = "last.pt"
HISTORY = "history.json"
_DECIDING = (
    "batch",
    "learning_rate",
    "weight_decay",
    "warmup_steps",
    "target",
    "softness",
    "seed",
    "average_decay",
    "precision",
)
"""Settings that decide the weights."""
State = dict[str, Tensor]
"""A network's parameters and buffers by name."""


@dataclass
class Progress:
    """The state of a training run; `history` has a row for each validation."""

    epoch: int = 0
    step: int = 0
    step_in_epoch: int = 0
    spent_s: float = 0.0
    steps: int | None = None
    """The step at which the training ends, once that is known; `TrainSettings.steps` of that number
    repeats it.
    """
    history: list[dict[str, float]] = field(default_factory=list)

    @property
    def best(self) -> int:
        """Number of the validation with the least score; the first of equal ones."""
        return min(range(len(self.history)), key=lambda at: self.history[at]["score"])

    @property
    def waited(self) -> int:
        """Validations since the best."""
        return len(self.history) - 1 - self.best


@dataclass(frozen=True)
class Checkpoint:
    """All that a run saved; `average` holds the running mean of the weights in `network`."""

    spec: Spec
    settings: TrainSettings
    progress: Progress
    network: State
    average: State
    optimiser: dict[str, object]
    origin: dict[str, object] = field(default_factory=dict)
    """Where else the weights come from: ``torch`` (its version), ``threads``, ``begun_with``
    (`facts` of the run whose weights this one began with), ``resumed_with_other_settings``."""

    def facts(self) -> dict[str, object]:
        """Facts that decided the weights, for a model's metadata."""
        return {
            "steps": self.progress.step,
            "of_steps": self.progress.steps,
            "epochs": self.progress.epoch,
            "seconds": round(self.progress.spent_s, 1),
            **{name: getattr(self.settings, name) for name in _DECIDING},
            "input_size": self.spec.input_size,
            **self.origin,
        }

    def trained(self) -> Network:
        """The averaged network, in evaluation mode."""
        network = Network(self.spec)
        network.load_state_dict(self.average)
        return network.eval()

    def save(self, path: Path) -> None:
        """Write the checkpoint, and its history as JSON beside it; OutputError if that fails."""
        found = {each.name: getattr(self, each.name) for each in fields(self)}
        for name in ("spec", "settings", "progress"):
            found[name] = asdict(found[name])
        content = io.BytesIO()
        torch.save(found, content)
        history = json.dumps(self.progress.history, indent=1).encode()
        write_all({path: content.getbuffer(), path.with_name(HISTORY): history})


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint; ModelError if the file is not one of ours."""
    wanted = f"{path}: wanted a checkpoint of nnpp-edge train"
    problem = problem_with_file(path)
    if problem is not None:
        raise ModelError(f"{wanted} ({problem})")
    try:
        found = msgspec.convert(torch.load(path, map_location="cpu", weights_only=True), Checkpoint)
        found.trained()
        if not all(values.isfinite().all() for values in found.average.values()):
            raise ValueError("its weights are not finite")
    except msgspec.ValidationError as error:
        raise ModelError(f"{wanted}, got {error}") from error
    # torch raises nearly every kind of error on bad bytes, with long messages
    except Exception as error:
        raise ModelError(f"{wanted}, got another file, or a damaged one") from error
    return found
