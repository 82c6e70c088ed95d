"""The paper's claims beside what was measured, judged by plain rules."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from nnpp_edge.progress import markdown_table
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


def judge(
    claim: str,
    paper: str,
    ours: str,
    agrees: bool,
    rule: str,
    controls: Mapping[str, bool] | None = None,
    *,
    better: bool = False,
) -> Finding:
    """A finding by a rule that was worked out; `controls` says of each control whether it does as well."""
    verdict = Verdict.AGREES if agrees else Verdict.BETTER if better else Verdict.DIFFERS
    earned = tuple(name for name, as_well in (controls or {}).items() if as_well)
    return Finding(claim, paper, ours, rule, verdict, () if verdict is Verdict.DIFFERS else earned)


def judge_speedup(claim: str, theirs: float, rows: Rows, pair: tuple[str, str], *, near: bool = False) -> Finding:
    """A finding on the speed-up of the second planner over the first, which should be theirs within a quarter.

    With `near` a control counts where its CC increase is no more than a point above the network's.
    """
    slower, faster = pair
    ours, most = rows.speedup(slower, faster), rows.increase(faster) + 0.01

    def as_well(name: str, kind: str) -> bool:
        slow = CONTROLS_OF.get(slower, {}).get(kind, slower)
        return rows.speedup(slow, name) >= 0.75 * theirs and (not near or rows.increase(name) <= most)

    controls = {kind: as_well(name, kind) for kind, name in controls_in(rows, faster).items()}
    texts, agrees = (f"{theirs:.1f}×", f"{ours:.3g}×"), abs(ours - theirs) <= 0.25 * theirs
    return judge(claim, *texts, agrees, "within 25 % of the paper's", controls, better=ours > theirs)


def judge_increase(claim: str, theirs: float, rows: Rows, planner: str) -> Finding:
    """A finding on the share by which a planner's CC lies above the optimum: theirs within one point, or less."""
    ours, met = rows.increase(planner), met_by(rows, planner, lambda name: rows.increase(name) <= theirs + 0.01)
    texts, agrees = (percent(theirs), percent(ours, 2)), abs(ours - theirs) <= 0.01
    return judge(claim, *texts, agrees, "within one point", met, better=ours < theirs)


def controls_in(rows: Rows, planner: str) -> dict[str, str]:
    """The controls of a planner that took part, by their kinds."""
    return {kind: name for kind, name in CONTROLS_OF.get(planner, {}).items() if rows.of(name)}


def met_by(rows: Rows, planner: str, rule: Callable[[str], bool]) -> dict[str, bool]:
    """Whether each of a planner's controls meets a rule."""
    return {kind: rule(name) for kind, name in controls_in(rows, planner).items()}


def findings_table(findings: Sequence[Finding]) -> str:
    """The findings in Markdown, a row each."""
    said = "; says nothing about the network, a control does as well: "
    lines = [
        (f.claim, f.paper, f.ours, f.rule, f"**{f.verdict}**" + (said + ", ".join(f.controls)) * bool(f.controls))
        for f in findings
    ]
    return markdown_table(("claim", "paper", "ours", "rule", "verdict"), lines) + "\n"
