"""How a network is trained. Nothing here needs torch, so that commands have their options at
once.
"""

import math
from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """What users choose, each with its words; the optimiser's defaults are the paper's. `Batches`
    explains `target` and `softness`.
    """

    epochs: int = 150
    steps: Annotated[
        int | None,
        (
            "Most steps, if the epochs do not end first; the number that a time limit led to "
            "repeats that training."
        ),
    ] = None
    batch: Annotated[int, "Queries in a step."] = 32
    learning_rate: Annotated[float, Meta(gt=0.0)] = 1e-3
    weight_decay: Annotated[float, Meta(ge=0.0)] = 1e-4
    target: Annotated[
        str,
        Meta(extra={"choices": ["near", "path"]}),
        "Labels: nearness to the optimum, or the best path.",
    ] = "near"
    softness: Annotated[float, Meta(gt=0.0), "Excess at which nearness is 1/e."] = 0.02
    validations: Annotated[int, "Over the training, for history.json and best.pt."] = 20
    patience: Annotated[
        int | None, "End after so many validations in a row that are no better than the best."
    ] = None
    precision: Annotated[
        str,
        Meta(extra={"choices": ["auto", "float32", "bfloat16"]}),
        "Of the convolutions; auto: bfloat16 on a GPU. bfloat16 is twice as fast on a CPU with "
        "AMX.",
    ] = "auto"


@dataclass(frozen=True, kw_only=True)
class TrainSettings(TrainOptions):
    """How to train."""

    seed: int = 1
    warmup_steps: int = 200
    time_limit_s: float = math.inf
    """About how long the training takes, over all resumed runs: its speed in the warm-up decides
    the number of steps.
    """
    average_decay: float = 0.998
    """Of the running mean of the weights, which is what is validated and exported."""
