"""The paper's claims beside the measured figures, judged by plain rules."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction.planners import CONTROLS_OF
from nnpp_edge.reproduction.table import percent


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

    @property
    def cells(self) -> tuple[str, ...]:
        """Its line in a table."""
        controls = ", ".join(self.controls) or "–"
        return self.claim, self.paper, self.ours, self.rule, controls


ENOUGH = 100
"""Queries from which on a verdict needs no interval."""
SAMPLES = 200
_PLACE = ("scene", "size")
Figure = Callable[[Rows], float]
Rule = Callable[[Rows], bool]
"""Whether rows are as claimed."""


def stated(
    claim: str, paper: str, ours: str, rule: str, holds: object, *, better: bool = False
) -> Finding:
    """A finding that has no controls, and hangs on no few queries."""
    met = Verdict.BETTER if better else Verdict.AGREES
    return Finding(claim, paper, ours, rule, met if holds else Verdict.DIFFERS)


def judge(
    claim: str,
    paper: str,
    ours: str | Callable[[float], str],
    rule: str,
    holds: Rule,
    rows: Rows,
    planner: str,
    *,
    figure: Figure | None = None,
    better: bool = False,
) -> Finding:
    """A finding: whether its rule holds of the rows, and with which controls in place of the
    planner's network it holds as well.

    Of few queries it is said whether they are enough: samples of them, drawn with replacement, must
    nearly all give the same verdict. With a `figure` of the rows `ours` writes it, and the interval
    of the samples behind it.
    """
    drawn = drawn_anew(rows)
    if figure is not None:
        assert not isinstance(ours, str)
        words = ours(figure(rows))
        if drawn:
            low, high = np.nanquantile([figure(each) for each in drawn], (0.025, 0.975))
            words += f" ({ours(low)} to {ours(high)})"
        ours = words
    finding = stated(claim, paper, str(ours), rule, holds(rows), better=better)
    if drawn and 0.025 < np.mean([holds(each) for each in drawn]) < 0.975:
        return replace(finding, verdict=Verdict.TOO_FEW)
    if finding.verdict is Verdict.DIFFERS:
        return finding
    controls = CONTROLS_OF.get(planner, {}).items()
    earned = [kind for kind, name in controls if rows.of(name) and holds(with_control(rows, kind))]
    return replace(finding, controls=tuple(earned))


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
    most = rows.increase(fast) + 0.01

    def holds(rows: Rows) -> bool:
        as_good = not near or rows.increase(fast) <= most
        return as_good and rows.speedup(slow, fast) >= 0.75 * theirs

    return judge(
        claim,
        f"{theirs:.1f}×",
        "{:.3g}×".format,
        "within 25 % of the paper's",
        holds,
        rows,
        fast,
        figure=lambda rows: rows.speedup(slow, fast),
        better=rows.speedup(slow, fast) > 1.25 * theirs,
    )


def judge_increase(claim: str, theirs: float, rows: Rows, planner: str) -> Finding:
    """A finding on the share by which a planner's CC exceeds the optimum: theirs within one point,
    or less.
    """
    return judge(
        claim,
        percent(theirs),
        lambda share: percent(share, 2),
        "within one point",
        lambda rows: rows.increase(planner) <= theirs + 0.01,
        rows,
        planner,
        figure=lambda rows: rows.increase(planner),
        better=rows.increase(planner) < theirs - 0.01,
    )
