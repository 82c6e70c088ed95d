"""The paper's claims beside the measured figures, judged by plain rules."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from operator import methodcaller
from typing import NamedTuple

import numpy as np

from nnpp_edge.profiling.intervals import Interval
from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction.paper import ASTAR, ASTAR_NN, DSTAR, DSTAR_NN
from nnpp_edge.reproduction.planners import CONTROLS_OF, PLAIN, PLAIN_NN
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
OURS_OF = {
    "plain": {ASTAR: PLAIN, ASTAR_NN: PLAIN_NN},
    "ours": {ASTAR: "astar", ASTAR_NN: "nnpp", DSTAR: "dstar", DSTAR_NN: "nnpp-dstar"},
}
"""In place of each of the paper's methods, in plain Python and compiled."""
_PLACE = ("scene", "size")
_QUERY = ("map", "goal")
ONE_POINT = 0.01
WITHIN = "within one point"


class Figure(NamedTuple):
    """A figure of rows, and how it is written."""

    of: Callable[[Rows], float]
    written: Callable[[float], str]


def mean(name: str, planner: str, **values: object) -> Figure:
    """Mean share of a planner's rows."""
    return Figure(lambda rows: rows.of(planner, **values).mean(name), percent)


def stated(
    claim: str, paper: str, ours: str, rule: str, holds: object, *, better: bool = False
) -> Finding:
    """A finding that has no controls, and hangs on no few queries."""
    met = Verdict.BETTER if better else Verdict.AGREES
    return Finding(claim, paper, ours, rule, met if holds else Verdict.DIFFERS)


def judge(
    claim: str,
    paper: str,
    rule: str,
    figure: Figure,
    rows: Rows,
    planner: str,
    *,
    least: float = -math.inf,
    most: float = math.inf,
    better_from: float = math.inf,
    better_to: float = -math.inf,
    also: Callable[[Rows], bool] = bool,
    ours: str = "",
) -> Finding:
    """A finding: whether a figure lies within limits, and with which controls in place of the
    planner's network it does as well, where they are as good in what is `also` asked.

    Of few queries it is said whether they are enough, by samples that are drawn with replacement.
    What is `ours` is the figure, with the interval of the samples, where no other words are given.
    """
    value = figure.of(rows)
    found = Interval(value, value, value)
    said = figure.written(value)
    if drawn := drawn_anew(rows):
        found = Interval.of(value, [figure.of(each) for each in drawn])
        said += f" ({figure.written(found.low)} to {figure.written(found.high)})"

    def holds(rows: Rows) -> bool:
        return least <= figure.of(rows) <= most and also(rows)

    better = not better_to < value < better_from
    finding = stated(claim, paper, ours or said, rule, holds(rows), better=better)
    if drawn and found.within(least, most) is None:
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
    places = [list(of.groups(_QUERY).values()) for of in rows.groups(_PLACE).values()]
    most = max(map(len, places), default=0)
    if not 1 < most < ENOUGH:
        return []
    rng = np.random.default_rng(1)
    samples = []
    for _ in range(SAMPLES):
        sample = Rows()
        for queries in places:
            for at in rng.integers(len(queries), size=len(queries)):
                sample += queries[at]
        samples.append(sample)
    return samples


def with_control(rows: Rows, kind: str) -> Rows:
    """The rows with a control's answers under the names of the planners that it stands in for."""
    swapped = Rows(row for row in rows if row["planner"] not in CONTROLS_OF)
    for planner, controls in CONTROLS_OF.items():
        stand_in = controls.get(kind, planner)
        swapped += [{**row, "planner": planner} for row in rows.of(stand_in)]
    return swapped


def pairs(slow: str, fast: str) -> Iterator[tuple[str, str, str]]:
    """Two of the paper's methods in words, and ours in their place: plain where we have both so,
    and compiled.
    """
    over = f"{fast} over {slow}".replace("paper's ", "")
    for label, ours in OURS_OF.items():
        if {slow, fast} <= ours.keys():
            yield f"{over}, both {label}", ours[slow], ours[fast]


def judge_speedups(
    slow: str, fast: str, theirs: Rows, rows: Rows, where: str = ""
) -> Iterator[Finding]:
    """Findings on the speed-up of one of the paper's methods over another: theirs within 25 %, or
    more. A control counts where its CC increase is no more than a point above the network's.
    """
    gain = theirs.speedup(slow, fast)
    for words, exact, network in pairs(slow, fast):
        yield judge(
            f"speed-up of {words}{where}",
            f"{gain:.1f}×",
            "within 25 % of the paper's",
            Figure(methodcaller("speedup", exact, network), "{:.3g}×".format),
            rows,
            network,
            least=0.75 * gain,
            better_from=1.25 * gain,
            also=partial(_no_dearer, network, rows.increase(network) + ONE_POINT),
        )


def _no_dearer(planner: str, most: float, rows: Rows) -> bool:
    return rows.increase(planner) <= most


def judge_increase(claim: str, theirs: float, rows: Rows, planner: str) -> Finding:
    """A finding on the share by which a planner's CC exceeds the optimum: theirs within one point,
    or less.
    """
    return judge(
        f"CC increase of {claim}",
        percent(theirs),
        WITHIN,
        Figure(methodcaller("increase", planner), partial(percent, digits=2)),
        rows,
        planner,
        most=theirs + ONE_POINT,
        better_to=theirs - ONE_POINT,
    )
