"""The paper's claims beside the measured figures, judged by plain rules."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from nnpp_edge.reproduction.planners import CONTROLS_OF
from nnpp_edge.reproduction.rows import Rows, percent


class Verdict(StrEnum):
    """How our figure compares with the paper's."""

    AGREES = "agrees"
    BETTER = "better than the paper's"
    DIFFERS = "does not agree"
    TOO_FEW = "too few queries to say"


@dataclass(frozen=True)
class Finding:
    """One claim of the paper, beside the measured figure."""

    claim: str
    paper: str
    ours: str
    rule: str
    """When it counts as agreeing."""
    verdict: Verdict
    controls: tuple[str, ...] = ()
    """Controls that meet the rule as well: then it says nothing about the network."""


ENOUGH = 100
"""Queries from which on a verdict needs no interval."""
SAMPLES = 200
_PLACE = ("scene", "size")
_NONE = Rows()
Rule = Callable[[Rows], bool]
"""Whether rows are as claimed."""


def judge(
    claim: str,
    paper: str,
    ours: str,
    rule: str,
    holds: bool | Rule,
    rows: Rows = _NONE,
    planner: str = "",
    *,
    better: bool = False,
    figure: Callable[[Rows], float] | None = None,
    shown: Callable[[float], str] = str,
) -> Finding:
    """A finding: whether its rule holds, and, where it is a rule on `rows`, with which controls in
    place of the planner's network it holds as well.

    Of few queries it is said whether they are enough: samples of them, drawn with replacement, must
    nearly all give the same verdict. With a `figure` of the rows the interval of those is `shown`.
    """
    drawn = drawn_anew(rows) if callable(holds) else []
    if drawn and figure is not None:
        low, high = np.nanquantile([figure(each) for each in drawn], (0.025, 0.975))
        ours += f" ({shown(low)} to {shown(high)})"
    if callable(holds) and drawn:
        agreed = np.mean([holds(each) for each in drawn])
        if 0.025 < agreed < 0.975:
            return Finding(claim, paper, ours, rule, Verdict.TOO_FEW)
    verdict = Verdict.BETTER if better else Verdict.AGREES
    earned = []
    if callable(holds):
        for kind, name in CONTROLS_OF.get(planner, {}).items():
            if rows.of(name) and holds(with_control(rows, kind)):
                earned.append(kind)
        holds = holds(rows)
    if not holds:
        return Finding(claim, paper, ours, rule, Verdict.DIFFERS)
    return Finding(claim, paper, ours, rule, verdict, tuple(earned))


def drawn_anew(rows: Rows) -> list[Rows]:
    """Samples of the queries, as many of each scene and size, with replacement; none where one has
    so many that a verdict does not hang on a few, or all have one.
    """
    places = [list(of.groups(("map", "goal")).values()) for of in rows.groups(_PLACE).values()]
    counts = [len(queries) for queries in places]
    if not 1 < max(counts, default=0) < ENOUGH:
        return []
    rng = np.random.default_rng(1)
    return [
        Rows(
            row
            for queries in places
            for at in rng.integers(len(queries), size=len(queries))
            for row in queries[at]
        )
        for _ in range(SAMPLES)
    ]


def with_control(rows: Rows, kind: str) -> Rows:
    """The rows with a control's answers under the names of the planners that it stands in for."""
    swapped = Rows(row for row in rows if row["planner"] not in CONTROLS_OF)
    for planner, controls in CONTROLS_OF.items():
        stand_in = controls.get(kind, planner)
        swapped += [{**row, "planner": planner} for row in rows.of(stand_in)]
    return swapped


def judge_speedup(
    claim: str,
    theirs: float,
    rows: Rows,
    slow: str,
    fast: str,
    *,
    near: bool = False,
) -> Finding:
    """A finding on the speed-up of one planner over another: theirs within 25 %, or more.

    With `near` a control counts where its CC increase is no more than a point above the network's.
    """
    ours = rows.speedup(slow, fast)
    most = rows.increase(fast) + 0.01

    def holds(rows: Rows) -> bool:
        as_good = not near or rows.increase(fast) <= most
        return as_good and rows.speedup(slow, fast) >= 0.75 * theirs

    return judge(
        claim,
        f"{theirs:.1f}×",
        f"{ours:.3g}×",
        "within 25 % of the paper's",
        holds,
        rows,
        fast,
        better=ours > 1.25 * theirs,
        figure=lambda rows: rows.speedup(slow, fast),
        shown=lambda gain: f"{gain:.3g}×",
    )


def judge_increase(claim: str, theirs: float, rows: Rows, planner: str) -> Finding:
    """A finding on the share by which a planner's CC exceeds the optimum: theirs within one point,
    or less.
    """
    ours = rows.increase(planner)
    return judge(
        claim,
        percent(theirs),
        percent(ours, 2),
        "within one point",
        lambda rows: rows.increase(planner) <= theirs + 0.01,
        rows,
        planner,
        better=ours < theirs - 0.01,
        figure=lambda rows: rows.increase(planner),
        shown=lambda share: percent(share, 2),
    )
