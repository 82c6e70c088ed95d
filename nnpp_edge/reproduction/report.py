"""What an experiment comes to: tables, and the paper's claims beside what was measured, judged by plain rules."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

Value = str | float | None
"""Of a table."""
Row = tuple[Value, ...]


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


@dataclass(frozen=True)
class Table:
    """Rows under a header, for people as Markdown and for programs as CSV."""

    header: Sequence[str]
    rows: Sequence[Sequence[Value]]

    def markdown(self) -> str:
        """A table in Markdown; None as a dash."""
        lines = [self.header, ["---"] * len(self.header), *self.rows]
        return "".join("| " + " | ".join(_escaped(cell) for cell in line) + " |\n" for line in lines)

    def csv(self) -> str:
        """Comma-separated values, floats in full; None, inf and NaN as nothing."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.header)
        writer.writerows([_plain(cell) for cell in row] for row in self.rows)
        return out.getvalue()


@dataclass(frozen=True)
class Sections:
    """Tables under headings of their own."""

    parts: Sequence[tuple[str, Table]]

    def markdown(self) -> str:
        """Heading, table, heading, table."""
        return "\n".join(f"### {heading}\n\n{table.markdown()}" for heading, table in self.parts)


@dataclass(frozen=True)
class About:
    """What every page says at its top."""

    networks: str
    """Which networks took part, and where."""
    samples: str
    """Maps, queries, repetitions."""
    controls: str = "none, as no network takes part"


@dataclass(frozen=True)
class Result:
    """All that an experiment hands back."""

    about: About
    summary: Table | Sections
    """For people: ours beside the paper's."""
    data: Table
    """What was measured, for programs."""
    findings: Sequence[Finding]
    picture: bytes
    """PNG."""
    notes: Sequence[str] = ()
    """Whole sentences."""
    animation: bytes | None = None
    """GIF."""


def judge(
    claim: str,
    paper: str,
    ours: str,
    *,
    agrees: bool,
    rule: str,
    better: bool = False,
    controls: Mapping[str, bool] | None = None,
) -> Finding:
    """A finding by a rule that was worked out: it agrees, or it is better, or neither.

    `controls` says of each control whether it does as well, by the same rule.
    """
    verdict = Verdict.AGREES if agrees else Verdict.BETTER if better else Verdict.DIFFERS
    earned = tuple(name for name, as_well in (controls or {}).items() if as_well)
    return Finding(claim, paper, ours, rule, verdict, () if verdict is Verdict.DIFFERS else earned)


def judge_ratio(
    claim: str, paper: float, ours: float, *, within: float = 0.25, controls: Mapping[str, float] | None = None
) -> Finding:
    """A finding on a speed-up that should be the paper's within a share of it; `controls` have theirs."""
    near = abs(ours - paper) <= within * paper
    as_well = {name: gain >= (1.0 - within) * paper for name, gain in (controls or {}).items()}
    rule, texts = f"within {100 * within:.0f} % of the paper's", (f"{paper:.1f}×", f"{ours:.3g}×")
    return judge(claim, *texts, agrees=near, rule=rule, better=ours > paper, controls=as_well)


def judge_increase(claim: str, paper: float, ours: float, *, controls: Mapping[str, float] | None = None) -> Finding:
    """A finding on a share by which CC increases: the paper's within one point, or less; `controls` have theirs."""
    near, less = abs(ours - paper) <= 0.01, ours < paper
    as_well = {name: increase <= paper + 0.01 for name, increase in (controls or {}).items()}
    texts = percent(paper), percent(ours, 2)
    return judge(claim, *texts, agrees=near, rule="within one point", better=less, controls=as_well)


def columns(names: str) -> tuple[str, ...]:
    """Names of a table's columns, from one line with bars between them."""
    return tuple(names.split(" | "))


def findings_table(findings: Sequence[Finding]) -> Table:
    """The findings, a row each."""
    return Table(
        columns("claim | paper | ours | rule | verdict"),
        [(f.claim, f.paper, f.ours, f.rule, f"**{f.verdict}**{_as_well(f)}") for f in findings],
    )


def _as_well(finding: Finding) -> str:
    if not finding.controls:
        return ""
    return f"; says nothing about the network, a control does as well: {', '.join(finding.controls)}"


def _escaped(cell: Value) -> str:
    return "–" if cell is None else str(cell).replace("|", "\\|").replace("\n", " ")


def _plain(cell: Value) -> Value:
    return "" if cell is None or (isinstance(cell, float) and not math.isfinite(cell)) else cell


def seconds(value: float) -> str:
    """A time with its unit, three digits."""
    return f"{value:.3g} s" if value >= 1.0 else f"{1e3 * value:.3g} ms"


def times(slower_s: float, faster_s: float, digits: str = ".2f") -> str:
    """How many times as fast."""
    return f"{slower_s / faster_s:{digits}}×"


def optional(value: float | None, digits: str) -> str | None:
    """A number as text, None as None."""
    return None if value is None else f"{value:{digits}}"


def percent(share: float, digits: int = 1) -> str:
    """A share as so many per cent, never as -0."""
    return f"{round(100.0 * share, digits) + 0.0:.{digits}f} %"
