"""The paper's claims beside what was measured, judged by plain rules."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from nnpp_edge.reproduction.planners import CONTROLS_OF
from nnpp_edge.reproduction.rows import Rows, percent


class Verdict(StrEnum):
    """How a figure of ours stands to the paper's."""

    AGREES = "agrees"
    BETTER = "better than the paper's"
    DIFFERS = "does not agree"


@dataclass(frozen=True)
class Finding:
    """One claim of the paper, beside what was measured."""

    claim: str
    paper: str
    ours: str
    rule: str
    """When it counts as agreeing."""
    verdict: Verdict
    controls: tuple[str, ...] = ()
    """Controls that meet the rule as well: then it says nothing about the network."""


Own = Callable[[str], str]
"""Gives for a planner's name that of who stands for it: the planner itself, or its control."""
Rule = Callable[[Own], bool]
"""Whether figures are as claimed."""


def judge(
    claim: str,
    paper: str,
    ours: str,
    rule: str,
    holds: bool | Rule,
    rows: Rows | None = None,
    planner: str = "",
    *,
    better: bool = False,
) -> Finding:
    """A finding: whether the rule holds, and for which controls of a planner in `rows` it does as
    well.
    """
    meets: Rule = holds if callable(holds) else lambda own: holds
    if not meets(lambda name: name):
        return Finding(claim, paper, ours, rule, Verdict.DIFFERS)
    kinds = [kind for kind, name in CONTROLS_OF.get(planner, {}).items() if rows and rows.of(name)]

    def earned_by(kind: str) -> bool:
        return bool(meets(lambda name: CONTROLS_OF.get(name, {}).get(kind, name)))

    earned = [kind for kind in kinds if earned_by(kind)]
    return Finding(
        claim, paper, ours, rule, Verdict.BETTER if better else Verdict.AGREES, tuple(earned)
    )


def judge_speedup(
    claim: str, theirs: float, rows: Rows, pair: tuple[str, str], *, near: bool = False
) -> Finding:
    """A finding on the speed-up of the second planner over the first, which should be theirs within
    25 %, or more.

    With `near` a control counts where its CC increase is no more than a point above the network's.
    """
    slow, fast = pair
    ours = rows.speedup(slow, fast)
    most = rows.increase(fast) + 0.01

    def holds(own: Own) -> bool:
        return rows.speedup(own(slow), own(fast)) >= 0.75 * theirs and not (
            near and rows.increase(own(fast)) > most
        )

    texts = (f"{theirs:.1f}×", f"{ours:.3g}×")
    rule = "within 25 % of the paper's"
    return judge(claim, *texts, rule, holds, rows, fast, better=ours > 1.25 * theirs)


def judge_increase(claim: str, theirs: float, rows: Rows, planner: str) -> Finding:
    """A finding on the share by which a planner's CC lies above the optimum: theirs within one
    point, or less.
    """
    ours = rows.increase(planner)
    within = theirs + 0.01
    texts = (percent(theirs), percent(ours, 2))
    rule = "within one point"
    better = ours < theirs - 0.01
    return judge(
        claim,
        *texts,
        rule,
        lambda own: rows.increase(own(planner)) <= within,
        rows,
        planner,
        better=better,
    )
