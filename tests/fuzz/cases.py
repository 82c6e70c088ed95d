"""A case, where it is checked, and what an oracle finds wrong with it: the words that all targets
share.

A target is a module with `generate(rng, place)` and `check(case, place)`: the random numbers decide
all of a case.
"""

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from nnpp_edge.runtime import Status

EXACT = 3e-5
"""Share by which an exact path may cost more than Dijkstra's: g is kept in float32, over hundreds
of steps.
"""


class Case(SimpleNamespace):
    """What was drawn, by name; `steps`, where there are any, are done one after another, and
    printed on a line each.
    """

    def __repr__(self):
        with np.printoptions(threshold=60, linewidth=200):
            return super().__repr__().replace("('", "\n  ('")


@dataclass(frozen=True)
class Problem:
    """What an oracle found."""

    kind: str  # in a few words; findings of one kind and place are counted together
    detail: str = ""


@functools.lru_cache(maxsize=4)
def _tiny(folder):
    from nnpp_edge.runtime import NetworkModel

    return NetworkModel(folder / "tiny.onnx", threads=1)


@dataclass(frozen=True)
class Place:
    """Where the samples are, and which folder a case may write to."""

    samples: Path | None = None
    folder: Path | None = None

    @property
    def model(self):
        """The smallest network, loaded once in a process."""
        return "edge" if self.samples is None else _tiny(self.samples)

    def sample(self, name):
        """A sample's content."""
        return (self.samples / name).read_bytes()


NOWHERE = Place()


def put(dem, row, col, patch):
    """Write a patch into a map."""
    dem[row : row + patch.shape[0], col : col + patch.shape[1]] = patch


def problem_with_plan(
    plan,
    stands,
    ends,
    optimum_of,
    path_problem,
    path_cost,
    *,
    exact,
    epsilon=math.inf,
    told="",
    also=(),
):
    """What is wrong with an answer on cells that `stands` (H, W) bool says one can stand on.

    `optimum_of` gives the cost of the best path between the `ends`, inf without one. `also` are the
    answers that are right, too, where one cannot stand at an end.
    """
    facts = f"{plan}\n{told}"
    for status, cell in zip((Status.START_BLOCKED, Status.GOAL_BLOCKED), ends, strict=True):
        if not stands[cell]:
            right = plan.status in (status, *also)
            return None if right else Problem(f"{plan.status} for {status}: {plan.planner}", facts)
    optimum = float(optimum_of(*ends))
    facts += f"\noptimum {optimum!r}"
    wrong = ""
    if not math.isfinite(optimum):
        wrong = "" if plan.status is Status.NO_PATH else f"{plan.status} where there is no path"
    elif plan.status is not Status.OK:
        wrong = f"{plan.status} where there is a path"
    else:
        path = [tuple(map(int, cell)) for cell in plan.path]
        wrong = path_problem(path)
        cost = math.nan if wrong else path_cost(path)
        most = (1.0 + EXACT) * optimum
        checks = {
            "its cost is not its path's": abs(cost - plan.cost) > 1e-5 * cost,
            "below the optimum": cost < optimum * (1.0 - EXACT),
            "not the optimum": exact and cost > most,
            "its lower bound is above the optimum": plan.lower_bound > most,
            "more than 1 + epsilon times the optimum": cost > (1.0 + epsilon) * most,
        }
        wrong = wrong or next((kind for kind, found in checks.items() if found), "")
    return Problem(f"{wrong}: {plan.planner}", facts) if wrong else None
