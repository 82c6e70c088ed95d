"""Records of an experiment, and its pages: its own, and the index that says what agrees with the paper."""

from collections.abc import Sequence

import msgspec

from nnpp_edge.progress import markdown_table
from nnpp_edge.reproduction.findings import Finding, Verdict, findings_table
from nnpp_edge.reproduction.rows import Row


class Stored(msgspec.Struct):
    """Content of an experiment's NAME.json."""

    format: str
    name: str
    where: str
    title: str
    machine: str
    load: float
    made_with: Row
    """All that decides the figures, except the machine."""
    about: dict[str, str]
    """Networks, controls, and how many maps, queries and repetitions."""
    findings: list[Finding]
    notes: list[str]
    summary: str


_HEADS = {Verdict.DIFFERS: "What does not agree", Verdict.BETTER: "What is better than in the paper"}
_HEADS |= {Verdict.AGREES: "What agrees"}


def experiment_page(facts: Stored) -> str:
    """Markdown of one experiment: picture, ours beside the paper's, findings, how it was made."""
    name = facts.name
    findings = f"## Findings\n\n{findings_table(facts.findings)}"
    return f"""# {facts.where}: {facts.title}

{_quick_warning([facts])}{_section(facts, name, findings)}
## How it was made

{_making(facts)}
- load of the machine before (average over a minute): {facts.load:.1f}

The figures are in [{name}.csv]({name}.csv).
"""


def index_page(stored: Sequence[Stored]) -> str:
    """Markdown of the folder: verdicts first, then each experiment with its table and picture."""
    parts = [
        "# The paper's experiments, repeated",
        "NNPP (Ji et al., arXiv 2308.04792v3), its experiments on our terrain with this toolkit, each beside the "
        "paper's figures. This page and all that it links to are written by `nnpp-edge reproduce`; the verdicts "
        "follow from the measured figures by the rules named beside them. How the paper "
        "was read, and what is counted: `docs/reproduce.md`.",
    ]
    if not stored:
        return "\n\n".join([*parts, "No experiment has been run yet."]) + "\n"
    parts += [_quick_warning(stored).strip(), _counts(stored)]
    for verdict, head in _HEADS.items():
        header = ("", "claim", "paper", "ours", "rule", "a control does as well")
        lines = [
            (f"[{facts.where}](#{facts.name})", f.claim, f.paper, f.ours, f.rule, ", ".join(f.controls) or "–")
            for facts in stored
            for f in facts.findings
            if f.verdict is verdict
        ]
        if lines:
            parts += [f"## {head}", markdown_table(header, lines)]
    for facts in stored:
        place = f"{facts.name}/{facts.name}"
        parts += [f'<a id="{facts.name}"></a>', f"## {facts.where}: {facts.title}", _section(facts, place).strip()]
        parts.append(f"[Page]({place}.md), [figures]({place}.csv)")
    shared: dict[str, list[str]] = {}
    for facts in stored:
        shared.setdefault(_making(facts), []).append(facts.where)
    makings = [f"{', '.join(of)}:\n\n{making}" for making, of in shared.items()]
    parts += ["## How it was made", *makings]
    return "\n\n".join(part for part in parts if part) + "\n"


def _section(facts: Stored, place: str, findings: str = "") -> str:
    about = "\n".join(f"- {what}: {text}" for what, text in facts.about.items())
    notes = "".join(f"{note}\n\n" for note in facts.notes)
    return f"{about}\n\n![{facts.title}]({place}.png)\n\n{facts.summary}\n{findings}\n{notes}"


def _counts(stored: Sequence[Stored]) -> str:
    lines = []
    for facts in stored:
        counts = [sum(f.verdict is verdict for f in facts.findings) for verdict in Verdict]
        counts.append(sum(bool(f.controls) for f in facts.findings))
        lines.append((f"[{facts.where}](#{facts.name})", facts.title, *(str(count or "–") for count in counts)))
    return markdown_table(("", "experiment", "agrees", "better", "does not agree", "a control does as well"), lines)


def _quick_warning(stored: Sequence[Stored]) -> str:
    quick = [facts.where for facts in stored if facts.made_with["quick"]]
    if not quick:
        return ""
    subject = "This is" if len(stored) == len(quick) else f"{', '.join(quick)}:"
    return f"**{subject} a smoke run (`--quick`): far too few maps and steps to conclude anything from.**\n\n"


def _making(facts: Stored) -> str:
    """Common facts of the experiments of one run."""
    made = facts.made_with
    terrain = ", ".join(f"`{t['name']}` (cells of {t['cell_size_m']:g} m)" for t in made["terrain"])
    files = [f"{whose} `{file['name']}` (SHA-256 {file['sha256'][:12]}…)" for whose, file in made["networks"].items()]
    return f"""- machine: {facts.machine}
- nnpp-edge {made["version"]}, seed {made["seed"]}, networks: {", ".join(files) or "none handed in"}
- terrain: {terrain}"""
