"""Records of an experiment, and the page that puts them together and says what agrees with the paper."""

from collections.abc import Sequence

import msgspec

from nnpp_edge.progress import markdown_table
from nnpp_edge.reproduction.findings import Finding, Verdict
from nnpp_edge.reproduction.rows import Row

_COLUMNS = ("claim", "paper", "ours", "rule", "verdict")
_HEADS = {Verdict.DIFFERS: "What does not agree", Verdict.BETTER: "What is better than in the paper"}
_HEADS |= {Verdict.AGREES: "What agrees"}


class Stored(msgspec.Struct):
    """Content of an experiment's NAME.json."""

    format: str
    name: str
    where: str
    title: str
    machine: str
    made_with: Row
    """All that decides the figures, except the machine."""
    about: dict[str, str]
    """Networks, controls, and how many maps, queries and repetitions."""
    findings: list[Finding]
    notes: list[str]
    summary: str

    @property
    def link(self) -> str:
        """To its section in the index."""
        return f"[{self.where}](#{self.name})"

    @property
    def made(self) -> str:
        """Common facts of the experiments of one run, as a list."""
        made, machine = self.made_with, f"- machine: {self.machine}"
        terrain = ", ".join(f"`{each['name']}` (cells of {each['cell_size_m']:g} m)" for each in made["terrain"])
        files = [f"{of} `{each['name']}` (SHA-256 {each['sha256'][:12]}…)" for of, each in made["networks"].items()]
        networks = ", ".join(files) or "none"
        run = f"- nnpp-edge {made['version']}, seed {made['seed']}, networks: {networks}"
        return "\n".join((machine, run, f"- terrain: {terrain}"))


def index_page(stored: Sequence[Stored]) -> str:
    """Markdown of the folder: verdicts first, then each experiment with its table and picture."""
    quick = [of.where for of in stored if of.made_with["quick"]]
    parts = [
        "# The paper's experiments, repeated",
        "NNPP (Ji et al., arXiv 2308.04792v3), its experiments on our terrain with this toolkit, each beside the "
        "paper's figures. This page and all that it links to are written by `nnpp-edge reproduce`; the verdicts "
        "follow from the measured figures by the rules named beside them. How the paper "
        "was read, and what is counted: `docs/reproduce.md`.",
        *[f"**{', '.join(quick)}: smoke runs (`--quick`), far too small to conclude anything from.**"] * bool(quick),
    ]
    counts = [
        (of.link, of.title, *(str(sum(f.verdict is verdict for f in of.findings) or "–") for verdict in Verdict))
        for of in stored
    ]
    if counts:
        parts.append(markdown_table(("", "experiment", "agrees", "better", "does not agree"), counts))
    for verdict, head in _HEADS.items():
        lines = [(of.link, *finding_cells(f)) for of in stored for f in of.findings if f.verdict is verdict]
        if lines:
            parts += [f"## {head}", markdown_table(("", *_COLUMNS), lines)]
    for of in stored:
        place = f"{of.name}/{of.name}"
        parts += [f'<a id="{of.name}"></a>', f"## {of.where}: {of.title}"]
        parts += ["\n".join(f"- {name}: {text}" for name, text in of.about.items())]
        parts += [f"![{of.title}]({place}.png)", of.summary, *of.notes]
        parts.append(f"[Figures]({place}.csv)")
    parts += ["## How it was made"] if stored else ["No experiment has been run yet."]
    for made in dict.fromkeys(of.made for of in stored):
        parts.append(f"{', '.join(of.where for of in stored if of.made == made)}:\n\n{made}")
    return "\n\n".join(parts) + "\n"


def finding_cells(finding: Finding) -> tuple[str, ...]:
    """A finding's line in a table."""
    said = "; says nothing about the network, a control does as well: " + ", ".join(finding.controls)
    verdict = f"**{finding.verdict}**" + said * bool(finding.controls)
    return finding.claim, finding.paper, finding.ours, finding.rule, verdict
