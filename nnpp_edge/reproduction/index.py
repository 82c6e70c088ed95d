"""The pages: one for each experiment, and the index that says what agrees with the paper and what does not."""

import json
from collections.abc import Sequence
from typing import NotRequired, TypedDict

import msgspec

from nnpp_edge.reproduction.report import Finding, Table, Verdict, columns, findings_table


class FileFacts(TypedDict):
    """A file by name and content, never by its place."""

    name: str
    sha256: str
    cell_size_m: NotRequired[float]
    """Of a terrain file."""


class MadeWith(TypedDict):
    """All that decides the figures, except the machine."""

    version: str
    quick: bool
    seed: int
    terrain: list[FileFacts]
    networks: dict[str, FileFacts]
    """Of the paper's method, and of ours."""
    dataset: FileFacts | None
    settings: dict[str, object]


class Stored(TypedDict):
    """What NAME.json of an experiment holds."""

    format: str
    name: str
    where: str
    title: str
    machine: str
    load: float
    made_with: MadeWith
    about: dict[str, str]
    """Networks, samples and controls."""
    findings: list[dict[str, object]]
    notes: list[str]
    animated: bool
    summary: str


_HEADER = " | claim | paper | ours | rule | a control does as well"
_HEADS = {
    Verdict.DIFFERS: "What does not agree",
    Verdict.BETTER: "What is better than in the paper",
    Verdict.AGREES: "What agrees",
}


def experiment_page(facts: Stored) -> str:
    """Markdown of one experiment: picture, ours beside the paper's, findings, how it was made."""
    name = facts["name"]
    animation = [f"![{facts['title']}, animated]({name}.gif)", ""] if facts.get("animated") else []
    head = [f"# {facts['where']}: {facts['title']}", "", *_quick_warning([facts])]
    head += [*_about(facts), f"![{facts['title']}]({name}.png)", ""]
    findings = [facts["summary"], "## Findings", "", findings_table(findings_of(facts)).markdown(), *_notes(facts)]
    making = ["## How it was made", "", *_making(facts), *_own_making(facts), ""]
    return "\n".join([*head, *animation, *findings, *making, f"The figures are in [{name}.csv]({name}.csv).", ""])


def index_page(stored: Sequence[Stored], missing: Sequence[str]) -> str:
    """Markdown of the folder: verdicts first, then each experiment with its table and picture."""
    introduction = (
        "NNPP (Ji et al., arXiv 2308.04792v3), its experiments on our terrain with this toolkit, each beside the "
        "paper's figures. This page and all that it links to are written by `nnpp-edge reproduce`; the verdicts "
        "follow from the measured figures by the rules named beside them."
    )
    lines = ["# The paper's experiments, repeated", "", introduction, "", *_quick_warning(stored)]
    lines += [_counts(stored).markdown()] if stored else ["No experiment has been run yet.", ""]
    for verdict, head in _HEADS.items():
        chosen = [(facts, f) for facts in stored for f in findings_of(facts) if f.verdict is verdict]
        if chosen:
            rows = [
                (f"[{x['where']}](#{x['name']})", f.claim, f.paper, f.ours, f.rule, ", ".join(f.controls) or None)
                for x, f in chosen
            ]
            lines += [f"## {head}", "", Table(columns(_HEADER), rows).markdown()]
    for facts in stored:
        folder = f"{facts['name']}/{facts['name']}"
        lines += [f'<a id="{facts["name"]}"></a>', "", f"## {facts['where']}: {facts['title']}", ""]
        lines += [*_about(facts), f"![{facts['title']}]({folder}.png)", "", facts["summary"], *_notes(facts)]
        lines += [f"[Page]({folder}.md), [figures]({folder}.csv)", ""]
    if missing:
        lines += [f"Not in this version of the toolkit: {', '.join(missing)}.", ""]
    if stored:
        lines += ["## How it was made", "", *_makings(stored), ""]
    return "\n".join(lines).rstrip() + "\n"


def findings_of(facts: Stored) -> list[Finding]:
    """Its findings."""
    return msgspec.convert(facts["findings"], list[Finding])


def _about(facts: Stored) -> list[str]:
    return [*(f"- {what}: {text}" for what, text in facts["about"].items()), ""]


def _counts(stored: Sequence[Stored]) -> Table:
    rows = []
    for facts in stored:
        verdicts = [f.verdict for f in findings_of(facts)]
        counts = [verdicts.count(verdict) or None for verdict in (Verdict.AGREES, Verdict.BETTER, Verdict.DIFFERS)]
        earned = sum(bool(f.controls) for f in findings_of(facts)) or None
        rows.append((f"[{facts['where']}](#{facts['name']})", facts["title"], *counts, earned))
    return Table(("", "experiment", "agrees", "better", "does not agree", "a control does as well"), rows)


def _notes(facts: Stored) -> list[str]:
    return [line for note in facts["notes"] for line in (note, "")]


def _quick_warning(stored: Sequence[Stored]) -> list[str]:
    quick = [facts["where"] for facts in stored if facts["made_with"]["quick"]]
    if not quick:
        return []
    subject = "This is" if len(stored) == len(quick) else f"{', '.join(quick)}:"
    return [f"**{subject} a smoke run (`--quick`): far too few maps and steps to conclude anything from.**", ""]


def _making(facts: Stored) -> list[str]:
    """What experiments of one run have in common."""
    made = facts["made_with"]
    terrain = ", ".join(f"`{t['name']}` (cells of {t['cell_size_m']:g} m)" for t in made["terrain"])
    files = [f"{whose} `{file['name']}` (SHA-256 {file['sha256'][:12]}…)" for whose, file in made["networks"].items()]
    lines = [
        f"- machine: {facts['machine']}",
        f"- nnpp-edge {made['version']}, seed {made['seed']}, networks: {', '.join(files) or 'none handed in'}",
        f"- terrain: {terrain}",
    ]
    if made["dataset"]:
        lines.append(f"- data set for training: `{made['dataset']['name']}`")
    return lines


def _own_making(facts: Stored) -> list[str]:
    """What is an experiment's own."""
    return [
        f"- load of the machine before (average over a minute): {facts['load']:.1f}",
        f"- settings: `{json.dumps(facts['made_with']['settings'], ensure_ascii=False)}`",
    ]


def _makings(stored: Sequence[Stored]) -> list[str]:
    """The same for all experiments, said once where it is the same."""
    shared: dict[tuple[str, ...], list[Stored]] = {}
    for facts in stored:
        shared.setdefault(tuple(_making(facts)), []).append(facts)
    lines: list[str] = []
    for made, of in shared.items():
        lines += [f"{', '.join(facts['where'] for facts in of)}:", "", *made, ""]
    return [*lines, "Each experiment's own settings stand on its page."]
